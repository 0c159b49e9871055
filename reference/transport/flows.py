"""Flows x_ij = A_i F_ij between patches, each pair once, and back to rows of form factors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..datatypes import F64, I64
from .form_factors import FormFactors


class Flows(NamedTuple):
    """lo, hi (N,) i64: patches of a pair, lo ≤ hi, sorted by lo, then hi. x (N,) m²: A_i F_ij = A_j F_ji.

    variance (N,): what least squares may bend, m⁴; spread (N,): measured variance from replicates, m⁴.
    out_row, out_column (M,): patch and column (sky bins, absorbed), sorted; out_x, out_variance, out_spread likewise.
    """

    lo: I64
    hi: I64
    x: F64
    variance: F64
    spread: F64
    out_row: I64
    out_column: I64
    out_x: F64
    out_variance: F64
    out_spread: F64

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
    p = raw.rows
    row = np.repeat(np.arange(p), np.diff(raw.indptr))
    flow = area[row] * raw.values[:, 0].astype(np.float64)
    spread = (area[row] * raw.se[:, 0]) ** 2
    weight = raw.rays / area
    outside = raw.columns >= p
    inside = np.flatnonzero(~outside)
    i, j = row[inside], raw.columns[inside].astype(np.int64)
    key = np.minimum(i, j) * p + np.maximum(i, j)
    order = np.argsort(key, kind="stable")
    key, inside, upper = key[order], inside[order], (i <= j)[order]
    start = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])) if len(key) else np.zeros(0, np.int64)
    pair = np.cumsum(np.concatenate([[0], key[1:] != key[:-1]])) if len(key) else np.zeros(0, np.int64)
    lo, hi = key[start] // p, key[start] % p
    one, two = (np.bincount(pair[side], flow[inside[side]], len(start)) for side in (upper, ~upper))
    s_one, s_two = (np.bincount(pair[side], spread[inside[side]], len(start)) for side in (upper, ~upper))
    w_lo, w_hi = weight[lo], np.where(lo == hi, 0.0, weight[hi])
    x = (w_lo * one + w_hi * two) / (w_lo + w_hi)
    s = (w_lo**2 * s_one + w_hi**2 * s_two) / (w_lo + w_hi) ** 2
    out = np.flatnonzero(outside)
    flows = Flows(
        lo, hi, x, x / (w_lo + w_hi), s, row[out], raw.columns[out].astype(np.int64), flow[out],
        flow[out] / weight[row[out]], spread[out],
    )  # fmt: skip
    total = float(flow[inside].sum())
    different = 2.0 * float(np.abs(one - two)[lo != hi].sum())
    return flows, different / total if total > 0.0 else 0.0


def rows_of_flows(f: Flows, area: F64, like: FormFactors) -> FormFactors:
    """Rows of form factors; ray counts and back shares as those of `like`."""
    p = len(area)
    upper = sparse.csr_array((np.arange(1, len(f.lo) + 1), f.hi, f.pointers(p)), shape=(p, p))
    lower = upper.T.tocsr()
    lower.data[np.repeat(np.arange(p), np.diff(lower.indptr)) == lower.indices] = 0  # the diagonal is in `upper`
    lower.eliminate_zeros()
    out_pointers = np.searchsorted(f.out_row, np.arange(p + 1))
    lengths = [np.diff(q) for q in (lower.indptr, upper.indptr, out_pointers)]
    indptr = np.concatenate([[0], np.cumsum(sum(lengths))]).astype(np.int64)
    columns, number = np.empty(indptr[-1], dtype=np.int32), np.empty(indptr[-1], dtype=np.int64)
    begin = indptr[:-1]
    parts = (
        (lower.indices, lower.data - 1, lower.indptr),
        (upper.indices, upper.data - 1, upper.indptr),
        (f.out_column, len(f.lo) + np.arange(len(f.out_row)), out_pointers),
    )
    for (column, source, pointers), length in zip(parts, lengths, strict=True):
        at = np.repeat(begin - pointers[:-1], length) + np.arange(len(column))
        columns[at], number[at] = column, source
        begin = begin + length
    row = np.repeat(np.arange(p), np.diff(indptr))
    values = np.concatenate([f.x, f.out_x])[number] / area[row]
    se = np.sqrt(np.concatenate([f.spread, f.out_spread])[number]) / area[row]
    return FormFactors(
        indptr, columns, values.astype(np.float32)[:, None], like.patches, like.back_share, like.rays,
        se.astype(np.float32)[:, None],
    )  # fmt: skip
