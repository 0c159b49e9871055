"""Triangles against cubes: the NumPy test against clipping, the kernel against the NumPy test."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import OCTANTS
from lightgauge.reference.placement.tri_box import CubeTest, triangles_touch_boxes


def clipped(triangle: np.ndarray, half: float) -> bool:
    """Whether a triangle meets the cube |x| ≤ half: Sutherland-Hodgman clipping against its six planes."""
    polygon = list(triangle)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            result = []
            for i, b in enumerate(polygon):
                a = polygon[i - 1]
                da, db = half - sign * a[axis], half - sign * b[axis]
                if (da >= 0) != (db >= 0):
                    result.append(a + (b - a) * (da / (da - db)))
                if db >= 0:
                    result.append(b)
            polygon = result
            if not polygon:
                return False
    return True


def test_triangle_box_overlap_against_clipping() -> None:
    rng = np.random.default_rng(1)
    triangles = rng.uniform(-2, 2, (6000, 3, 3)) * rng.choice([0.3, 1.0, 5.0], (6000, 1, 1)) + rng.uniform(
        -1, 1, (6000, 1, 3)
    )
    got = triangles_touch_boxes(triangles, 0.7)
    expected = np.array([clipped(t, 0.7) for t in triangles])
    assert 0.1 < expected.mean() < 0.9
    assert (got == expected).all(), triangles[got != expected][:3]


def test_slivers_and_axis_aligned_triangles() -> None:
    rng = np.random.default_rng(2)
    t = rng.integers(-3, 4, (3000, 3, 3)) * 0.5
    for half in (0.61, 1.13):
        np.testing.assert_array_equal(triangles_touch_boxes(t, half), [clipped(x, half) for x in t])


def test_touching_counts() -> None:
    on_face = np.array([[[0.5, -9, -9], [0.5, 9, -9], [0.5, 0, 9]]])
    assert triangles_touch_boxes(on_face, 0.5)[0]
    assert not triangles_touch_boxes(on_face + np.array([1e-6, 0, 0]), 0.5).any()


def test_nothing_near_is_an_answer_not_an_error() -> None:
    assert triangles_touch_boxes(np.full((4, 3, 3), 10.0) + np.eye(3), 0.5).tolist() == [False] * 4


@pytest.mark.parametrize(("count", "half"), [(4000, 0.15), (4000, 0.4), (1, 0.15), (0, 0.15)])
def test_the_kernel_is_its_twin(count: int, half: float) -> None:
    """Random triangles, a third of them on the lattice's own planes, each against a block of eight cubes near it; one
    triangle and none are widths of their own."""
    rng = np.random.default_rng(3)
    triangles = rng.uniform(0.0, 6.0, (max(count, 1), 3, 3))
    third = count // 3
    triangles[:third] = np.round(triangles[:third] / 0.3) * 0.3
    row = rng.integers(0, len(triangles), count)
    block = np.clip((triangles[row].mean(axis=1) / 0.3).astype(np.int64) + rng.integers(-2, 2, (count, 3)), 0, None)
    reach = (
        np.maximum(half - 0.15, 0.0) * rng.random((len(triangles), 3)) * 2.0
    )  # none, so whole cubes of 0.3, or each another
    got = CubeTest(triangles, reach if half > 0.15 else None)(row, block, 0.3)
    cell = (block[:, None, :] + OCTANTS[None]).reshape(-1, 3)
    relative = triangles[np.repeat(row, 8)] - ((cell + 0.5) * 0.3)[:, None, :]
    np.testing.assert_array_equal(
        got, triangles_touch_boxes(relative, np.repeat(0.15 + reach[row], 8, axis=0)).reshape(-1, 8)
    )
    assert count < 2 or 0.05 < got.mean() < 0.95
