"""Elements of a triangle: numbering, its inverse, and equal areas."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.transport.elements import element_of, points_in_elements


@pytest.mark.parametrize("k", [*range(1, 10), 64, 511, 512])
def test_element_of_is_the_inverse_of_points_in_elements(k: int) -> None:
    cuts = np.array([3, k], np.int32)
    first = np.array([0, 9, 9 + k * k])
    rng = np.random.default_rng(k)
    number = np.arange(k * k) if k < 10 else rng.integers(k * k, size=5000)
    element = np.repeat(9 + number, 40 if k < 10 else 2)
    triangle = np.ones(len(element), np.int32)
    xy = rng.random((len(element), 2)) * (1 - 2e-9) + 1e-9
    uv = points_in_elements(cuts, first, triangle, element, xy)
    assert uv.min() >= 0 and uv.sum(axis=1).max() <= 1 + 1e-12
    np.testing.assert_array_equal(element_of(cuts, first, triangle, uv[:, 0], uv[:, 1]), element)


@pytest.mark.parametrize("k", range(1, 10))
def test_random_points_fall_into_all_elements_alike(k: int) -> None:
    """Elements have equal area: 400 points expected in each; chi-square within 5 sd: error rate about 1e-5."""
    rng = np.random.default_rng(k + 100)
    uv = rng.random((400 * k * k, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    n = len(uv)
    found = element_of(np.array([k], np.int32), np.array([0, k * k]), np.zeros(n, int), uv[:, 0], uv[:, 1])
    count = np.bincount(found, minlength=k * k)
    assert len(count) == k * k
    chi, freedom = ((count - 400.0) ** 2 / 400).sum(), k * k - 1
    assert abs(chi - freedom) <= 5 * np.sqrt(2 * max(freedom, 1))


@pytest.mark.parametrize("k", [1, 2, 7])
def test_corners_edges_and_rounding_stay_inside_the_triangle(k: int) -> None:
    """A ray tracer returns u + v a hair over 1 and weights a hair under 0."""
    t = np.linspace(0, 1, 41)
    u = np.concatenate([t, 0 * t, t, 1 - t + 1e-7, [1 + 1e-6, -1e-6, 0.5]])
    v = np.concatenate([0 * t, t, 1 - t, t + 1e-7, [-1e-6, 1 + 1e-6, 0.5 + 1e-6]])
    found = element_of(np.array([4, k], np.int32), np.array([0, 16, 16 + k * k]), np.ones(len(u), int), u, v)
    assert found.min() >= 16 and found.max() < 16 + k * k


def test_points_are_uniform_within_an_element() -> None:
    xy = np.random.default_rng(5).random((40_000, 2))
    n = len(xy)
    uv = points_in_elements(np.array([3], np.int32), np.array([0, 9]), np.zeros(n, np.int32), np.full(n, 4), xy)
    # cutting on: 16 elements of a triangle cut 12 times lie in each of 9; all 16 alike
    fine = element_of(np.array([12], np.int32), np.array([0, 144]), np.zeros(n, int), uv[:, 0], uv[:, 1])
    count = np.bincount(fine)
    count = count[count > 0]
    assert len(count) == 16
    # chi-square with 15 degrees of freedom over 45 has a chance of 8e-5
    assert ((count - n / 16) ** 2 / (n / 16)).sum() < 45
