"""Intervals by drawing points with replacement (Efron 1979, "Bootstrap methods: another look at the jackknife").

For percentiles: leaving out one block moves a sample percentile by one order statistic or not at all, so the jackknife is not
consistent there (Miller 1974, "The jackknife: a review"). The interval is the percentile interval: quantiles of the drawn values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64

DRAWS = 400
AT_ONCE = 1 << 20  # points drawn at a time


@dataclass(frozen=True)
class Bootstrapped:
    """se: standard deviation of the drawn values. low, high: the interval, in the statistic's unit."""

    se: float
    low: float
    high: float


def bootstrap(
    statistic: Callable[[I64], F64], n: int, seed: int = 0, draws: int = DRAWS, level: float = 0.95
) -> Bootstrapped:
    """Spread of `statistic`: numbers of the points drawn (K, n) -> its value for each of the K draws (K,). n: points there are.

    A percentile of a few points only is a maximum, whose upper side no resampling can see: interpret with n(1 - p) ≥ 5 or so.
    Raises ValueError without points or with fewer than 2 draws.
    """
    if n < 1 or draws < 2:
        raise ValueError(f"expected at least 1 point and 2 draws, got {n} and {draws}")
    rng = np.random.default_rng([seed, 61])
    step = max(1, AT_ONCE // n)
    parts = [statistic(rng.integers(n, size=(min(step, draws - done), n))) for done in range(0, draws, step)]
    values = np.concatenate(parts)
    low, high = np.quantile(values, [0.5 - level / 2.0, 0.5 + level / 2.0])
    return Bootstrapped(float(values.std(ddof=1)), float(low), float(high))
