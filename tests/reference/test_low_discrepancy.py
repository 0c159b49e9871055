"""Owen-scrambled Sobol points: the raw table, what every scramble keeps, and that scrambles are independent."""

from __future__ import annotations

import math
from itertools import pairwise, permutations
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference import low_discrepancy as ld
from lightgauge.reference.variant import ensure_variant
from scipy.stats import qmc

Array = npt.NDArray[Any]
M = 8  # points are 2^M
PROJECTIONS = ((0, 1), (0, 2), (1, 2))


def points_of(count: int, seeds: Array, dimension: int) -> Array:
    """Coordinate `dimension` of the first `count` points under seeds (...,): (..., count), from the device."""
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    lane = dr.arange(mi.UInt32, count * seeds.size)
    seed = dr.gather(mi.UInt32, mi.UInt32(np.ascontiguousarray(seeds.ravel())), lane // count)
    found = ld.scrambled(ld.sobol_table(count), lane % count, seed, dimension)
    return np.array(found, dtype=np.float64).reshape(*seeds.shape, count)


def seeds_of(receivers: Array, replicates: Array, seed: int) -> Array:
    with np.errstate(over="ignore"):
        made = ld.receiver_seeds(receivers.astype(np.uint32), replicates.astype(np.uint32), np.uint32(seed))
    return np.asarray(made, dtype=np.uint32)


def shares(x: Array, y: Array, a: int, b: int) -> Array:
    """Points in each elementary interval of 2^-a × 2^-b."""
    cell = (x * 2**a).astype(int) * 2**b + (y * 2**b).astype(int)
    return np.bincount(cell, minlength=2 ** (a + b))


@pytest.mark.parametrize("count", [1, 2, 16, 1024])
def test_raw_points_are_scipys(count: int) -> None:
    """SciPy walks them in Gray-code order; every power of two ends on the same set."""
    theirs = qmc.Sobol(ld.DIMENSIONS, scramble=False, bits=32).random(count)
    ours = ld.sobol_points(count).astype(np.float64) * 2.0**-32
    index = np.arange(count)
    np.testing.assert_array_equal(ours[index ^ (index >> 1)], theirs)


def test_counts_must_be_powers_of_two() -> None:
    for count in (0, 3, 48):
        with pytest.raises(ValueError, match=f"power of two, got {count}"):
            ld.sobol_table(count)


def test_seeds_on_the_device_are_those_of_numpy() -> None:
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    receivers = np.arange(5000)
    found = ld.receiver_seeds(mi.UInt32(receivers), dr.opaque(mi.UInt32, 3), dr.opaque(mi.UInt32, 5))
    np.testing.assert_array_equal(np.array(found), seeds_of(receivers, np.full(5000, 3), 5))
    many = np.concatenate([seeds_of(receivers, np.full(5000, r), seed) for r in range(8) for seed in range(3)])
    assert len(np.unique(many)) > len(many) - 10  # 120,000 of 2^32: 1.7 pairs alike are expected


def test_a_scramble_is_an_owen_scramble() -> None:
    """Two points that first differ in bit k do so afterwards, whatever the seed; and below it their bits are independent: equal
    in half of 4,096 seeds, within 5 standard deviations, for the next 6 bits and 4 dimensions."""
    raw = ld.sobol_points(256)
    seeds = seeds_of(np.arange(4096), np.zeros(4096), 8)
    for d in range(ld.DIMENSIONS):
        x = (points_of(256, seeds, d) * 2**24).astype(np.int64)
        for i, j in ((0, 1), (0, 2), (3, 17), (100, 131), (5, 255)):
            first = 32 - int(raw[i, d] ^ raw[j, d]).bit_length()  # bits in front that are alike
            differ = x[:, i] ^ x[:, j]
            assert (differ >> (23 - first) == 1).all()
            for below in range(1, 7):
                share = (differ >> (23 - first - below) & 1).mean()
                assert abs(share - 0.5) < 5.0 * 0.5 / 64.0, (d, i, j, below, share)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_scrambles_keep_the_share_of_every_elementary_interval(projection: tuple[int, int]) -> None:
    """A scramble permutes intervals of each size, so the counts of a shape are those of the raw points in another order;
    dimensions 0 and 1 are a net: exactly one point in each."""
    points = ld.sobol_points(1 << M)
    raw = points.astype(np.float64) * 2.0**-32
    i, j = projection
    for seed in seeds_of(np.arange(60), np.zeros(60), 1):
        x, y = (points_of(1 << M, seed[None], d)[0] for d in projection)
        for a in range(M + 1):
            found = shares(x, y, a, M - a)
            np.testing.assert_array_equal(np.sort(found), np.sort(shares(raw[:, i], raw[:, j], a, M - a)))
            if projection == (0, 1):
                assert (found == 1).all()
        for axis in (x, y):
            assert (np.bincount((axis * 2**M).astype(int)) == 1).all()


def test_every_point_is_uniform_over_scrambles() -> None:
    """Each of 16 points and 4 dimensions over 8,192 receivers in 32 bins: chi-square with 31 degrees of freedom, 64 of them; over
    75 has a chance of 64 × 2e-5."""
    seeds, worst = seeds_of(np.arange(8192), np.zeros(8192), 3), 0.0
    for d in range(ld.DIMENSIONS):
        x = points_of(16, seeds, d)
        for k in range(16):
            count = np.bincount((x[:, k] * 32).astype(int), minlength=32)
            worst = max(worst, float(((count - 256.0) ** 2 / 256.0).sum()))
    assert worst < 75.0


def integrands(u: list[Array]) -> dict[str, Array]:
    """Means over points of a smooth and two broken functions of four numbers, for arrays (..., N)."""
    return {
        "smooth": np.cos(2.0 * u[0] + 3.0 * u[1]).mean(axis=-1),
        "disc": ((u[0] - 0.3) ** 2 + (u[1] - 0.6) ** 2 < 0.1).mean(axis=-1),
        "slab": (u[0] + u[1] + u[2] + u[3] < 1.7).mean(axis=-1),
    }


def test_replicates_receivers_and_seeds_are_uncorrelated() -> None:
    """Errors of 4,096 receivers × 8 replicates × 16 points. The mean of n independent ones has variance 1/n: its ratio to the
    pooled variance has standard deviation √(2/groups). And no correlation between neighbours, of standard deviation
    1/√pairs. 5 of those each over 3 × 6 figures: error rate 1e-5."""
    receivers, replicates = 4096, 8
    grid = np.meshgrid(np.arange(receivers), np.arange(replicates), indexing="ij")
    seeds = np.stack([seeds_of(*grid, seed) for seed in (1, 2)])
    u = [points_of(16, seeds, d) for d in range(4)]
    for name, found in integrands(u).items():
        error = found - found.mean()
        variance = (error**2).mean()
        by_row = (error.mean(axis=2) ** 2).mean() * replicates / variance
        assert abs(by_row - 1.0) < 5.0 * math.sqrt(2.0 / (2 * receivers)), (name, by_row)
        pairs = {
            "seeds": (error[0], error[1]),
            "next receiver": (error[:, 1:], error[:, :-1]),
            "64th receiver": (error[:, 64:], error[:, :-64]),
            "next replicate": (error[..., 1:], error[..., :-1]),
            "across": (error[:, 1:, 1:], error[:, :-1, :-1]),
        }
        for which, (a, b) in pairs.items():
            correlation = (a * b).mean() / variance
            assert abs(correlation) < 5.0 / math.sqrt(a.size), (name, which, correlation)


@pytest.mark.parametrize("index", [0, 1, 5, 13])
def test_dimensions_are_scrambled_independently(index: int) -> None:
    """One point under 2^18 seeds: every two dimensions fill 8 × 8 cells evenly, coarse cells and the cells within a sixteenth.
    Chi-square with 63 degrees of freedom over 135 has a chance of 3e-7; 4 × 18 of them. A shared bit would give 3e5."""
    seeds = seeds_of(np.arange(1 << 18), np.zeros(1 << 18), 9)
    x = [points_of(16, seeds[:, None], d)[:, 0, index] for d in range(4)]
    for a, b in permutations(range(4), 2):
        for zoom in (1, 16):
            cell = (x[a] * zoom % 1.0 * 8).astype(int) * 8 + (x[b] * 8).astype(int)
            expected = len(seeds) / 64
            chi = float(((np.bincount(cell, minlength=64) - expected) ** 2 / expected).sum())
            assert chi < 135.0, (a, b, zoom, chi)


def test_integrals_over_all_dimensions_are_unbiased() -> None:
    """Functions that live on the diagonal of two dimensions, which a scramble shared between them would get wrong: the mean over
    65,536 scrambles within 4.5 standard errors."""
    seeds = seeds_of(np.arange(1 << 16), np.zeros(1 << 16), 11)
    u = [points_of(8, seeds, d) for d in range(4)]
    for a in range(4):
        for b in range(a):
            value = np.maximum(0.0, 0.1 - np.abs(u[a] - u[b])).mean(axis=1)
            exact = 0.1**2 - 0.1**3 / 3.0
            assert abs(value.mean() - exact) < 4.5 * value.std() / 256.0, (a, b, value.mean(), exact)


def test_the_error_falls_faster_than_that_of_random_points() -> None:
    """RMS over 1,024 scrambles. A smooth function of two numbers: order 1.5 (Owen 1997); random points have 0.5."""
    rms = []
    for m in (4, 6, 8):
        u = [points_of(1 << m, seeds_of(np.arange(1024), np.zeros(1024), 4), d) for d in range(2)]
        exact = (np.cos(2) + np.cos(3) - np.cos(5) - 1) / 6.0
        rms.append(np.sqrt(((np.cos(2.0 * u[0] + 3.0 * u[1]).mean(axis=1) - exact) ** 2).mean()))
    assert all(math.log2(a / b) / 2.0 > 1.2 for a, b in pairwise(rms)), rms
