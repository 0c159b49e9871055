"""Voxels of meshes, closed meshes, boxes and points, each against brute force over all voxels of a small grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import Grid, cells, keys
from lightgauge.reference.placement import mesh_voxels as module
from lightgauge.reference.placement.mesh_voxels import closed_voxels, mesh_voxels, winding_numbers
from lightgauge.reference.placement.shape_voxels import MAX_VOXELS, box_voxels, point_voxels, turned_box_voxels
from lightgauge.reference.placement.tri_box import triangles_touch_boxes
from lightgauge.reference.turned import TurnedBox, rotation_matrix
from small_scenes import box, mesh, quad, sphere_mesh

GRID = Grid(np.array([-1.3, -1.2, -1.1]), 0.33, 3, np.full(3, 8))


def every(grid: Grid, level: int) -> np.ndarray:
    axes = [np.arange(n + 1) for n in grid.last(level)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def centres(grid: Grid, level: int) -> np.ndarray:
    return grid.origin + (every(grid, level) + 0.5) * grid.size(level)


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("level", [3, 2, 0])
def test_surfaces_against_brute_force(margin: float, level: int) -> None:
    """A ball of small triangles, one large triangle, and one that reaches far out of the grid; up to `margin` off, each another."""
    rng = np.random.default_rng(5)
    far = mesh([[-40, -1, -1], [50, 40, 3], [0.1, 1, -0.7]], [[0, 1, 2]])
    for shape in (sphere_mesh(0.9, 1), mesh([[-1, -1, -1], [1, 0.9, 0.2], [0.1, 1, -0.7]], [[0, 1, 2]]), far):
        reach = margin * rng.random((len(shape.faces), 3))
        got = mesh_voxels(shape.vertices[shape.faces], GRID, level, reach if margin else None)
        corners, half = shape.vertices[shape.faces], 0.5 * GRID.size(level) + reach
        pairs = corners[None] - centres(GRID, level)[:, None, None, :]
        halves = np.broadcast_to(half, (len(pairs), *half.shape)).reshape(-1, 3)
        touched = triangles_touch_boxes(pairs.reshape(-1, 3, 3), halves).reshape(len(pairs), -1).any(axis=1)
        np.testing.assert_array_equal(got, keys(every(GRID, level)[touched]))
        assert touched.any()


def test_one_kernel_serves_all_sizes_levels_and_meshes() -> None:
    import drjit as dr

    rng = np.random.default_rng(0)
    seen: list[set[str]] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for size, level, count in ((0.25, 6, 300), (0.13, 7, 3), (1.1, 4, 1)):
            grid = Grid(rng.random(3) - 9, size, level, np.full(3, 1 << level))
            assert len(mesh_voxels(rng.uniform(-8, 8, (count, 3, 3)), grid, level, np.full((count, 3), 0.1 * size)))
            seen.append({k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT})
    assert len(seen[0]) <= 2 and seen[1] <= seen[0] and seen[2] <= seen[0]


def test_a_mesh_off_the_grid_marks_nothing() -> None:
    ball = sphere_mesh(0.9, 1)
    assert len(mesh_voxels(ball.vertices[ball.faces] + 50.0, GRID, 3)) == 0
    assert len(closed_voxels(ball.vertices - 50.0, ball.faces, GRID, 3)) == 0


def test_borders_mark_both_sides_and_margin_widens() -> None:
    low = quad([[1, 1, 1], [1, 1, 2], [2, 1, 2], [2, 1, 1]])
    grid = Grid(np.zeros(3), 0.5, 3, np.full(3, 8))
    thin, wide = (mesh_voxels(low.vertices[low.faces], grid, 3, np.full((2, 3), m)) for m in (0.0, 0.6))
    assert len(wide) > len(thin) and np.isin(thin, wide).all()
    # y = 1 lies on the border of two rows of voxels, with x and z from 1 to 2: 4 × 2 × 4 touched
    assert len(thin) == 4 * 2 * 4 and math.isclose(cells(thin)[:, 1].mean(), 1.5)


def hollow() -> tuple[np.ndarray, np.ndarray]:
    """A ball of radius 1.1 with a hollow of radius 0.8."""
    outer, inner = sphere_mesh(1.1, 3, inward=False), sphere_mesh(0.8, 3, inward=True)
    return np.vstack([outer.vertices, inner.vertices]), np.vstack([outer.faces, inner.faces + len(outer.vertices)])


@pytest.mark.parametrize("flipped", [False, True])
def test_closed_meshes_are_filled(flipped: bool) -> None:
    """Which voxels a ball and a hollow ball hold is known from the distance to the middle; winding may be either way. The
    mesh is a polyhedron, so distances within its sagitta are left to the surface test."""
    grid = Grid(np.full(3, -1.3), 2.6 / 32, 5, np.full(3, 32))
    middle = np.linalg.norm(centres(grid, 5), axis=1)
    reach = 0.5 * grid.finest * math.sqrt(3.0)
    solid = sphere_mesh(1.1, 3, inward=flipped)
    for vertices, faces, hole in ((solid.vertices, solid.faces, -1.0), (*hollow(), 0.8)):
        got = np.isin(keys(every(grid, 5)), closed_voxels(vertices, faces[:, ::-1] if flipped else faces, grid, 5))
        assert got[(middle < 1.1) & (middle > hole)].all()
        assert not got[(middle > 1.1 + reach) | (middle < hole - reach - 0.01)].any()


def test_a_closed_mesh_may_reach_out_of_the_grid_or_surround_it() -> None:
    for lower, upper in (((-9, -9, -9), (9, 9, 9)), ((-9, -9, -9), (0.1, 9, 9))):
        b = box(lower, upper)
        got = closed_voxels(b.vertices, b.faces, GRID, 3)
        first = GRID.origin + every(GRID, 3) * GRID.finest
        np.testing.assert_array_equal(got, keys(every(GRID, 3)[(first <= np.asarray(upper)).all(axis=1)]))


def test_winding_numbers() -> None:
    b = box((0, 0, 0), (1, 2, 3), inward=False)
    inside, outside = [[0.5, 0.5, 0.5], [0.99, 1.9, 0.1]], [[1.01, 1.0, 1.0], [-5.0, 0.5, 0.5]]
    np.testing.assert_allclose(
        winding_numbers(np.array(inside + outside), b.vertices[b.faces]), [1, 1, 0, 0], atol=1e-12
    )


def test_boxes_against_brute_force() -> None:
    grid = Grid(np.array([0.05, -0.5, 0.0]), 0.25, 3, np.array([8, 5, 3]))
    rng = np.random.default_rng(0)
    for turn in (0.0, (20.0, 35.0, 50.0)):
        for _ in range(25):
            low = rng.uniform(-1, 2, 3)
            placed = TurnedBox(low, low + rng.uniform(0.01, 2, 3), rotation_matrix(turn))
            for level in (3, 2):
                size = grid.size(level)
                expected = placed.touches_cubes(centres(grid, level), 0.5 * size)
                np.testing.assert_array_equal(
                    turned_box_voxels(placed, grid, level), keys(every(grid, level)[expected])
                )


def test_points_mark_the_voxels_that_hold_them() -> None:
    grid = Grid(np.zeros(3), 0.5, 3, np.array([8, 6, 8]))
    points = np.array([[0.2, 0.3, 0.4], [1.0, 0.3, 0.4], [1.0, 1.0, 1.0], [-0.1, 0.3, 0.3], [0.2, 3.1, 0.2]])
    expected = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]  # the second lies on a face, the last two off the grid
    expected += [(x, y, z) for x in (1, 2) for y in (1, 2) for z in (1, 2)]  # the third on a corner
    np.testing.assert_array_equal(point_voxels(points, grid, 3), np.sort(keys(np.array(expected))))
    assert len(point_voxels(points[:0], grid, 3)) == 0


def test_too_many_voxels_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = Grid(np.zeros(3), 1.0, 16, np.full(3, 1 << 16))
    b = box((0, 0, 0), (60000, 60000, 60000))
    with pytest.raises(InputError, match=r"volumes\.v: asks for 216\d+ voxels of 1 m, at most 16777216"):
        box_voxels(b.vertices.min(axis=0), b.vertices.max(axis=0), grid, 16, "volumes.v")
    with pytest.raises(InputError, match=r"marks\.m: asks for \d+ voxels in its bounds"):
        closed_voxels(np.array([[0.5] * 3, [300.5] * 3, [1, 300, 9.0]]), np.array([[0, 1, 2]]), grid, 16, "marks.m")
    monkeypatch.setattr("lightgauge.reference.placement.shape_voxels.MAX_VOXELS", 1000)
    with pytest.raises(InputError, match=r"meshes\.m: asks for \d+ pairs .* raise its probe_size"):
        mesh_voxels(b.vertices[b.faces], grid, 16, None, "meshes.m")
    assert MAX_VOXELS == 1 << 24


def test_too_many_separate_spaces_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WINDING_PAIRS", 10)
    ball = sphere_mesh(0.9, 1)
    with pytest.raises(InputError, match=r"marks\.m: 2 separate spaces .*kind = ."):
        closed_voxels(ball.vertices, ball.faces, GRID, 3, "marks.m")
