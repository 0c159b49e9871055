"""Owen-scrambled Sobol points: the raw table, what every scramble keeps, and that scrambles are independent."""

from __future__ import annotations

import math
from itertools import pairwise
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


def scrambled_numpy(points: Array, seed: Array, dimension: int) -> Array:
    """Coordinate `dimension` of all points (N,) under seeds (...,): the kernel's arithmetic in NumPy."""
    with np.errstate(over="ignore"):
        seeds = ld.mixed(np.asarray(seed, np.uint32) + np.uint32(0x9E3779B9 * (dimension + 1) & 0xFFFFFFFF))
        moved = ld.laine_karras(reversed_bits(points[:, dimension]), seeds[..., None])
    return (reversed_bits(moved) >> np.uint32(8)).astype(np.float64) * 2.0**-24


def reversed_bits(x: Array) -> Array:
    bits = np.unpackbits(np.ascontiguousarray(x).view(np.uint8).reshape(*x.shape, 4)[..., ::-1], axis=-1)
    turned = np.packbits(bits[..., ::-1], axis=-1)[..., ::-1]
    return np.ascontiguousarray(turned).view(np.uint32)[..., 0]


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


def test_device_is_the_numpy_arithmetic() -> None:
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    n, receivers = 64, 50
    lane = dr.arange(mi.UInt32, n * receivers)
    seeds = ld.receiver_seeds(lane // n, dr.opaque(mi.UInt32, 3), dr.opaque(mi.UInt32, 5))
    points = ld.sobol_points(n)
    expected = seeds_of(np.arange(receivers), np.full(receivers, 3), 5)
    np.testing.assert_array_equal(np.array(seeds).reshape(receivers, n)[:, 0], expected)
    for d in range(ld.DIMENSIONS):
        got = np.array(ld.scrambled(ld.sobol_table(n), lane % n, seeds, d)).reshape(receivers, n)
        np.testing.assert_array_equal(got, scrambled_numpy(points, expected, d))


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_scrambles_keep_the_share_of_every_elementary_interval(projection: tuple[int, int]) -> None:
    """A scramble permutes intervals of each size, so the counts of a shape are those of the raw points in another order;
    dimensions 0 and 1 are a net: exactly one point in each."""
    points = ld.sobol_points(1 << M)
    raw = points.astype(np.float64) * 2.0**-32
    i, j = projection
    for seed in seeds_of(np.arange(60), np.zeros(60), 1):
        x, y = (scrambled_numpy(points, seed, d) for d in projection)
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
    points, seeds = ld.sobol_points(16), seeds_of(np.arange(8192), np.zeros(8192), 3)
    worst = 0.0
    for d in range(ld.DIMENSIONS):
        x = scrambled_numpy(points, seeds, d)
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
    points = ld.sobol_points(16)
    u = [scrambled_numpy(points, seeds, d) for d in range(4)]
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


def test_dimensions_are_scrambled_independently() -> None:
    """Same receiver, dimensions 0 and 1 of one point: correlation over 32,768 receivers within 5 / √32,768."""
    seeds = seeds_of(np.arange(32768), np.zeros(32768), 9)
    x = [scrambled_numpy(ld.sobol_points(1), seeds, d)[:, 0] - 0.5 for d in range(4)]
    for a in range(4):
        for b in range(a):
            assert abs((x[a] * x[b]).mean() * 12.0) < 5.0 / math.sqrt(32768)


def test_the_error_falls_faster_than_that_of_random_points() -> None:
    """RMS over 1,024 scrambles. A smooth function of two numbers: order 1.5 (Owen 1997); random points have 0.5."""
    rms = []
    for m in (4, 6, 8):
        u = [
            scrambled_numpy(ld.sobol_points(1 << m), seeds_of(np.arange(1024), np.zeros(1024), 4), d) for d in range(2)
        ]
        exact = (np.cos(2) + np.cos(3) - np.cos(5) - 1) / 6.0
        rms.append(np.sqrt(((np.cos(2.0 * u[0] + 3.0 * u[1]).mean(axis=1) - exact) ** 2).mean()))
    assert all(math.log2(a / b) / 2.0 > 1.2 for a, b in pairwise(rms)), rms
