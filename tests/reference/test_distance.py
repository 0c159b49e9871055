"""Harmonic mean distance against closed forms (failure-catalogue C5)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference.placement import distance
from lightgauge.reference.placement.distance import harmonic_mean
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, quad, scene, sphere_mesh

BIG = 1e4


def plane(y: float, up: bool) -> list[list[float]]:
    ring = [[-BIG, y, -BIG], [-BIG, y, BIG], [BIG, y, BIG], [BIG, y, -BIG]]
    return ring if up else ring[::-1]


def test_plane_reads_four_times_the_height() -> None:
    """1/HM = ∫_lower cosθ/h dω / 4π = 1/(4h). Spread of rotated Fibonacci rays: under 1 % at 1,024."""
    g = build_geometry(scene([quad(plane(0, True))]))
    p = np.column_stack([np.zeros(40), np.repeat([0.5, 2.0], 20), np.zeros(40)])
    np.testing.assert_allclose(harmonic_mean(g, p, 1024, 1), 4 * p[:, 1], rtol=0.01)


def test_middle_between_plates_reads_their_distance() -> None:
    """Plates 2h apart: half the height from each: 2h."""
    g = build_geometry(scene([quad(plane(0, True)), quad(plane(3, False))]))
    np.testing.assert_allclose(harmonic_mean(g, np.tile([0, 1.5, 0], (20, 1)), 1024, 1), 3.0, rtol=0.01)


def test_sphere_centre_reads_the_radius() -> None:
    g = build_geometry(scene([sphere_mesh(2.0, 4)]))
    np.testing.assert_allclose(
        harmonic_mean(g, np.zeros((5, 3)), 64, 1), 2.0, rtol=4e-3
    )  # facets lie inside the sphere


def test_square_corridor() -> None:
    """In the middle of a long corridor of half width a: √2 a."""
    g = build_geometry(scene([box((-1, -1, -BIG), (1, 1, BIG))]))
    np.testing.assert_allclose(harmonic_mean(g, np.zeros((20, 3)), 4096, 1), math.sqrt(2), rtol=5e-3)


def test_a_point_on_a_surface_is_at_distance_zero_and_never_nan() -> None:
    """failure-catalogue C5: d = 0 → 0; never NaN (a NaN compares as far away, and the voxel vanishes)."""
    g = build_geometry(scene([quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])]))
    on = np.array([[0.5, 0.5, 0.0], [0.25, 0.7, 0.0], [0.5, 0.5, 1e-7]])
    found = harmonic_mean(g, on, 64, 1)
    assert not np.isnan(found).any(), found
    assert (found < 1e-4).all()


def test_all_miss_is_infinite() -> None:
    g = build_geometry(scene([quad([[0, 0, 0], [1e-6, 0, 0], [1e-6, 1e-6, 0], [0, 1e-6, 0]])]))
    assert harmonic_mean(g, np.array([[0.0, 0.0, 1e3]]), 64, 1)[0] == np.inf


def test_both_sides_of_a_surface_count() -> None:
    g = build_geometry(scene([quad(plane(0, True))]))
    up, down = harmonic_mean(g, np.array([[0, 1.0, 0], [0, -1.0, 0]]), 1024, 1)
    assert up == pytest.approx(down, rel=0.02)


def test_bias_and_spread_of_64_rays() -> None:
    """failure-catalogue C5: rotated Fibonacci rays spread little (independent ones 17 %), unbiased in 1/HM."""
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    inverse = 1 / harmonic_mean(g, np.tile([0.3, 0.2, -0.1], (400, 1)), 64, 1)
    exact = 1 / harmonic_mean(g, np.tile([0.3, 0.2, -0.1], (4, 1)), 4096, 2).mean()
    assert inverse.std() / inverse.mean() < 0.02
    assert abs(inverse.mean() - exact) < 5 * inverse.std() / 20 + 1e-3 * exact


def test_same_for_the_same_seed() -> None:
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    p = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 3))
    np.testing.assert_array_equal(harmonic_mean(g, p, 64, 1), harmonic_mean(g, p, 64, 1))
    assert not np.array_equal(harmonic_mean(g, p, 64, 1), harmonic_mean(g, p, 64, 2))


def test_does_not_depend_on_the_batch_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A result is a function of scene, settings and seed (design.md, 3): RAYS_PER_BATCH is none of them."""
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    p = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 3))
    whole = harmonic_mean(g, p, 64, 1)
    monkeypatch.setattr(distance, "RAYS_PER_BATCH", 640)
    np.testing.assert_array_equal(harmonic_mean(g, p, 64, 1), whole)
