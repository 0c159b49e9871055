"""Voxels that meshes and boxes touch, against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference.lattice import Grid, cells, keys, make_grid
from lightgauge.reference.placement.voxel_bitmap import (
    box_voxels,
    build_bitmap,
    dilate,
    mesh_voxels,
    triangles_touch_boxes,
)
from small_scenes import box, mesh, quad, scene, sphere_mesh


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


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_mesh_voxels_against_brute_force(margin: float) -> None:
    grid = Grid(np.array([-1.3, -1.2, -1.1]), 0.33, 3, np.full(3, 8))
    for shape in (sphere_mesh(0.9, 1), mesh([[-1, -1, -1], [1, 0.9, 0.2], [0.1, 1, -0.7]], [[0, 1, 2]])):
        got = mesh_voxels(shape, grid, 3, margin)
        every = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
        corners = shape.vertices[shape.faces]
        half = 0.165 + margin
        expected = [v for v in every if any(clipped(t - (grid.origin + (v + 0.5) * 0.33), half) for t in corners)]
        np.testing.assert_array_equal(got, expected)


def test_box_voxels_against_brute_force() -> None:
    grid = Grid(np.array([0.05, -0.5, 0.0]), 0.25, 3, np.array([8, 5, 3]))
    rng = np.random.default_rng(0)
    for _ in range(50):
        low = rng.uniform(-1, 2, 3)
        high = low + rng.uniform(0.01, 2, 3)
        for level in (3, 2):
            size = grid.size(level)
            limit = (grid.extent - 1) >> (grid.level - level)
            every = np.stack(np.meshgrid(*[np.arange(n + 1) for n in limit], indexing="ij"), -1).reshape(-1, 3)
            a = grid.origin + every * size
            expected = every[((a + size > low) & (a < high)).all(axis=1)]
            got = box_voxels(low, high, grid, level)
            assert sorted(map(tuple, got.tolist())) == sorted(map(tuple, expected.tolist()))


def test_levels_are_aligned() -> None:
    """A mesh marked coarsely and one marked finely: parents of marked voxels are marked, and each mesh marks no finer level
    than it asks for."""
    coarse = box((0, 0, 0), (1, 1, 1), probe_size=0.5)
    fine = quad([[3, 0, 3], [3, 0, 3.5], [3.5, 0, 3.5], [3.5, 0, 3]], probe_size=0.125)
    hidden = box((1.5, 1.5, 1.5), (2, 2, 2), inward=False, lit_by_probes=False)
    s = scene(
        [coarse, fine, hidden], volumes={"v": {"min": (2.2, 2.2, 0.2), "max": (2.4, 2.4, 0.4), "probe_size": 0.25}}
    )
    grid = make_grid(np.zeros(3), np.full(3, 4.0), 0.125)
    bitmap = build_bitmap(s, grid, 0.0)
    for level in range(1, grid.level + 1):
        parents = keys(cells(bitmap.occupied[level]) >> 1)
        assert np.isin(parents, bitmap.occupied[level - 1]).all()
        limit = (grid.extent - 1) >> (grid.level - level)
        assert (cells(bitmap.occupied[level]) <= limit).all()
        assert (np.diff(bitmap.occupied[level]) > 0).all()

    def near(level: int, point: tuple[float, float, float]) -> bool:
        cell = np.floor((np.array([point]) - grid.origin) / grid.size(level)).astype(int)
        return bool(bitmap.holds(level, cell)[0])

    top = grid.level
    assert near(top, (3.2, 0.0, 3.2)) and not near(top, (0.0, 0.3, 0.3)) and near(top - 2, (0.0, 0.3, 0.3))
    assert near(top - 1, (2.3, 2.3, 0.3)) and not near(top, (2.3, 2.3, 0.3))
    assert not near(top, (1.5, 1.7, 1.7)) and not near(top - 2, (1.7, 1.7, 1.7))


def test_dilate() -> None:
    assert len(dilate(np.array([[2, 2, 2]]), np.full(3, 4))) == 27
    assert len(dilate(np.array([[0, 0, 0]]), np.full(3, 4))) == 8
    assert len(dilate(np.array([[2, 2, 2], [2, 2, 3]]), np.full(3, 4))) == 36


def test_a_moving_mesh_marks_too_and_margin_widens() -> None:
    low = quad([[1, 1, 1], [1, 1, 2], [2, 1, 2], [2, 1, 1]])
    grid = Grid(np.zeros(3), 0.5, 3, np.full(3, 8))
    thin, wide = mesh_voxels(low, grid, 3, 0.0), mesh_voxels(low, grid, 3, 0.6)
    assert len(wide) > len(thin) and set(map(tuple, thin.tolist())) <= set(map(tuple, wide.tolist()))
    # y = 1 lies on the border of two rows of voxels, with x and z from 1 to 2: 4 × 2 × 4 touched
    assert len(thin) == 4 * 2 * 4 and math.isclose(thin[:, 1].mean(), 1.5)
