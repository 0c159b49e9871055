"""What case F5 measures: which test of a picture finds a small bias in the dark."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np
from scipy.stats import norm

from ...reference.datatypes import F64, I64
from ..statistics.equivalence import equivalent
from ..statistics.welch import biased_blocks
from .case import Reading

SIDE, BLOCK, BATCHES, SPP = 128, 16, 8, 32  # pixels a side, of a block; randomisations; samples per pixel
DARK, LIT, NOISE = (
    0.002,
    1.0,
    0.1,
)  # truth in the dark quarter and elsewhere; deviation of a sample relative to √(its mean)
ALPHA, WITHIN = 0.05, 0.02
Z_ALPHA, FLOOR = 0.01, 1e-4  # of Mitsuba's test: chance per picture, least variance of a pixel
RUNS, CLEAN_RUNS, CLEAN_SIDE = 40, 400, 64


def _truth(side: int) -> tuple[F64, I64]:
    """Mean (N, 3) of every pixel of a picture whose first quarter is dark, and its block (N,)."""
    y, x = (a.ravel() for a in np.mgrid[0:side, 0:side])
    mean = np.where((x < side // 2) & (y < side // 2), DARK, LIT)
    return np.repeat(mean[:, None], 3, axis=1), (y // BLOCK * (side // BLOCK) + x // BLOCK).astype(np.int64)


def _rendered(mean: F64, rng: np.random.Generator) -> F64:
    """BATCHES noisy pictures (B, N, 3) of SPP / BATCHES samples a pixel each."""
    sigma = NOISE * np.sqrt(mean) * math.sqrt(BATCHES / SPP)
    return np.asarray(mean + sigma * rng.normal(size=(BATCHES, *mean.shape)))


def z_test_finds(ours: F64, mean: F64, variance: F64) -> bool:
    """Mitsuba's test of pictures (`test_renders.py`): whether some pixel of `ours` (B, N, 3), SPP samples in all, differs from the
    reference (N, 3), which it takes for exact, by the variance (N, 3) of a sample, taken for at least FLOOR, at Z_ALPHA over all
    pixels (Šidák)."""
    z = np.abs(ours.mean(axis=0) - mean) * np.sqrt(SPP / np.maximum(variance, FLOOR))
    limit = -norm.ppf((1.0 - (1.0 - Z_ALPHA) ** (1.0 / z.size)) / 2.0)
    return bool((z > limit).any())


def _share(found: list[bool]) -> Reading:
    """A share of runs with its standard error; where all agree, that of one run more or less."""
    n, p = len(found), float(np.mean(found))
    return Reading(p, math.sqrt(max(p * (1.0 - p), 1.0 / n * (1.0 - 1.0 / n)) / n), n)


def dark_bias(bias: float, seed: int) -> Mapping[str, Reading]:
    """F5: light of `bias` added to the dark quarter of a picture: how often each test finds it, or accepts the picture."""
    mean, block = _truth(SIDE)
    dark = mean[:, 0] < LIT
    z, welch, accepted = [], [], []
    for run in range(RUNS):
        rng = np.random.default_rng([seed, 40, run])
        truth, ours = _rendered(mean, rng), _rendered(mean, rng)
        ours[:, dark] += bias
        z.append(z_test_finds(ours, mean, NOISE**2 * mean))
        welch.append(bool(biased_blocks(ours, truth, block, ALPHA).biased[np.unique(block[dark])].any()))
        apart = (ours - truth)[:, dark].mean(axis=(1, 2))
        se = float(apart.std(ddof=1)) / math.sqrt(BATCHES)
        accepted.append(bool(equivalent(float(apart.mean()), se, BATCHES - 1, -WITHIN * LIT, WITHIN * LIT, ALPHA)))
    return {
        "z-test per pixel": _share(z),
        "Welch on blocks": _share(welch),
        "accepted as within 2 %": _share(accepted),
        "Welch on blocks, nothing wrong": _false_finds(seed),
    }


@cache
def _false_finds(seed: int) -> Reading:
    """Share of runs in which blocks are called biased though nothing is."""
    mean, block = _truth(CLEAN_SIDE)
    rng = np.random.default_rng([seed, 41])
    found = [bool(biased_blocks(_rendered(mean, rng), _rendered(mean, rng), block, ALPHA).biased.any())
             for _ in range(CLEAN_RUNS)]  # fmt: skip
    return _share(found)
