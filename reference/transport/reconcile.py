"""Reciprocity and closure: what ray-cast form factors get wrong, and the least change that puts both right.

With flows x_ij = A_i F_ij, truth obeys x_ij = x_ji and Σ_j x_ij + Σ_k x_i,outside k = A_i. Rays from i estimate x_ij with variance
A_i x_ij / N_i, independently of the rays from j. So

1. both estimates are averaged with weights w_i = N_i / A_i, the inverse of their variances: no entry gets worse than the
   better one of the two, and v_ij = x_ij / (w_i + w_j) is left;
2. low-discrepancy rays make a row's errors cancel within groups of neighbouring patches, which averaging alone gives up: what
   each row found for such groups as a whole is brought in as further observations (group_sums.py);
3. rows are closed by x_ij + v_ij (λ_i + λ_j) and x_i,out + v_i,out λ_i: least squares weighted by the inverse variances
   under exact linear constraints. For independent errors of these variances that lowers the variance of every linear
   function of the flows (Gauss-Markov theorem). Entries of variance 0, closed forms, stay as they are.

Tests measure all of it against exact form factors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from ..datatypes import F32, F64
from .flows import Flows, averaged_flows, rounding_defect, row_sums, rows_of_flows, without_entries
from .form_factors import FormFactors
from .group_sums import with_group_sums

CLOSURE = 1e-9  # of a row, before rounding to float32
MAX_ITERATIONS = 2000
ROUNDS = 20
ROWS_AT_ONCE = 1024
# Where pairs link patches like the two colours of a chessboard, one combination of multipliers changes no flow: the system is singular,
# and conjugate gradients would run away along it. So much is added to the (scaled) diagonal: far below what closure asks for.
RIDGE = 1e-8


@dataclass(frozen=True, eq=False)
class Reconciled:
    """rows: form factors that keep both laws. raw_reciprocity, reciprocity: Σ|x_ij - x_ji| / Σ x_ij before and after.
    raw_closure, symmetric_closure, closure: max |Σ_j F_ij - 1| of the rays, after averaging, and in the end."""

    rows: FormFactors
    raw_reciprocity: float
    raw_closure: float
    symmetric_closure: float
    reciprocity: float
    closure: float


def reconcile(raw: FormFactors, area: F64) -> Reconciled:
    """Make rows from every patch reciprocal and closed. area: (P,) m². Raises ValueError for rows of other receivers."""
    if raw.rows != raw.patches or raw.values.shape[1] != 1 or len(area) != raw.rows:
        raise ValueError(
            f"expected one row for each of {raw.patches} patches and areas, got {raw.rows} and {len(area)}"
        )
    raw_closure = float(np.abs(raw.matrix().sum(axis=1) - 1.0).max(initial=0.0))
    averaged = [averaged_flows(raw, area)]
    like = without_entries(raw)
    del raw  # where the caller keeps it neither, memory holds one matrix less
    return reconcile_flows(averaged.pop(), area, like, raw_closure)  # popped: nothing here keeps what is replaced there


def reconcile_flows(
    averaged: tuple[Flows, float] | tuple[Flows, float, F32], area: F64, raw: FormFactors, raw_closure: float
) -> Reconciled:
    """Close flows that are reciprocal already. averaged: they, the reciprocity defect they had, and, where they were averaged from
    rays (`averaged_flows`), the difference of both directions. raw: where ray counts and back shares come from."""
    flows, raw_reciprocity, *difference = averaged
    del averaged  # what is replaced below shall not be kept
    symmetric = float(np.abs(row_sums(flows, len(area)) / area - 1.0).max(initial=0.0))
    if difference:
        flows = with_group_sums(flows, difference.pop(), area, raw.rays)
    flows = closed(flows, area)
    reciprocity = rounding_defect(flows, area)  # before the rows are there, which need as much memory
    rows = rows_of_flows(flows, area, raw)
    closure = float(np.abs(row_totals(rows) - 1.0).max(initial=0.0))
    return Reconciled(rows, raw_reciprocity, raw_closure, symmetric, reciprocity, closure)


def row_totals(rows: FormFactors) -> F64:
    """Σ_j F_ij of each row in double precision, (R,), some rows at a time: values as doubles are as large as the matrix."""
    totals = np.zeros(rows.rows)
    for begin in range(0, rows.rows, ROWS_AT_ONCE):
        pointers = rows.indptr[begin : begin + ROWS_AT_ONCE + 1]
        count = len(pointers) - 1
        row = np.repeat(np.arange(count), np.diff(pointers))
        totals[begin : begin + count] = np.bincount(row, rows.values[pointers[0] : pointers[-1], 0], count)
    return totals


def closed(flows: Flows, area: F64) -> Flows:
    """Step 3, repeated where a correction larger than the entry itself had to be cut off at zero."""
    for _ in range(ROUNDS):
        flows = _least_change(flows, area)
        cut = min(flows.x.min(initial=0.0), flows.out_x.min(initial=0.0)) < 0.0
        flows = flows.without_negatives()
        if not cut:
            break
    return flows


def _least_change(f: Flows, area: F64) -> Flows:
    """Solves (diag(Σ_j v_ij + v_i,out) + V) λ = A - Σ_j x_ij by conjugate gradients and applies the correction."""
    p = len(area)
    own = f.lo == f.hi  # counts once in its row, but is bent by both λ_i and λ_j
    variance = np.where(own, 0.5 * f.variance, f.variance)
    upper = sparse.csr_array((variance, f.hi, f.pointers(p)), shape=(p, p))
    lower = upper.T.tocsr()
    twice = np.zeros(p)
    twice[f.lo[own]] = variance[own]
    diagonal = upper.sum(axis=1) + lower.sum(axis=1) - twice + np.bincount(f.out_row, f.out_variance, p)
    bends = diagonal > 0.0  # rows of closed forms only are as they are
    scale = np.where(
        bends, 1.0 / np.sqrt(np.where(bends, diagonal, 1.0)), 0.0
    )  # Jacobi's preconditioner, kept symmetric

    def product(y: F64) -> F64:
        z = scale * y
        return np.asarray(scale * ((diagonal - twice) * z + upper @ z + lower @ z) + RIDGE * y)

    defect = area - row_sums(f, p)
    solved, _ = cg(
        LinearOperator((p, p), matvec=product, dtype=float), scale * defect, rtol=CLOSURE, maxiter=MAX_ITERATIONS
    )
    multiplier = scale * solved
    x = f.x + variance * (multiplier[f.lo] + multiplier[f.hi])
    return f._replace(x=x, out_x=f.out_x + f.out_variance * multiplier[f.out_row])
