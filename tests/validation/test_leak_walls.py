"""Walls: thickness by rays, and which walls are predicted to leak."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.datatypes import F64, Material, Mesh
from lightgauge.reference.turned import rotation_matrix, turned
from lightgauge.reference.visibility import build_geometry
from lightgauge.validation.leaks.walls import Walls, spread, walls_behind
from small_scenes import box, material, mesh, quad, scene

MIDDLE = np.array([[1.0, 0.5, 0.5]])  # on the right wall of the left room


def behind(meshes: list[Mesh], point: F64, normal: F64, materials: list[Material] | None = None) -> Walls:
    """The wall behind a point of the first mesh."""
    g = build_geometry(scene(meshes, materials))
    d = np.abs(np.einsum("ti,ti->t", g.normals, g.vertices[g.faces[:, 0]] - point))
    triangle = np.array([int(np.argmin(d + 10.0 * (np.abs(g.normals @ normal[0] - 1.0) > 1e-6)))])
    return walls_behind(g, point, normal, triangle)


@pytest.mark.parametrize("turn", [0.0, 30.0, (20.0, 50.0, -10.0)])
@pytest.mark.parametrize("gap", [0.12, 0.5])
def test_a_slab_between_two_rooms(turn: float | tuple[float, float, float], gap: float) -> None:
    m = rotation_matrix(turn)
    rooms = [box((0, 0, 0), (1, 1, 1), name="a"), box((1 + gap, 0, 0), (2 + gap, 1, 1), name="b")]
    rooms = [mesh(turned(r.vertices, m), r.faces, closed=True) for r in rooms]
    normal = turned(np.array([[-1.0, 0.0, 0.0]]), m)
    found = behind(rooms, turned(MIDDLE, m), normal)
    assert found.thickness[0] == pytest.approx(gap, abs=1e-5) and found.behind[0] == 1
    assert found.need[0] == pytest.approx(gap / np.abs(normal).sum(), abs=1e-5)


def test_the_outside_of_the_world_is_no_wall() -> None:
    """A room of sheets that face inwards: nothing ever comes out on the far side of the left wall."""
    found = behind([box((0, 0, 0), (1, 1, 1))], np.array([[0.0, 0.5, 0.5]]), np.array([[1.0, 0.0, 0.0]]))
    assert np.isinf(found.thickness[0]) and found.behind[0] == -1


def test_a_sheet_has_no_thickness() -> None:
    sheet = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    found = behind([sheet], np.array([[0.5, 0.5, 0.0]]), np.array([[0.0, 0.0, 1.0]]), [material(two_sided=True)])
    assert found.thickness[0] == 0.0 and found.need[0] == 0.0


def test_solids_that_touch_are_one_wall() -> None:
    """Two slabs back to back, one poking into a third: the wall ends where it comes into the open."""
    parts = [box((0, 0, 0), (0.2, 2, 2), inward=False), box((0.2, 0, 0), (0.5, 2, 2), inward=False),
             box((0.4, 0, 0), (0.9, 2, 2), inward=False)]  # fmt: skip
    found = behind(parts, np.array([[0.0, 0.9, 1.1]]), np.array([[-1.0, 0.0, 0.0]]))
    assert found.thickness[0] == pytest.approx(0.9, abs=1e-5) and found.behind[0] == 2


def test_a_wedge_is_no_slab() -> None:
    """The far face of a prism leans by 70°: how thick that is depends on where one looks, so it counts as no wall."""
    tip = np.array([(0, 0, 0), (0, 3, 0), (1, 0, 0)], float)
    vertices = np.concatenate([tip, tip + np.array([0, 0, 2])])
    faces = [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)]
    prism = mesh(vertices, faces, closed=True)
    g = build_geometry(scene([prism]))
    bottom = int(np.argmin(g.normals[:, 1]))
    found = walls_behind(g, np.array([[0.5, 0.0, 1.0]]), np.array([[0.0, -1.0, 0.0]]), np.array([bottom]))
    assert np.isinf(found.thickness[0])
    left = int(np.argmin(g.normals[:, 0]))  # the other way the far face leans by 18° only
    found = walls_behind(g, np.array([[0.0, 1.0, 1.0]]), np.array([[-1.0, 0.0, 0.0]]), np.array([left]))
    assert found.thickness[0] == pytest.approx(2.0 / 3.0, abs=1e-5)


def test_spread() -> None:
    np.testing.assert_allclose(spread(np.array([[0.0, 1.0, 0.0], [0.6, 0.0, -0.8]])), [1.0, 1.4])
