"""Culling by form factors (talk, "Compare form factors"): probes whose light is what interpolation gives anyway become virtual.

A probe is judged by how far its row is from the one mixed from its *reconstructed* parents, which may be culled themselves, so
that errors do not add up unseen (failure-catalogue D7). Its predicted damage is

    damage_i = reading_i · ‖F_i - Σ_j A_ij F̂_j‖²        reading_i: share of the points' light that comes from probe i

With reading weights that sum to one, Σ damage_i over the culled probes bounds the mean squared change at the points from above
(Jensen), whatever the sum of neighbours does. The norm is one of `norms.NORMS`. Everything under a threshold is culled, coarse
levels first.

The threshold is the largest found by halving at which few single patches (LOOSE) raise the error by more than the target. Then
those are mended: the probes to blame are given back (`mending`). What is left is held before a second judge, with points and rays
of its own: it says what lightings and places that nothing was chosen by will find. Where that is too much (SPARE, LIT_SPARE),
smaller thresholds are tried, by halving; at last what the second judge still finds is mended too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I32, I64, Bool
from .judge import Judge, Verdict
from .mending import given_back
from .norms import Difference, Norm

STEPS = 7
TRIALS = 6  # halvings of what is mended and checked; the first is with all that the first judge lets through
MENDS = 3  # rounds: the first leaves a tenth of the patches, the second a hundredth
ROWS_PER_PART = 2048
# Odds of going over the target that are let through. They are estimates from points and lightings that nothing is chosen by; but
# what the second judge finds is mended after it was asked, so others find 0.6 of it (0.4 to 0.8 over 11 choices in house).
LOOSE = 0.04  # single patches, before they are mended
SPARE = 0.025  # single patches: ten in a row then stay within the target five times of six
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
    of the second judge about just that, zeros where nothing goes; but its `over` is from before the last mending, which took it to 0
    at that judge's own points, and so foretells too much for others rather than nothing."""

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


def choose(c: Candidates, judge: Judge, check: Callable[[], Judge], target: float) -> Choice:
    """The most probes that may go. judge: to choose by; check: makes the one to check the choice with, who is asked for only where
    there is a choice."""
    able = np.flatnonzero(c.able)
    predicted = np.full(len(c.able), np.inf)
    predicted[able] = damage(c, c.parents[able], able)
    order = able[np.argsort(predicted[able], kind="stable")]
    most = _most(c, predicted, order, judge, target)
    none = Choice(np.zeros(len(c.able), dtype=np.bool_), 0.0, predicted, Verdict(0.0, 0.0, 0.0, 0.0))
    if most == 0:
        return none
    second, best = check(), none
    low, high = 0, 2 * most  # so that the first trial is with `most`
    for _ in range(TRIALS):
        middle = (low + high) // 2
        if middle == low or low == most:
            break
        threshold = float(predicted[order[middle - 1]])
        culled = mended(c, predicted <= threshold, threshold, judge, target)
        verdict = second(replaced(c, culled)[0], target)
        if verdict.over <= SPARE and verdict.lit_over <= LIT_SPARE:
            low, best = middle, Choice(culled, threshold, predicted, verdict)
        else:
            high = middle
    culled = mended(c, best.culled, np.inf, second, target)
    if not culled.any():
        return none
    final = second(replaced(c, culled)[0], target)
    return Choice(culled, best.threshold, predicted, dataclasses.replace(final, over=best.verdict.over))


def _most(c: Candidates, predicted: F64, order: I64, judge: Judge, target: float) -> int:
    """How many of `order` may be tried before they are mended."""
    low, high = 0, len(order) + 1
    for _ in range(STEPS):
        middle = (low + high) // 2
        if middle in (low, high):
            break
        threshold = float(predicted[order[middle - 1]])
        mix, _ = replaced(c, predicted <= threshold, threshold)
        verdict = judge(mix, target)
        if verdict.over <= LOOSE and verdict.lit_over <= LIT_SPARE:
            low = middle
        else:
            high = middle
    return low


def mended(c: Candidates, wanted: Bool, threshold: float, judge: Judge, target: float) -> Bool:
    """Which of `wanted` (R,) bool go, when those are given back that `judge` blames. threshold: see `replaced`."""
    mix, culled = replaced(c, wanted, threshold)
    for _ in range(MENDS):
        blame = judge.blame(mix, target)
        if not len(blame.excess):
            break
        mix, culled = replaced(c, culled & ~given_back(blame, culled))
    return culled


def interleaved(values: F32 | F64, indptr: I64, columns: I64, count: int) -> sparse.csr_array:
    """Rows (R, 4 · count) from entries `values` (nnz, 4) in `columns` (nnz,); what stands twice in a row adds up in every product."""
    at = (4 * columns[:, None] + np.arange(4)).ravel()
    return sparse.csr_array((values.ravel(), at, 4 * indptr), shape=(len(indptr) - 1, 4 * count))
