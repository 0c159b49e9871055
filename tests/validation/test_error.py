"""The error metric on made-up data with known answers: bias, intervals, the noise floor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.validation.metrics.error import (
    cross_half_mse,
    jackknife,
    measure_error,
    measure_rel_rmse,
    reference_noise,
    rel_rmse,
    signed_bias,
    worst_case,
    worst_points,
)

B, N = 8, 400


def made(seed: int, noise: float, error: float, n: int = N) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ours, batches and the exact truth: truth 1 … 2, normal error of relative size `error`, heteroscedastic noise."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(1, 2, (n, 3))
    ours = truth + error * rng.normal(size=(n, 3))
    batches = truth + noise * rng.uniform(0.2, 1.8, (1, n, 1)) * rng.normal(size=(B, n, 3))
    return ours, batches, truth


def test_cross_half_estimator_is_unbiased_under_noise() -> None:
    """Noise of 0.5, error of 0.05: the plain MSE would read 0.5² / 8 = 12 × too much. Mean of 400 seeds within 4 standard
    errors of the exact MSE: error rate 6e-5."""
    z = []
    for seed in range(400):
        ours, batches, truth = made(seed, 0.5, 0.05)
        z.append(cross_half_mse(ours, batches) - float(np.mean((ours - truth) ** 2)))
    values = np.asarray(z)
    assert abs(values.mean()) < 4 * values.std(ddof=1) / math.sqrt(len(values))
    assert values.std() > 0


def test_noise_free_values_are_exact() -> None:
    ours, batches, truth = made(1, 0.0, 0.1)
    exact = math.sqrt(float(np.mean((ours - truth) ** 2))) / truth.mean()
    assert rel_rmse(ours, batches) == pytest.approx(exact, rel=1e-12)
    assert signed_bias(1.1 * truth, batches) == pytest.approx(0.1, rel=1e-9)
    assert worst_case(truth + np.arange(N)[:, None] / N, batches) == pytest.approx(0.9875 / truth.mean(), rel=0.01)


def test_per_batch_values_are_split_like_the_reference() -> None:
    """Ours estimated from batches of its own, without error: unbiased zero although each batch is noisy."""
    z = []
    for seed in range(300):
        _, batches, truth = made(seed, 0.3, 0.0)
        own = truth + 0.4 * np.random.default_rng(seed + 10_000).normal(size=batches.shape)
        z.append(cross_half_mse(own, batches))
    assert abs(np.mean(z)) < 4 * np.std(z, ddof=1) / math.sqrt(len(z))


@pytest.mark.parametrize("noise, error", [(0.05, 0.1), (0.3, 0.1), (0.5, 0.2)])
def test_intervals_of_the_error_cover(noise: float, error: float) -> None:
    """±1.96 se around relRMSE holds the population's value (points are drawn anew each time) in 86 to 99 % of 200 seeds. It does so
    in 93.2 % of 3,000, as 20 blocks let it; of such a coverage 200 seeds leave the range once in 10,000 times."""
    mean, hits = 1.5, 0
    for seed in range(200):
        ours, batches, _ = made(seed, noise, error)
        found = measure_rel_rmse(ours, batches)
        hits += abs(found.value - error / mean) < 1.96 * found.se
    assert 172 <= hits <= 198, f"{hits / 2} % covered"


def test_intervals_of_the_bias_cover() -> None:
    hits = 0
    for seed in range(200):
        ours, batches, _ = made(seed, 0.3, 0.1)
        value, se = signed_bias(ours * 1.02, batches), jackknife(signed_bias, ours * 1.02, batches)
        hits += abs(value - 0.02) < 1.96 * se
    assert 172 <= hits <= 200, f"{hits / 2} % covered"  # as above


def test_noise_of_the_reference_knows_its_own_spread() -> None:
    """Noise that differs threefold from point to point, over 200 seeds: the claimed standard error against the real spread, 0.95 ± 0.06
    of it over ten such sets. Equal noise everywhere, which it might assume, would claim a third."""
    values, claimed = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        uneven = 0.1 * np.exp(0.5 * rng.normal(size=(300, 1)))
        found = reference_noise(1.0 + uneven * np.repeat(rng.normal(size=(8, 300, 1)), 3, axis=2))
        values.append(found.value)
        claimed.append(found.se)
    assert np.mean(claimed) == pytest.approx(np.std(values, ddof=1), rel=0.35)
    assert np.mean(values) == pytest.approx(0.1 * math.exp(0.5**2) / math.sqrt(8.0), rel=0.02)


def test_standard_error_is_the_spread() -> None:
    """The mean of the claimed standard error against the real spread over 300 seeds, where noise decides: neither half nor
    double (the spread itself is known to 4 %)."""
    values, claimed = [], []
    for seed in range(300):
        ours, batches, _ = made(seed, 0.5, 0.05)
        values.append(cross_half_mse(ours, batches))
        claimed.append(jackknife(cross_half_mse, ours, batches))
    ratio = float(np.mean(claimed) / np.std(values, ddof=1))
    assert 0.8 < ratio < 1.5, ratio


def test_exact_values_are_below_the_noise_floor() -> None:
    """Ours = truth: flagged in nearly all of 200 seeds (2 se: 2.3 % by chance)."""
    flagged = sum(measure_rel_rmse(t, b).below_noise for _, b, t in (made(s, 0.3, 0.0) for s in range(200)))
    assert flagged >= 188, flagged


def test_a_clear_error_is_not_below_the_noise_floor() -> None:
    assert not any(measure_rel_rmse(o, b).below_noise for o, b, _ in (made(s, 0.1, 0.2) for s in range(50)))


def test_a_one_percent_scale_is_seen_as_bias() -> None:
    """Without other error, 1 % is many standard errors at 2 % noise."""
    _, batches, truth = made(3, 0.05, 0.0, 1000)
    found = measure_error(1.01 * truth, batches)["bias"]
    assert found.value == pytest.approx(0.01, abs=4 * found.se) and found.value > 5 * found.se


def test_bad_shapes_and_a_dark_reference_are_refused() -> None:
    ours, batches, _ = made(1, 0.1, 0.1)
    for bad in ((ours[:-1], batches), (ours, batches[:3]), (ours, batches[0])):
        with pytest.raises(ValueError, match="expected ours"):
            measure_error(*bad)
    with pytest.raises(ValueError, match="dark everywhere"):
        measure_error(ours, 0 * batches)


def test_worst_points_ignore_noise() -> None:
    _, batches, truth = made(5, 0.05, 0.0)
    ours = truth.copy()
    ours[17] += 1.0
    ours[200] -= 2.0
    assert worst_points(ours, batches).tolist()[:2] == [200, 17]
    assert (
        len(worst_points(truth, batches, 400)) < 40
    )  # 0.3 % by chance for 3 sigma and 3 colours, t with 7 degrees: 6 %
