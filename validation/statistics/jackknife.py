"""Standard errors by leaving out one block at a time (Efron and Stein 1981, "The jackknife estimate of variance").

    se² = (G - 1) / G · Σ_g (θ_g - θ̄)²        θ_g: the statistic without block g of G

Blocks, not single points: it costs G evaluations, and points of one block may depend on each other. It holds for smooth statistics
(means, ratios, correlations, MSE), not for percentiles and maxima: those are for `bootstrap`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...reference.datatypes import F64, I64, Bool

POINT_BLOCKS = 20


def mixed_blocks(n: int, blocks: int = POINT_BLOCKS) -> I64:
    """Block (n,) of each of n points, equally many in each, one point a block if there are fewer points than blocks.

    Points come in a low-discrepancy or image order: they are mixed, always in the same way, so that every block covers the scene.
    """
    block = np.arange(n) * blocks // n if n >= blocks else np.arange(n)
    return np.random.default_rng(0).permutation(block)


def jackknife_se(statistic: Callable[[Bool], float | F64], block: I64) -> F64:
    """Standard error of `statistic`, whose argument says which points to keep, (N,) bool; shape as what it returns.

    block (N,): block of each point, numbers from 0. One block alone gives 0.
    """
    return se_of_rest([statistic(block != g) for g in range(int(block.max()) + 1 if len(block) else 0)])


def se_of_rest(values: Sequence[float | F64]) -> F64:
    """Standard error from the statistic's values, each without one block."""
    v = np.asarray(values, dtype=np.float64)
    if len(v) < 2:
        return np.zeros(v.shape[1:])
    return np.asarray(np.sqrt((len(v) - 1) / len(v) * ((v - v.mean(axis=0)) ** 2).sum(axis=0)))
