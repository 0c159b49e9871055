"""What a row of rays knows better than its entries: how much it sees of a group of neighbouring patches as a whole.

Low-discrepancy rays err only where an outline cuts their strata. Within a group of patches, what one patch gets too much its
neighbour gets too little: the sum over the group is wrong by its outline alone. For a row of N rays

    var Σ_j∈g F_ij  ≈  1 / (1 / v + 1 / h),   v = Σ_j∈g F_ij / N,   h = c N^-1.25

(N^(-1 - 1/d) for indicators in d = 4 dimensions: He and Wang 2015, "On the convergence rate of randomized quasi-Monte Carlo for
discontinuous functions"). That is the variance that entries of independent variances F_ij / N have together with one more,
independent observation of their sum, of variance h. So each row adds to the averaged flows x of `flows.py` the observations
Σ_j∈g x_ij = s_ig of its own rays. Generalised least squares with these and exact closure Σ_j x_ij = A_i is best among linear
unbiased estimators for this covariance (Gauss-Markov theorem, Aitken 1936):

    x = x₀ + v_ij (λ_i + μ_ig(j) + λ_j + μ_jg(i)),    Σ_j v_ij (…) = A_i - Σ_j x₀_ij,    Σ_j∈g v_ij (…) + h_ig μ_ig = s_ig - Σ_j∈g x₀_ij

c is measured where there is enough to measure: flows between two groups are seen from both sides by rays that are independent of
each other. v is what `se` shows of single entries, over all of them (about half of the binomial's variance).
Groups are runs of consecutive patches of which no ray saw one from another: flat or convex pieces of surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from ..datatypes import F32, F64, I32, I64
from .flows import Flows, row_sums

RATE = 1.25
USUAL = 0.16  # c of rooms
COUNTS_AS = 36  # pairs of groups: so much USUAL weighs against what is measured
RANGE = (0.02, 20.0)  # in which c is looked for
LEAST_MEMBERS = 4  # entries per sum, in the mean, from which on sums are worth their memory
# What is left is a small share of a correction that is itself of the size of the noise; closing afterwards is exact.
TOLERANCE = 0.1
MAX_ITERATIONS = 60
RIDGE = 1e-8  # as in reconcile.py


class Sums(NamedTuple):
    """Sums of flows over groups, those of later patches (`upper`: per lo and group of hi) before those of earlier ones.

    row, group (S,) i32: patch that sees, group that is seen. upper_pointers (U + 1,): runs of pairs; lower (N,) i32: of each pair
    its sum among the lower ones, S - U in all.
    """

    row: I32
    group: I32
    upper_pointers: I64
    lower: I32

    @property
    def uppers(self) -> int:
        """U."""
        return len(self.upper_pointers) - 1

    def of(self, upper: F64 | F32, lower: F64 | F32) -> F64:
        """(S,): sums over what lo sees of each pair, `upper` (N,), and over what hi sees, `lower` (N,)."""
        first = np.add.reduceat(upper, self.upper_pointers[:-1], dtype=np.float64)
        return np.concatenate([first, np.bincount(self.lower, lower, len(self.row) - self.uppers)])


def groups_of(lo: I32, hi: I32, patches: int) -> I32:
    """Group of each patch, (P,) i32, ascending: runs of patches that do not see one another. Pairs sorted by lo."""
    last = np.full(patches, -1, dtype=np.int64)  # the latest earlier patch that it sees
    other = lo != hi
    last[hi[other]] = lo[other]  # of equal places the last one stays
    group, begin = np.zeros(patches, dtype=np.int32), 0
    for patch in range(1, patches):
        new = last[patch] >= begin
        begin = patch if new else begin
        group[patch] = group[patch - 1] + new
    return group


def sums_of(lo: I32, hi: I32, group: I32) -> Sums:
    """Which sums there are. Pairs sorted by lo, then hi, without those of a patch and itself."""
    p = len(group)
    begins = _begins(lo, group[hi])
    pointers = np.searchsorted(lo, np.arange(p + 1))
    turned = sparse.csr_array((np.arange(len(lo), dtype=np.int32), hi, pointers), shape=(p, p)).T.tocsr()
    row = np.repeat(np.arange(p, dtype=np.int32), np.diff(turned.indptr))
    first = _begins(row, group[turned.indices])
    lower = np.empty(len(lo), dtype=np.int32)
    lower[turned.data] = np.repeat(np.arange(len(first), dtype=np.int32), np.diff(first, append=len(lo)))
    return Sums(
        np.concatenate([lo[begins], row[first]]),
        np.concatenate([group[hi[begins]], group[turned.indices[first]]]),
        np.append(begins, len(lo)),
        lower,
    )


def _begins(row: I32, group: I32) -> I64:
    """Places where a run of equal (row, group) begins."""
    return np.flatnonzero((np.diff(row, prepend=-1) != 0) | (np.diff(group, prepend=-1) != 0))


def with_group_sums(f: Flows, difference: F32, area: F64, rays: I64) -> Flows:
    """Flows bent towards what rows know of groups, closed to about TOLERANCE of what they lacked.

    f: averaged flows. difference (N,) m²: of each pair, flow as lo sees it less flow as hi sees it. area (P,) m²; rays (P,).
    """
    group = groups_of(f.lo, f.hi, len(area))
    other = f.lo != f.hi
    lo, hi, v, x = f.lo[other], f.hi[other], f.variance[other], f.x[other]
    if len(_begins(lo, group[hi])) * LEAST_MEMBERS >= len(lo):  # also where there is no pair
        return f
    sums = sums_of(lo, hi, group)
    weight = rays / area
    share = weight[lo] / (weight[lo] + weight[hi])  # of lo's estimate in the average
    differ = difference[other]
    lacks = sums.of((1.0 - share) * differ, -share * differ)  # s - Σ x₀
    unit = (area**2 * rays**-RATE)[sums.row]
    own = sums.of(x, x) / weight[sums.row]
    kept = _kept(f)
    h = _measured(sums, group, sums.of(differ, np.zeros_like(x)), kept * own, unit) / kept * unit
    multiplier, of_row = _multipliers(f, sums, v, lacks, h, area)
    bent = f.x.copy()
    uppers = np.repeat(multiplier[: sums.uppers], np.diff(sums.upper_pointers))
    bent[other] += v * (uppers + multiplier[sums.uppers :][sums.lower])
    bent[~other] += f.variance[~other] * of_row[f.lo[~other]]
    return f._replace(x=bent, out_x=f.out_x + f.out_variance * of_row[f.out_row])


def _kept(f: Flows) -> float:
    """Share of a binomial's variance that replicates show in single entries: what v stands for is this much smaller."""
    spread, variance = (float(v.sum(dtype=np.float64)) for v in (f.spread, f.variance))
    return spread / variance if spread > 0.0 and variance > 0.0 else 1.0


def _measured(sums: Sums, group: I32, differ: F64, own: F64, unit: F64) -> float:
    """c, from how far both views of the flow between two groups differ: Σ over pairs of groups of difference² / variance is
    their number. differ (S,) m²: difference of the pairs in an upper sum. own (S,) m⁴: v. unit (S,): h for c = 1."""
    one, two = group[sums.row].astype(np.int64), sums.group
    of_pair = np.minimum(one, two) * (int(group[-1]) + 1) + np.maximum(one, two)
    _, pair = np.unique(of_pair, return_inverse=True)
    squared = np.bincount(pair, differ) ** 2
    # Where h is far above v anyway, nothing can be learnt.
    tells = np.bincount(pair, own) > USUAL * np.bincount(pair, unit)
    if not tells.any():
        return USUAL

    def excess(c: float) -> float:
        return float((squared / np.bincount(pair, own * c * unit / (own + c * unit)))[tells].mean()) - 1.0

    low, high = np.log(RANGE)
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(float(np.exp(middle))) > 0.0 else (low, middle)
    trust = tells.sum() / (tells.sum() + COUNTS_AS)
    return float(USUAL * np.exp(trust * (0.5 * (low + high) - np.log(USUAL))))


def _multipliers(f: Flows, sums: Sums, v: F32, lacks: F64, h: F64, area: F64) -> tuple[F64, F64]:
    """λ_i + μ_ig (S,) and λ_i (P,), by conjugate gradients. Each row's own block is solved outright as a preconditioner."""
    p, s, u = len(area), len(sums.row), sums.uppers
    pairs = sparse.csr_array((v, sums.lower, sums.upper_pointers), shape=(u, s - u))
    turned = pairs.T  # no copy
    of_sum = sums.of(v, v)
    own = f.lo == f.hi
    alone = np.bincount(f.out_row, f.out_variance, p) + np.bincount(f.lo[own], f.variance[own], p)
    alone = alone + RIDGE * np.bincount(sums.row, of_sum, p)
    inverse = 1.0 / np.maximum(of_sum + h, np.finfo(float).tiny)
    whole = alone + np.bincount(sums.row, of_sum * h * inverse, p)
    whole_inverse = np.where(whole > 0.0, 1.0 / np.where(whole > 0.0, whole, 1.0), 0.0)

    def product(y: F64) -> F64:
        of_row, mine = y[:p], y[p:]
        both = mine + of_row[sums.row]
        bent = of_sum * both
        bent[:u] += np.asarray(pairs @ both[u:])
        bent[u:] += np.asarray(turned @ both[:u])
        return np.concatenate([np.bincount(sums.row, bent, p) + alone * of_row, bent + h * mine])

    def solved_by_rows(y: F64) -> F64:
        mine = y[p:] * inverse
        of_row = (y[:p] - np.bincount(sums.row, of_sum * mine, p)) * whole_inverse
        return np.concatenate([of_row, mine - of_sum * inverse * of_row[sums.row]])

    n = p + s
    right = np.concatenate([area - row_sums(f, p), lacks])
    y, _ = cg(
        LinearOperator((n, n), matvec=product, dtype=float), right, rtol=TOLERANCE, maxiter=MAX_ITERATIONS,
        M=LinearOperator((n, n), matvec=solved_by_rows, dtype=float),
    )  # fmt: skip
    return y[p:] + y[:p][sums.row], y[:p]
