"""Flows x_ij = A_i F_ij between patches, each pair once, and back to rows of form factors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse

from ..datatypes import F32, F64, I32, I64
from .form_factors import FormFactors

C128 = npt.NDArray[np.complex128]
TINY = 1e-60


class Flows(NamedTuple):
    """lo, hi (N,) i32: patches of a pair, lo ≤ hi, sorted by lo, then hi. x (N,) m²: A_i F_ij = A_j F_ji.

    variance (N,) f32: what least squares may bend, m⁴; spread (N,) f32: measured variance from replicates, m⁴.
    out_row, out_column (M,): patch and column (sky bins, absorbed), sorted; out_x, out_variance, out_spread likewise.
    """

    lo: I32
    hi: I32
    x: F64
    variance: F32
    spread: F32
    out_row: I32
    out_column: I32
    out_x: F64
    out_variance: F32
    out_spread: F32

    def pointers(self, patches: int) -> I64:
        """Where each patch's pairs begin, (P + 1,)."""
        return np.searchsorted(self.lo, np.arange(patches + 1))

    def without_negatives(self) -> Flows:
        """Negative flows set to zero, and held there."""
        x, out_x = np.maximum(self.x, 0.0), np.maximum(self.out_x, 0.0)
        kept = self._replace(x=x, out_x=out_x)
        return kept._replace(variance=self.variance * (x > 0.0), out_variance=self.out_variance * (out_x > 0.0))


def row_sums(f: Flows, patches: int) -> F64:
    """Σ_j x_ij with sky and absorbed columns, (P,) m²."""
    mine, other = np.bincount(f.lo, f.x, patches), np.bincount(f.hi, np.where(f.lo == f.hi, 0.0, f.x), patches)
    return np.asarray(mine + other + np.bincount(f.out_row, f.out_x, patches))


def flows_of_rays(raw: FormFactors, area: F64) -> tuple[Flows, float]:
    """Both directions of each pair averaged by inverse variance, and the reciprocity defect Σ|x_ij - x_ji| / Σ x_ij."""
    return averaged_flows(raw, area)[:2]


def averaged_flows(raw: FormFactors, area: F64) -> tuple[Flows, float, F32]:
    """`flows_of_rays`, and of each pair (N,) its flow as lo sees it less its flow as hi sees it, m²."""
    weight = raw.rays / area
    lo, hi, flow, squared = _both_ways(raw, area)
    w_lo, w_hi = weight[lo], np.where(lo == hi, 0.0, weight[hi])
    total = w_lo + w_hi
    w_lo /= total
    w_hi /= total
    whole = float(flow.real.sum() + flow.imag.sum())
    difference = flow.real - flow.imag
    different = 2.0 * float(np.abs(difference)[lo != hi].sum())
    x = w_lo * flow.real + w_hi * flow.imag
    del flow  # here memory is at its fullest
    spread = (w_lo**2 * squared.real + w_hi**2 * squared.imag).astype(np.float32)
    del squared, w_lo, w_hi
    flows = Flows(lo, hi, x, (x / total).astype(np.float32), spread, *_outside(raw, area, weight))
    return flows, different / whole if whole > 0.0 else 0.0, difference.astype(np.float32)


def _both_ways(raw: FormFactors, area: F64) -> tuple[I32, I32, C128, C128]:
    """Every pair once: lo, hi (N,), sorted; its flow as lo and as hi see it, and their squared errors.

    Real parts hold what lo sees, imaginary parts what hi sees: sparse addition then brings both together in linear time.
    """
    p = raw.rows
    row = np.repeat(np.arange(p, dtype=np.int32), np.diff(raw.indptr))
    upper, lower = (raw.columns < p) & (row <= raw.columns), (raw.columns < p) & (row > raw.columns)

    def together(values: F32, power: int) -> sparse.csr_array:
        """(A_i × value)^power; an exact 0, which would be dropped from the pattern, counts as TINY."""
        sides = []
        for side, unit in ((upper, 1.0 + 0.0j), (lower, 1.0j)):
            mine = row[side]
            pointers = np.concatenate([[0], np.cumsum(np.bincount(mine, minlength=p))])
            data = unit * ((area[mine] * values[side]) ** power + TINY)
            sides.append(sparse.csr_array((data, raw.columns[side], pointers), shape=(p, p)))
        turned = sides.pop().T.tocsr()
        return (sides.pop() + turned).tocsr()

    flow, squared = together(raw.values[:, 0], 1), together(raw.se[:, 0], 2)
    lo = np.repeat(np.arange(p, dtype=np.int32), np.diff(flow.indptr))
    return lo, flow.indices.astype(np.int32), flow.data, squared.data


def _outside(raw: FormFactors, area: F64, weight: F64) -> tuple[I32, I32, F64, F32, F32]:
    """Rows, columns, flows, variances and squared errors of what goes to sky and absorbed columns."""
    row = np.repeat(np.arange(raw.rows, dtype=np.int32), np.diff(raw.indptr))
    at = np.flatnonzero(raw.columns >= raw.rows)
    row, column = row[at], raw.columns[at]
    x = area[row] * raw.values[at, 0]
    return row, column, x, (x / weight[row]).astype(np.float32), ((area[row] * raw.se[at, 0]) ** 2).astype(np.float32)


def without_entries(rows: FormFactors) -> FormFactors:
    """The same receivers, ray counts and back shares, and no entries."""
    empty = np.zeros((0, rows.values.shape[1]), dtype=np.float32)
    indptr = np.zeros(rows.rows + 1, dtype=np.int64)
    return FormFactors(indptr, np.zeros(0, np.int32), empty, rows.patches, rows.back_share, rows.rays, empty)


def rounding_defect(f: Flows, area: F64) -> float:
    """Reciprocity defect that is left when rows hold A_i F_ij / A_i in single precision."""
    other = f.lo != f.hi
    x, lo, hi = f.x[other], area[f.lo[other]], area[f.hi[other]]
    seen = [a * (x / a).astype(np.float32) for a in (lo, hi)]
    total = float(seen[0].sum() + seen[1].sum() + f.x[~other].sum())
    return 2.0 * float(np.abs(seen[0] - seen[1]).sum()) / total if total > 0.0 else 0.0


def rows_of_flows(f: Flows, area: F64, like: FormFactors) -> FormFactors:
    """Rows of form factors; ray counts and back shares as those of `like`."""
    p = len(area)
    upper = f.pointers(p)
    turned = sparse.csr_array((np.arange(1, len(f.lo) + 1, dtype=np.int32), f.hi, upper), shape=(p, p)).T.tocsr()
    row = np.repeat(np.arange(p, dtype=np.int32), np.diff(turned.indptr))
    turned.data[row == turned.indices] = 0  # the diagonal is in `upper`
    turned.eliminate_zeros()
    parts = (
        (turned.indptr, turned.indices, turned.data - 1, f.x, f.spread),
        (upper, f.hi, slice(None), f.x, f.spread),
        (np.searchsorted(f.out_row, np.arange(p + 1)), f.out_column, slice(None), f.out_x, f.out_spread),
    )
    del turned, row
    lengths = sum(np.diff(pointers).astype(np.int64) for pointers, *_ in parts)
    indptr = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(lengths)])
    columns = np.empty(indptr[-1], dtype=np.int32)
    values, se = np.empty((indptr[-1], 1), dtype=np.float32), np.empty((indptr[-1], 1), dtype=np.float32)
    begin = indptr[:-1]
    for pointers, column, which, x, spread in parts:
        length = np.diff(pointers)
        at = np.repeat(begin - pointers[:-1], length)
        at += np.arange(len(column))
        columns[at] = column
        values[at, 0] = x[which] / np.repeat(area, length)
        se[at, 0] = np.sqrt(spread[which]) / np.repeat(area, length)
        begin = begin + length
    return FormFactors(indptr, columns, values, like.patches, like.back_share, like.rays, se)
