"""The sky against Mitsuba's `envmap`, and its bins."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from lightgauge.reference.datatypes import Sky
from lightgauge.reference.directions import fibonacci_sphere
from lightgauge.reference.sky import BINS_PER_EDGE, SKY_BINS, bin_of, bin_radiance, sky_radiance
from lightgauge.reference.truth.mitsuba_scene import _sky
from lightgauge.reference.variant import ensure_variant
from small_scenes import random_units


def image(height: int, width: int, seed: int = 0) -> np.ndarray:
    return (np.random.default_rng(seed).random((height, width, 3)) + 0.1).astype(np.float32)


def mitsuba_radiance(sky: Sky, d: np.ndarray) -> np.ndarray:
    ensure_variant()
    import mitsuba as mi

    scene = mi.load_dict({"type": "scene", "sky": _sky(sky), "ball": {"type": "sphere", "radius": 1e-3}})
    ray = mi.Ray3f(mi.Point3f(0, 0, 5), mi.Vector3f(np.ascontiguousarray(d.T, dtype=np.float32)))
    si = scene.ray_intersect(ray)
    return np.array(scene.environment().eval(si)).T


@pytest.mark.parametrize("rotation", [0.0, 90.0, -33.0, 200.0])
@pytest.mark.parametrize("shape", [(8, 16), (33, 65)])
def test_same_as_mitsuba(shape: tuple[int, int], rotation: float) -> None:
    sky = Sky(image(*shape), rotation, False)
    d = random_units(4000, 1)
    got, expected = sky_radiance(sky, d), mitsuba_radiance(sky, d)
    # float32 there: near the poles a texel's column is sensitive, so the mean and 99.5 % of the directions
    difference = np.abs(got - expected).max(axis=1)
    assert np.percentile(difference, 99.5) < 2e-3, np.percentile(difference, [50, 90, 99.5])


def test_constant_sky_is_constant() -> None:
    sky = Sky(np.float32([[[1.0, 2.0, 3.0]]]), 40.0, False)
    np.testing.assert_allclose(sky_radiance(sky, random_units(100, 2)), np.tile([1.0, 2.0, 3.0], (100, 1)))
    np.testing.assert_allclose(bin_radiance(sky), np.tile([1.0, 2.0, 3.0], (SKY_BINS, 1)))


def test_bins_partition_the_sphere() -> None:
    """Cells of a cube map: each holds the solid angle of its square (Arvo's formula), and no direction is left out."""
    d = fibonacci_sphere(400_000)
    number = bin_of(d)
    assert number.min() == 0 and number.max() == SKY_BINS - 1

    def corner(x: float, y: float) -> float:
        return math.atan2(x * y, math.sqrt(x * x + y * y + 1))

    edge = np.linspace(-1, 1, BINS_PER_EDGE + 1)
    cell = np.array([[corner(a, c) + corner(b, e) - corner(a, e) - corner(b, c)
                      for c, e in pairwise(edge)]
                     for a, b in pairwise(edge)])  # fmt: skip
    share = np.bincount(number, minlength=SKY_BINS) / len(d) * 4 * math.pi
    assert np.abs(share - np.tile(cell.ravel(), 6)).max() < 0.02 * cell.mean()


def test_a_bin_is_convex_and_small() -> None:
    d = random_units(100_000, 3)
    number = bin_of(d)
    for b in range(0, SKY_BINS, 37):
        mine = d[number == b]
        mean = mine.mean(axis=0) / np.linalg.norm(mine.mean(axis=0))
        assert np.degrees(np.arccos(np.clip(mine @ mean, -1, 1))).max() < 11.0
    assert bin_of(np.array([[0.0, 0.0, 3.0]]))[0] == bin_of(np.array([[0.0, 0.0, 1.0]]))[0]


def test_bins_keep_the_power_of_a_smooth_sky() -> None:
    """∫ L dω by bins against the midpoint rule over the picture."""
    height, width = 64, 128
    v, u = np.mgrid[0:height, 0:width]
    sky = Sky((1.5 + np.sin(2 * np.pi * u / width) * np.sin(np.pi * v / (height - 1)))[..., None].repeat(3, -1).astype(np.float32),
              25.0, False)  # fmt: skip
    solid = np.bincount(bin_of(fibonacci_sphere(200_000)), minlength=SKY_BINS) / 200_000 * 4 * np.pi
    theta = np.pi * np.arange(height) / (height - 1)  # as in Mitsuba, first and last row lie at the poles
    exact = (sky.image[..., 0].mean(axis=1) * np.sin(theta)).sum() / np.sin(theta).sum() * 4 * np.pi
    assert (solid @ bin_radiance(sky))[0] == pytest.approx(exact, rel=3e-3)


@pytest.mark.parametrize("row, column", [(120, 300), (128, 37), (90, 777)])
def test_bins_keep_the_power_of_a_small_sun(row: int, column: int) -> None:
    """One bright texel of 1024 × 512, as captured skies have: its power must not depend on where samples fall."""
    height, width = 512, 1024
    picture = np.zeros((height, width, 3), np.float32)
    picture[row, column] = 1e4
    theta = math.pi * row / (height - 1)
    exact = 1e4 * math.sin(theta) * (math.pi / (height - 1)) * (2 * math.pi / width)
    solid = np.bincount(bin_of(fibonacci_sphere(1 << 18)), minlength=SKY_BINS) / (1 << 18) * 4 * math.pi
    power = (solid @ bin_radiance(Sky(picture, 0.0, False)))[0]
    assert power == pytest.approx(exact, rel=0.1)
