"""Culling by form factors (talk, "Compare form factors"): probes whose light is what interpolation gives anyway become virtual.

A probe is judged by how far its row is from the one mixed from its *reconstructed* parents, which may be culled themselves, so
that errors do not add up unseen (failure-catalogue D7). Its predicted damage is

    damage_i = reading_i · ‖F_i - Σ_j A_ij F̂_j‖²        reading_i: share of the points' light that comes from probe i

With reading weights that sum to one, Σ damage_i over the culled probes bounds the mean squared change at the points from above
(Jensen), whatever the sum of neighbours does. The norm is one of `norms.NORMS`. Everything under a threshold is culled, coarse
levels first; the threshold is the largest found by halving at which the judged error stays within the target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I32, I64, Bool
from .judge import Verdict
from .norms import Difference, Norm

STEPS = 7
ROWS_PER_PART = 2048
# Odds of going over the target that are let through. They are estimates from points and lightings that nothing is chosen by, so
# other points and lightings find about the same.
SPARE = 0.02  # single patches: ten in a row then stay within the target four times of five
LIT_SPARE = 0.025  # of the random lightings: one


@dataclass(frozen=True, eq=False)
class Candidates:
    """Probes that may be culled. level (R,) i32; able (R,) bool; parents (R, R): see `parents.Parents`. rows, variance (R, 4 C)
    sparse: form factors, four coefficients a column, and their variance by rays where the norm wants it; weights (C,): of the norm.
    reading (R,): see above."""

    level: I32
    able: Bool
    parents: sparse.csr_array
    norm: Norm
    rows: sparse.csr_array
    variance: sparse.csr_array | None
    weights: F64
    reading: F64


@dataclass(frozen=True, eq=False)
class Choice:
    """culled (R,) bool; threshold: largest damage let through; damage (R,): predicted, infinite where culling is not possible; verdict:
    of the judge."""

    culled: Bool
    threshold: float
    damage: F64
    verdict: Verdict


def damage(c: Candidates, mix: sparse.csr_array, chosen: I64) -> F64:
    """Predicted damage (n,) of probes `chosen` (n,) where row i is replaced by `mix` (n, R) @ rows."""
    found = [np.zeros(0)]
    for begin in range(0, len(chosen), ROWS_PER_PART):
        mine = chosen[begin : begin + ROWS_PER_PART]
        itself = sparse.csr_array((np.ones(len(mine)), (np.arange(len(mine)), mine)), shape=(len(mine), len(c.able)))
        part = (mix[begin : begin + ROWS_PER_PART] - itself).astype(np.float32).tocsr()
        delta = (part @ c.rows).tocsr()
        spread = None if c.variance is None else (part.power(2) @ c.variance).tocsr()
        found.append(c.reading[mine] * c.norm.of(Difference(delta, spread, c.weights)) ** 2)
    return np.concatenate(found)


def replaced(c: Candidates, wanted: Bool, threshold: float = np.inf) -> tuple[sparse.csr_array, Bool]:
    """G (R, R), whose row i says how probe i is mixed from those that stay, and which of `wanted` are culled: those whose damage
    is at most `threshold` after their parents were replaced."""
    count = len(wanted)
    mix = sparse.eye_array(count, dtype=np.float64, format="csr")
    culled = np.zeros(count, dtype=np.bool_)
    for level in np.unique(c.level[wanted]):
        mine = np.flatnonzero(wanted & (c.level == level))
        rows = (c.parents[mine] @ mix).tocsr()
        chained = c.parents[mine] @ culled.astype(np.float64) > 0.0  # their parents are no longer what they were
        again = np.flatnonzero(chained & np.isfinite(threshold))
        good = np.ones(len(mine), dtype=np.bool_)
        good[again] = damage(c, rows[again], mine[again]) <= threshold
        mine, rows = mine[good], rows[good]
        culled[mine] = True
        place = sparse.csr_array((np.ones(len(mine)), (mine, np.arange(len(mine)))), shape=(count, len(mine)))
        keep = np.ones(count)
        keep[mine] = 0.0
        mix = (sparse.diags_array(keep) @ mix + place @ rows).tocsr()
    return mix, culled


def choose(c: Candidates, judge: Callable[[sparse.csr_array, float], Verdict], target: float) -> Choice:
    """The most probes that may go. judge: verdict on a replacement G for the target."""
    able = np.flatnonzero(c.able)
    predicted = np.full(len(c.able), np.inf)
    predicted[able] = damage(c, c.parents[able], able)
    order = able[np.argsort(predicted[able], kind="stable")]
    best = Choice(np.zeros(len(c.able), dtype=np.bool_), 0.0, predicted, Verdict(0.0, 0.0, 0.0, 0.0))
    low, high = 0, len(order) + 1
    for _ in range(STEPS):
        middle = (low + high) // 2
        if middle in (low, high):
            break
        threshold = float(predicted[order[middle - 1]])
        wanted = np.zeros(len(c.able), dtype=np.bool_)
        wanted[order[:middle]] = True
        mix, culled = replaced(c, wanted, threshold)
        verdict = judge(mix, target)
        if verdict.over <= SPARE and verdict.lit_over <= LIT_SPARE:
            low, best = middle, Choice(culled, threshold, predicted, verdict)
        else:
            high = middle
    return best


def interleaved(values: F32 | F64, indptr: I64, columns: I64, count: int) -> sparse.csr_array:
    """Rows (R, 4 · count) from entries `values` (nnz, 4) in `columns` (nnz,); what stands twice in a row adds up in every product."""
    at = (4 * columns[:, None] + np.arange(4)).ravel()
    return sparse.csr_array((values.ravel(), at, 4 * indptr), shape=(len(indptr) - 1, 4 * count))
