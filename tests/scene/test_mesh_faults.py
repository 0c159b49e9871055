"""Edges, winding and T-junctions of meshes small enough to know the answer."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.datatypes import F64, I64
from lightgauge.reference.scene.checks import repeated_faces, weld
from lightgauge.reference.scene.document import MeshArrays
from lightgauge.reference.scene.mesh_faults import edges_of, sheet_of, winding_of
from lightgauge.reference.scene.primitives import cube, cylinder, rectangle, sphere
from lightgauge.reference.scene.t_junctions import t_junctions


def places(mesh: MeshArrays) -> tuple[I64, F64]:
    """Corners (F, 3) by place, and the places."""
    number = weld(mesh.vertices)
    points = np.empty((number.max() + 1, 3))
    points[number] = mesh.vertices
    return number[mesh.faces], points


def areas(corners: I64, points: F64) -> F64:
    p = points[corners]
    return 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)


def with_turned(corners: I64, *faces: int) -> I64:
    out = corners.copy()
    out[list(faces)] = out[list(faces), ::-1]
    return out


def test_closed() -> None:
    """The cube has its own corners on every face, so welding is what closes it."""
    box = places(cube())[0]
    assert edges_of(box).closed and edges_of(places(sphere())[0]).closed
    assert edges_of(box[:, ::-1]).closed, "a room: its inside is the front"
    assert not edges_of(places(rectangle())[0]).closed
    assert not edges_of(box[1:]).closed, "a hole"
    one = edges_of(with_turned(box, 3))
    assert (one.count == 2).all() and not one.closed, "one face turned is still watertight"
    assert one.against.sum() == 3


def test_counts_of_a_cube() -> None:
    edges = edges_of(places(cube())[0])
    assert len(edges.ends) == 18 and (edges.count == 2).all() and edges.pairs.shape == (18, 2)
    assert (np.diff(edges.first) == edges.count).all() and np.array_equal(np.sort(edges.half), np.arange(36))


def test_back_to_back_faces_are_a_closed_sheet() -> None:
    faces = np.array([[0, 1, 2], [2, 1, 0]], np.int64)
    assert edges_of(faces).closed and not repeated_faces(faces).any()


@pytest.mark.parametrize("seed", range(8))
def test_any_minority_is_found(seed: int) -> None:
    """Whatever faces are turned, as long as they are fewer than half."""
    corners, points = places(sphere())
    rng = np.random.default_rng(seed)
    turned = rng.permutation(len(corners))[: rng.integers(1, len(corners) // 2)]
    winding = winding_of(edges_of(with_turned(corners, *turned)), areas(corners, points))
    assert np.array_equal(np.flatnonzero(winding.flipped), np.sort(turned))
    assert not winding.undecided.any() and not winding.twisted.any()


def test_pieces_are_judged_apart() -> None:
    """A cube mostly inwards and one mostly outwards keep their own majority."""
    one, points = places(cube())
    corners = np.concatenate([with_turned(one, 0), with_turned(one[:, ::-1], 4, 7) + 8])
    winding = winding_of(edges_of(corners), areas(corners, np.concatenate([points, points + 9.0])))
    assert np.flatnonzero(winding.flipped).tolist() == [0, 12 + 4, 12 + 7]


def test_area_breaks_a_tie() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.9, 0.9, 0]])
    corners = np.array([[0, 1, 2], [1, 2, 3]])  # both run from 1 to 2
    winding = winding_of(edges_of(corners), areas(corners, points))
    assert winding.flipped.tolist() == [False, True] and not winding.undecided.any()
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    winding = winding_of(edges_of(corners), areas(corners, square))
    assert winding.undecided.all() and not winding.flipped.any()


def moebius(steps: int) -> I64:
    """A strip of `steps` quads whose end is joined to its start upside down."""
    i = np.arange(steps)
    low, high = 2 * i, 2 * i + 1
    after_low, after_high = np.append(low[1:], 1), np.append(high[1:], 0)
    return np.concatenate([np.stack([low, after_low, high], 1), np.stack([after_low, after_high, high], 1)])


def test_moebius_strip_has_no_front() -> None:
    winding = winding_of(edges_of(moebius(9)), np.ones(18))
    assert winding.twisted.all() and not winding.flipped.any() and not winding.undecided.any()


def test_flip_beside_an_edge_of_three_faces() -> None:
    """A fin on an edge of a cube parts the surface there and nowhere else: the flip is found, and can be sent."""
    corners, points = places(cube())
    corner = np.argmax(np.all(points == [1, 1, 1], axis=1))
    other = np.argmax(np.all(points == [1, 1, -1], axis=1))
    finned = np.concatenate([with_turned(corners, 5), [[corner, other, 8]]])
    points = np.concatenate([points, [[3.0, 3.0, 0.0]]])
    edges = edges_of(finned)
    assert (edges.count == 3).sum() == 1 and edges.faces_at(edges.count == 3)[-1] == 12
    winding = winding_of(edges, areas(finned, points))
    assert np.flatnonzero(winding.flipped).tolist() == [5] and not winding.twisted.any()
    vertices, triangles, owner = sheet_of(finned, points, edges, np.arange(12))
    sheet = edges_of(triangles)
    assert (sheet.count <= 2).all() and (sheet.count == 1).sum() == 4, "the edge is open, in two halves on each side"
    assert len(triangles) == 12 + 2 * 3 and np.array_equal(np.unique(owner), np.arange(12))
    assert np.allclose(np.bincount(owner, areas(triangles, vertices)), areas(finned, points)[:12])
    assert (
        np.flatnonzero(winding_of(sheet, areas(triangles, vertices)).flipped).tolist()
        == np.flatnonzero(owner == 5).tolist()
    )


def test_t_junction() -> None:
    points = np.array([[0.0, 0, 0], [2, 0, 0], [1, 1, 0], [1, -1, 0], [0.7, 0, 0]])
    corners = np.array([[0, 1, 2], [0, 3, 4], [4, 3, 1]])
    assert t_junctions(points, edges_of(corners)).tolist() == [0]
    points[4, 1] = 1e-3  # off the edge: a slit, no junction
    assert t_junctions(points, edges_of(corners)).tolist() == []


@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_t_junctions_in_single_precision(size: float, offset: float) -> None:
    """A row of bricks over one long brick, turned, moved and rounded as files hold them."""
    x = np.array([0.0, 0.3, 0.9, 1.4, 2.0])
    points = np.concatenate([np.stack([x, np.zeros(5), 0 * x], 1), np.stack([x, np.ones(5), 0 * x], 1)])
    points = np.concatenate([points, [[1.0, -1.0, 0.0]]])
    i = np.arange(4)
    corners = np.concatenate([np.stack([i, i + 1, i + 5], 1), np.stack([i + 1, i + 6, i + 5], 1), [[4, 0, 10]]])
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    rounded = ((points @ turn) * size + offset * size).astype(np.float32).astype(np.float64)
    assert t_junctions(rounded, edges_of(corners)).tolist() == [8]


def test_no_junction_on_clean_rims() -> None:
    for mesh in (cylinder(), rectangle()):
        corners, points = places(mesh)
        assert len(t_junctions(points, edges_of(corners))) == 0
