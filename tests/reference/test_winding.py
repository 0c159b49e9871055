"""Winding numbers against closed forms, and which pieces of a scene are closed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from lightgauge.reference.datatypes import Mesh
from lightgauge.reference.placement.winding import Solids, closed_solids, inside, solid_angles, winding_number
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, box_quads, material, mesh, quad, scene, sphere_mesh


def solids(meshes: Sequence[Mesh], two_sided: bool = False) -> Solids:
    return closed_solids(build_geometry(scene(meshes, [material(), material(two_sided=two_sided)])))


def test_a_face_of_a_cube_fills_a_sixth_of_the_directions_from_its_middle() -> None:
    face = np.array([[(-1, -1, 1), (1, -1, 1), (1, 1, 1)], [(-1, -1, 1), (1, 1, 1), (-1, 1, 1)]], float)
    got = solid_angles(face, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])).sum(axis=1)
    np.testing.assert_allclose(got, [4 * math.pi / 6, -4 * math.pi / 6], rtol=1e-12)


def test_a_rectangle_has_its_closed_form() -> None:
    """Ω = 4 asin(ab / √((a² + d²)(b² + d²))) of a 2a × 2b rectangle at distance d on its axis."""
    a, b, d = 0.7, 1.9, 0.4
    corners = np.array([(-a, -b, d), (a, -b, d), (a, b, d), (-a, b, d)], float)
    got = solid_angles(corners[[[0, 1, 2], [0, 2, 3]]], np.zeros((1, 3))).sum()
    assert got == pytest.approx(4 * math.asin(a * b / math.sqrt((a * a + d * d) * (b * b + d * d))), rel=1e-12)


@pytest.mark.parametrize("inward", [False, True])
def test_a_sphere_is_whole_numbers_on_both_sides(inward: bool) -> None:
    s = solids([sphere_mesh(1.0, 2, inward)])
    p = np.random.default_rng(0).uniform(-1.3, 1.3, (4000, 3))
    r = np.linalg.norm(p, axis=1)
    p, r = p[(r < 0.93) | (r > 1)], r[(r < 0.93) | (r > 1)]  # between the facets and the sphere it may be either
    w = winding_number(s, p)
    np.testing.assert_allclose(w, np.where(r < 1, -1.0 if inward else 1.0, 0.0), atol=1e-9)
    assert s.base == int(inward) and s.open_triangles == 0
    np.testing.assert_array_equal(inside(s, p), (r > 1) if inward else (r < 1))


def test_a_whole_number_close_to_the_surface_and_far_from_the_origin() -> None:
    far = np.array([4e3, -7e3, 9e3])
    s = solids([box(far, far + 1, inward=False)])
    for gap in (1e-3, 1e-6):
        p = far + np.array([[0.3, 0.4, gap], [0.3, 0.4, -gap], [1 - gap, 0.2, 0.9], [1 + gap, 0.2, 0.9]])
        assert inside(s, p).tolist() == [True, False, True, False]


def test_a_room_in_a_building_and_a_block_in_the_room() -> None:
    """The building faces outwards, the room inwards, the block outwards: solid, hollow, solid; the world outside is free."""
    nest = [
        box((0, 0, 0), (8, 8, 8), inward=False),
        box((1, 1, 1), (7, 7, 7)),
        box((3, 3, 3), (5, 5, 5), inward=False),
    ]
    p = np.array([[4.0, 4, 4], [2, 4, 4], [0.5, 4, 4], [-1, 4, 4]])
    assert inside(solids(nest), p).tolist() == [True, False, True, False]
    # Without the building's outer faces the room's shell stands for all the world around it.
    bare = solids(nest[1:])
    assert bare.base == 1 and inside(bare, p).tolist() == [True, False, True, True]
    two = solids([box((0, 0, 0), (1, 1, 1)), box((1.2, 0, 0), (2.2, 1, 1))])
    assert inside(two, np.array([[0.5, 0.5, 0.5], [1.1, 0.5, 0.5], [1.7, 0.5, 0.5]])).tolist() == [False, True, False]


def test_a_box_made_of_six_meshes_is_closed_and_of_five_is_not() -> None:
    sides = [quad(corners) for corners in box_quads((0, 0, 0), (1, 1, 1), inward=False)]
    assert len(solids(sides).faces) == 1 and solids(sides).open_triangles == 0
    five = solids(sides[:5])
    assert not five.faces and five.open_triangles == 10
    assert not inside(five, np.array([[0.5, 0.5, 0.5]])).any()


def test_a_flipped_face_opens_a_mesh() -> None:
    made = box((0, 0, 0), (1, 1, 1), inward=False)
    faces = made.faces.copy()
    faces[3] = faces[3][::-1]
    assert not solids([mesh(made.vertices, faces)]).faces


def test_open_meshes_beside_closed_ones_are_counted_and_sheets_are_not() -> None:
    floor = quad([(-5, 0, -5), (-5, 0, 5), (5, 0, 5), (5, 0, -5)])
    pane = quad([(-5, 0, 2), (-5, 2, 2), (5, 2, 2), (5, 0, 2)], mat=1)
    ball = box((0, 1, 0), (1, 2, 1), inward=False)
    s = solids([floor, pane, ball], two_sided=True)
    assert s.open_triangles == 2 and s.triangles == 12
    assert inside(s, np.array([[0.5, 1.5, 0.5], [0.5, -1.0, 0.5]])).tolist() == [True, False]


def test_boxes_that_share_a_corner_or_an_edge() -> None:
    """A corner alone does not join pieces; an edge does, and the four faces there still balance."""
    corner = solids([box((0, 0, 0), (1, 1, 1), inward=False), box((1, 1, 1), (2, 2, 2), inward=False)])
    assert len(corner.faces) == 2
    edge = solids([box((0, 0, 0), (1, 1, 1), inward=False), box((1, 1, 0), (2, 2, 1), inward=False)])
    assert sum(len(f) for f in edge.faces) == 24 and not edge.open_triangles
    p = np.array([[0.5, 0.5, 0.5], [1.5, 1.5, 0.5], [0.5, 1.5, 0.5]])
    assert inside(edge, p).tolist() == [True, True, False]
