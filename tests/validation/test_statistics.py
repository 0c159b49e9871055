"""Sampling statistics against closed forms, simulation and SciPy; decisions at the rates they promise.

Every tolerance of a simulated rate is about four of its own standard errors, so that another seed passes too.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.validation.statistics.blocks import block_sums, near_blocks
from lightgauge.validation.statistics.bootstrap import bootstrap
from lightgauge.validation.statistics.equivalence import equivalent, tost
from lightgauge.validation.statistics.jackknife import jackknife_se, mixed_blocks
from lightgauge.validation.statistics.plan import (
    UNDECIDABLE,
    Sequential,
    obrien_fleming,
    samples_needed,
    samples_to_decide,
)
from lightgauge.validation.statistics.welch import biased_blocks, holm, welch
from scipy.stats import ttest_ind


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    """With one point a block the jackknife of the mean is s/√n exactly; of several statistics at once it has their shape."""
    x = np.random.default_rng(1).normal(size=15)
    se = jackknife_se(lambda keep: np.array([x[keep].mean(), 3.0 * x[keep].mean()]), mixed_blocks(len(x)))
    assert se == pytest.approx(np.array([1.0, 3.0]) * x.std(ddof=1) / np.sqrt(len(x)), rel=1e-12)
    assert jackknife_se(lambda keep: float(keep.sum()), np.zeros(4, np.int64)) == 0.0


def test_bootstrap_of_a_percentile_covers() -> None:
    """90th percentile of 400 exponential numbers, ln 10: the 95 % interval holds it in 89 to 99 % of 200 samples."""
    rng, hits = np.random.default_rng(2), 0
    for _ in range(200):
        x = rng.exponential(size=400)
        b = bootstrap(lambda d, x=x: np.percentile(x[d], 90, axis=1), len(x), draws=200)
        hits += b.low <= np.log(10.0) <= b.high
    assert 178 <= hits <= 198, hits
    with pytest.raises(ValueError, match="at least 1 point"):
        bootstrap(lambda d: d[:, 0] * 1.0, 0)


def test_welch_is_scipys() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(0, 1, (9, 40)), rng.normal(0.3, 2, (5, 40))
    mine = welch(a.mean(0), a.var(0, ddof=1) / 9, 9, b.mean(0), b.var(0, ddof=1) / 5, 5)
    assert mine == pytest.approx(ttest_ind(a, b, equal_var=False).pvalue, rel=1e-9)
    assert welch([1.0, 1.0], 0.0, 2, [1.0, 1.1], 0.0, 8).tolist() == [1.0, 0.0]
    assert welch(1e-155, 1e-320, 8, 0.0, 0.0, 8) < 1e-6  # squares of variances do not underflow


def test_holm_steps_down() -> None:
    """Holm's own order: 0.01 ≤ 0.05/4, 0.013 ≤ 0.05/3, 0.03 > 0.05/2 stops, and 0.04 is not asked."""
    assert holm(np.array([0.03, 0.01, 0.04, 0.013]), 0.05).tolist() == [False, True, False, True]
    assert not holm(np.ones(3), 0.05).any() and holm(np.zeros(3), 0.05).all() and holm(np.empty(0), 0.05).shape == (0,)


def test_blocks_are_neighbours_of_one_camera() -> None:
    positions = np.random.default_rng(4).random((1000, 3)) * [4.0, 1.0, 1.0]
    camera = np.repeat([0, 1], 500)
    block = near_blocks(positions, 25, camera)
    sizes = np.bincount(block)
    assert sizes.max() <= 25 and sizes.min() >= 12 and sizes.sum() == 1000
    assert all(len(np.unique(camera[block == b])) == 1 for b in range(len(sizes)))
    assert np.median([np.ptp(positions[block == b], axis=0).max() for b in range(len(sizes))]) < 1.0
    assert block_sums(np.ones((2, 1000, 3)), block)[1, :, 2] == pytest.approx(sizes)


def clean(rng: np.random.Generator, points: int = 500) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact light, noisy batches (noise of 0.3, light of 1), and blocks of 25 neighbours."""
    truth = rng.uniform(0.5, 1.5, (points, 3))
    return truth, truth + 0.3 * rng.normal(size=(8, points, 3)), np.repeat(np.arange(points // 25), 25)


def test_bias_of_a_block_is_found_and_rarely_elsewhere() -> None:
    """Any false find in at most 5 % of 200 clean runs (11 or more: 3 % by chance; 20: 1e-3); 30 % in one block always found."""
    rng, false, found = np.random.default_rng(5), 0, 0
    for _ in range(200):
        truth, batches, block = clean(rng)
        false += biased_blocks(truth, batches, block).biased.any()
        wrong = truth.copy()
        wrong[block == 7] *= 1.3
        found += bool(biased_blocks(wrong, batches, block).biased[7])
    assert false <= 22 and found >= 196, (false, found)


def test_noise_of_our_own_widens_the_test() -> None:
    rng = np.random.default_rng(6)
    truth, batches, block = clean(rng)
    own = truth + 3.0 * rng.normal(size=batches.shape)
    assert biased_blocks(own, batches, block).p.min() > biased_blocks(own.mean(axis=0), batches, block).p.min()
    with pytest.raises(ValueError, match="expected ours"):
        biased_blocks(truth, batches[:3], block)


def test_equivalence_accepts_only_what_is_shown() -> None:
    """At the edge of the limits the false yes has the level's rate, however noisy; what is noisy is never accepted."""
    rng = np.random.default_rng(7)
    x = 0.02 + 0.001 * rng.normal(size=(8, 20_000))  # exactly on the upper limit
    yes = equivalent(x.mean(0), x.std(0, ddof=1) / np.sqrt(8), 7, -0.02, 0.02).mean()
    assert yes == pytest.approx(0.05, abs=0.007)
    assert not equivalent(0.0, 1.0, 7, -0.02, 0.02) and equivalent(0.0, 0.001, 7, -0.02, 0.02)
    assert tost([0.0, 0.03], 0.0, 7, -0.02, 0.02).tolist() == [0.0, 1.0]
    with pytest.raises(ValueError, match="low ≤ high"):
        tost(0.0, 1.0, 7, 1.0, 0.0)


def test_plans() -> None:
    assert samples_needed(0.1, 100, 0.05) == 400
    assert samples_to_decide(1.0, 0.1, 100, 1.05, 2.0) == 1600
    assert samples_to_decide(1.0, 0.1, 100, 1.0) == UNDECIDABLE and samples_to_decide(1.0, 0.0, 100, 1.0) == 100
    with pytest.raises(ValueError, match="positive standard error"):
        samples_needed(0.1, 100, 0.0)


def test_bounds_are_the_published_ones() -> None:
    """Jennison and Turnbull 2000, table 2.3, α = 0.05: the constants of O'Brien and Fleming at 1, 2, 5 and 10 looks."""
    for looks, constant in ((1, 1.960), (2, 1.977), (5, 2.040), (10, 2.087)):
        assert obrien_fleming(looks, 0.05)[-1] == pytest.approx(constant, abs=6e-4)


def test_looking_often_errs_no_more_than_promised() -> None:
    """On the limit 5 % of runs are decided, in all five looks together; far from it nearly all, and before the last look."""
    rng, stop = np.random.default_rng(8), Sequential(0.0, 5)
    walks = rng.normal(size=(4000, 5)).cumsum(axis=1) / np.arange(1, 6)
    for shift, low, high, early in ((0.0, 0.036, 0.064, 0.0), (2.5, 0.99, 1.0, 0.9)):
        ends = [next((k for k in range(1, 6) if stop.decide(w[k - 1] + shift, k**-0.5, k)), 0) for w in walks]
        assert low <= np.mean(np.array(ends) > 0) <= high
        assert np.mean((np.array(ends) > 0) & (np.array(ends) < 5)) >= early
    assert stop.decide(9.0, 1.0, 5) == "over" and stop.decide(-9.0, 1.0, 5) == "under"
    with pytest.raises(ValueError, match="look must be"):
        stop.decide(0.0, 1.0, 6)


def test_a_spread_of_few_samples_does_not_decide_too_often() -> None:
    """4 samples at the first of 4 looks, of a value on the limit: with the spread taken for known, far more decisions than allowed."""
    rng, trials, alpha = np.random.default_rng(3), 800, 0.05
    samples = rng.standard_normal((trials, 16))
    stop = Sequential(0.0, 4, alpha)
    wrong = {True: 0, False: 0}
    for careful in wrong:
        for row in samples:
            for look in range(1, 5):
                seen = row[: 4 * look]
                se = float(seen.std(ddof=1)) / math.sqrt(len(seen))
                if stop.decide(float(seen.mean()), se, look, len(seen) - 1 if careful else math.inf):
                    wrong[careful] += 1
                    break
    assert wrong[True] / trials <= alpha + 4.0 * math.sqrt(alpha / trials)
    assert wrong[False] / trials > 1.3 * alpha
