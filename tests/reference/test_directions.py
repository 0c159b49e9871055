"""Point sets and frames: moments, uniformity, repeatability."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference import directions as dirs
from small_scenes import random_units


@pytest.mark.parametrize("count", [1, 3, 64, 1000])
def test_sobol_shape_range_and_repeatability(count: int) -> None:
    a = dirs.sobol(count, 5, 3)
    assert a.shape == (count, 5) and a.dtype == np.float32
    assert a.min() >= 0 and a.max() < 1
    np.testing.assert_array_equal(a, dirs.sobol(count, 5, 3))
    if count > 1:
        assert not np.array_equal(a, dirs.sobol(count, 5, 4))


def test_sobol_puts_one_point_in_every_elementary_interval() -> None:
    """A digital (t, m, s) net: each of 2^m intervals of each axis holds exactly one of 2^m points."""
    table = dirs.sobol(256, 5, 9)
    for axis in range(5):
        np.testing.assert_array_equal(np.bincount((table[:, axis] * 256).astype(int), minlength=256), 1)
    first_two = (table[:, :2] * 16).astype(int)
    np.testing.assert_array_equal(np.bincount(first_two[:, 0] * 16 + first_two[:, 1], minlength=256), 1)


def test_rotation_stays_below_one_and_keeps_the_net() -> None:
    table, offset = dirs.sobol(1024, 2, 0), dirs.rotations(200, 2, 0)
    moved = dirs.rotate(table[None], offset[:, None])
    assert moved.min() >= 0 and moved.max() < 1 and moved.dtype == np.float32
    assert dirs.rotate(np.float32([[0.5]]), np.float32([[0.5]]))[0, 0] == 0.0
    assert dirs.rotate(np.float32([[1 - 2**-24]]), np.float32([[2**-25]]))[0, 0] < 1.0
    # rotating a net of 1024 leaves means within 1/1024 of one half
    assert np.abs(moved.mean(axis=1) - 0.5).max() < 1.5 / 1024


def test_rotations_are_uniform_and_differ_by_seed() -> None:
    r = dirs.rotations(20_000, 3, 5)
    # 300 cells of 200 expected, chi-square with 297 degrees of freedom: mean 297, sd 24; 5 sd is a chance under 1e-5
    chi = sum(((np.bincount((r[:, a] * 100).astype(int), minlength=100) - 200.0) ** 2 / 200.0).sum() for a in range(3))
    assert abs(chi - 297) < 5 * 24.4
    assert not np.array_equal(r, dirs.rotations(20_000, 3, 6))


def test_cosine_hemisphere_moments() -> None:
    """density cosθ/π: E z = 2/3, E z² = 1/2, E x² = E y² = 1/4, E x = E y = E xy = 0."""
    d = dirs.cosine_hemisphere(dirs.sobol(1 << 14, 2, 1))
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-7)
    assert d[:, 2].min() >= 0
    np.testing.assert_allclose(d.mean(axis=0), [0, 0, 2 / 3], atol=2e-4)
    np.testing.assert_allclose(
        np.cov(d.T, bias=True) + np.outer(d.mean(0), d.mean(0)), np.diag([0.25, 0.25, 0.5]), atol=2e-4
    )


def test_sphere_moments() -> None:
    d = dirs.sphere(dirs.sobol(1 << 14, 2, 1))
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-7)
    np.testing.assert_allclose(d.mean(axis=0), 0, atol=2e-4)
    np.testing.assert_allclose(d.T @ d / len(d), np.eye(3) / 3, atol=2e-4)


@pytest.mark.parametrize("count", [16, 64, 512, 4096])
def test_fibonacci_moments_and_spread(count: int) -> None:
    d = dirs.fibonacci_sphere(count)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-14)
    assert np.abs(d.mean(axis=0)).max() < 1.0 / count
    assert np.abs(d.T @ d / count - np.eye(3) / 3).max() < 1.0 / count
    # nearest neighbours of N points with the area 4π/N each: √(4π/N) apart but for a constant
    cosine = d @ d.T - 2 * np.eye(count)
    nearest = np.arccos(np.clip(cosine.max(axis=1), -1, 1))
    assert nearest.min() > 0.7 * math.sqrt(4 * math.pi / count)


def test_random_rotations_are_rotations_and_uniform() -> None:
    r = dirs.random_rotations(4000, 3)
    np.testing.assert_allclose(np.einsum("nij,nkj->nik", r, r), np.broadcast_to(np.eye(3), r.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(r), 1.0, atol=1e-12)
    # Haar: every entry has mean 0 and variance 1/3; 9 means of 4000 within 5 standard errors: error rate under 1e-5
    assert np.abs(r.mean(axis=0)).max() < 5 * math.sqrt(1 / 3 / 4000)
    # trace = 1 + 2 cos α has mean 0 (angle density (1 - cos α)/π) and variance 1
    trace = np.einsum("nii->n", r)
    assert abs(trace.mean()) < 5 / math.sqrt(4000)


def test_frames_are_orthonormal_and_right_handed_everywhere() -> None:
    special = np.concatenate([np.eye(3), -np.eye(3), [[1e-9, 0, -np.sqrt(1 - 1e-18)], [0, 1e-5, -np.sqrt(1 - 1e-10)]]])
    n = np.concatenate([special, random_units(500, 4)])
    t, b = dirs.frames(n)
    basis = np.stack([t, b, n], axis=1)
    np.testing.assert_allclose(
        np.einsum("nij,nkj->nik", basis, basis), np.broadcast_to(np.eye(3), basis.shape), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(basis), 1.0, atol=1e-9)
