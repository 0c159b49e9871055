"""Distances that probes see: closed forms, ends, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.octahedral import read
from lightgauge.reference.transport.distance_moments import REACH, SHARPNESS, distance_moments, lobes
from lightgauge.reference.visibility import build_geometry
from small_scenes import quad, random_units, scene, sphere_mesh


def test_lobes_share_their_rays_out() -> None:
    share = lobes(random_units(500, 1), 6)
    np.testing.assert_allclose(share.sum(axis=0), 1.0, atol=1e-5)
    assert share.min() >= 0.0


def test_from_the_middle_of_a_sphere_all_is_as_far() -> None:
    g = build_geometry(scene([sphere_mesh(2.0, 4)]))
    maps = distance_moments(g, np.zeros((1, 3)), np.array([1.6]))
    assert maps.shape == (1, 16, 16, 2) and maps.dtype == np.float16
    np.testing.assert_allclose(maps[..., 0], 2.0 / 1.6, rtol=4e-3)
    np.testing.assert_allclose(maps[..., 1], (2.0 / 1.6) ** 2, rtol=8e-3)


def test_towards_a_plane_it_is_the_lobes_mean_and_elsewhere_the_reach() -> None:
    """Straight down above a large floor from 1 up: mean of 1 / cos θ under cos^s θ is (s + 1) / s, of its square (s + 1) / (s - 1)."""
    floor = quad([(-9, 0, -9), (-9, 0, 9), (9, 0, 9), (9, 0, -9)])
    g = build_geometry(scene([floor]))
    at = np.array([[0.3, 1.0, 0.1], [4.0, 0.5, 2.0]])
    maps = distance_moments(g, at, np.array([1.0, 0.5]), rays=8192)
    down, up = (np.tile(np.float32([[0, y, 0]]), (2, 1)) for y in (-1, 1))
    seen = read(maps, np.arange(2), down)
    s = SHARPNESS
    np.testing.assert_allclose(seen[:, 0], (s + 1) / s, rtol=0.02)
    np.testing.assert_allclose(seen[:, 1], (s + 1) / (s - 1), rtol=0.04)
    np.testing.assert_allclose(read(maps, np.arange(2), up)[:, 0], REACH, rtol=1e-3)
    assert (maps[..., 1].astype(float) >= 0.998 * maps[..., 0].astype(float) ** 2).all()


def test_bad_input() -> None:
    g = build_geometry(scene([sphere_mesh(1.0, 1)]))
    for positions, voxels, texels, rays in (
        (np.zeros((2, 3)), np.ones(1), 6, 64), (np.zeros((2, 2)), np.ones(2), 6, 64), (np.zeros((1, 3)), np.ones(1), 1, 64),
        (np.zeros((1, 3)), np.ones(1), 6, 35),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="expected positions"):
            distance_moments(g, positions, voxels, texels, rays)
