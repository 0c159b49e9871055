"""How many samples a decision needs, and when to stop because it is made.

Standard errors fall with the root of the number of samples. A value that stands a distance d from a limit is decided at s standard
errors once se ≤ d/s:

    n' = n (s · se / d)²

Looking several times and stopping at the first clear answer errs more often than looking once. O'Brien and Fleming 1979, "A multiple
testing procedure for clinical trials", keep the whole chance at α with bounds c_k = C √(K/k) at look k of K: strict early, nearly the
plain bound at the end. C follows from the joint law of the looks' z-scores, a normal walk (Armitage, McPherson and Rowe 1969; Jennison
and Turnbull 2000, chapter 19), integrated step by step.
"""

from __future__ import annotations

import functools
import math
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import t as student_t

UNDECIDABLE = 10**15  # samples: what stands on its limit is decided by no number
GRID = 161


def samples_needed(se: float, n: int, wanted_se: float) -> int:
    """Samples for a standard error of `wanted_se`, when `n` give `se`. Raises ValueError unless `wanted_se` and `n` are positive."""
    if wanted_se <= 0.0 or n < 1:
        raise ValueError(f"expected a positive standard error and number of samples, got {wanted_se:g} and {n}")
    return min(math.ceil(n * (se / wanted_se) ** 2), UNDECIDABLE)


def samples_to_decide(value: float, se: float, n: int, limit: float, sigmas: float = 2.0) -> int:
    """Samples after which `value` stands `sigmas` standard errors from `limit`, if it stays where it is; UNDECIDABLE on the limit."""
    distance = abs(limit - value)
    if se == 0.0:
        return n
    # Not by division: a distance that underflows squared is undecidable, not an error.
    return UNDECIDABLE if distance < se * 1e-7 else samples_needed(se, n, distance / sigmas)


def student_bound(sigmas: float, df: float | None) -> float:
    """Student's quantile of the chance that `sigmas` has of the normal distribution, for a standard error that is estimated with `df`
    degrees of freedom; None: it is known. Infinite under one degree. Student 1908, "The probable error of a mean"."""
    if df is None or math.isinf(df):
        return sigmas
    return float(-student_t.ppf(ndtr(-sigmas), df)) if df >= 1.0 else math.inf


def samples_by_student(se: float, n: int, df: float | None, goal: float, sigmas: float) -> int:
    """Samples after which `sigmas` standard errors, by Student's quantile, are `goal`, where `n` samples give `se` with `df` degrees
    of freedom: more samples bring more of both. Raises ValueError unless `goal` and `n` are positive."""
    least = samples_needed(se, n, goal / sigmas)
    if df is None or math.isinf(df) or se == 0.0:
        return least

    def over(log_times: float) -> float:
        times = math.exp(log_times)
        return student_bound(sigmas, (df + 1.0) * times - 1.0) * se - goal * math.sqrt(times)

    low, high = math.log(2.0 / (df + 1.0)), math.log(UNDECIDABLE / n)
    if over(high) > 0.0:
        return UNDECIDABLE
    return math.ceil(n * math.exp(brentq(over, low, high))) if over(low) > 0.0 else least


class Sequential:
    """A comparison with `limit`, looked at up to `looks` times with equally many new samples before each look.

    alpha: chance, over all looks together, that a value on the limit is called over or under it. bounds: |z| that decides at each look.
    """

    def __init__(self, limit: float, looks: int, alpha: float = 0.05) -> None:
        if looks < 1 or not 0.0 < alpha < 1.0:
            raise ValueError(f"expected at least 1 look and 0 < alpha < 1, got {looks} and {alpha:g}")
        self.limit, self.looks, self.alpha = limit, looks, alpha
        self.bounds = obrien_fleming(looks, alpha)

    def decide(self, value: float, se: float, look: int, df: float = math.inf) -> Literal["over", "under"] | None:
        """What is known at look 1 … looks, from all samples so far; None: go on (or, at the last look, not shown). df: degrees of
        freedom that `se` is estimated with; the bound is then Student's quantile of the same chance, as a bound on z would be
        crossed several times too often by a spread that few samples happen to make small."""
        if not 1 <= look <= self.looks:
            raise ValueError(f"look must be 1 to {self.looks}, got {look}")
        reach = student_bound(self.bounds[look - 1], df) * se if se > 0.0 else 0.0
        if value - self.limit > reach:
            return "over"
        return "under" if self.limit - value > reach else None


@functools.lru_cache(maxsize=32)
def obrien_fleming(looks: int, alpha: float) -> tuple[float, ...]:
    """Bounds on |z| at looks 1 … looks that are crossed by chance with probability `alpha` in all."""
    c = brentq(lambda x: _crossing(tuple(x * math.sqrt(looks / k) for k in range(1, looks + 1))) - alpha, 0.1, 10.0)
    return tuple(float(c) * math.sqrt(looks / k) for k in range(1, looks + 1))


def _crossing(bounds: tuple[float, ...]) -> float:
    """Chance that the walk S_k = √k z_k of unit steps leaves its bounds at some look: density of the survivors, look by look."""
    edges = [b * math.sqrt(k) for k, b in enumerate(bounds, start=1)]
    x = np.linspace(-edges[0], edges[0], GRID)
    density = np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)
    crossed = 2.0 * float(ndtr(-edges[0]))
    for edge in edges[1:]:
        weight = _simpson(x) * density
        crossed += float((weight * (ndtr(x - edge) + ndtr(-edge - x))).sum())
        y = np.linspace(-edge, edge, GRID)
        density = np.exp(-0.5 * (y[:, None] - x[None]) ** 2) @ weight / math.sqrt(2.0 * math.pi)
        x = y
    return crossed


def _simpson(x: np.ndarray) -> np.ndarray:
    """Weights of Simpson's rule on an odd number of equal steps' ends."""
    weight = np.full(len(x), 2.0)
    weight[1::2], weight[0], weight[-1] = 4.0, 1.0, 1.0
    return weight * (x[1] - x[0]) / 3.0
