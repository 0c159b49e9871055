"""Rays, hits and the unit box."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.visibility import (
    build_geometry,
    cast,
    merge,
    occluded,
    points_on_triangles,
    to_box,
    triangle_frames,
    vectors,
)
from small_scenes import box, material, mesh, quad, random_units, scene, sphere_mesh


def test_hits_lie_where_the_ray_meets_the_plane() -> None:
    """Barycentric weights, distance and side of a hit, from the closed form of a box."""
    g = build_geometry(scene([box((-1, -2, -3), (2, 3, 1))]))
    rng = np.random.default_rng(0)
    origins = rng.uniform((-0.9, -1.9, -2.9), (1.9, 2.9, 0.9), (2000, 3))
    d = random_units(2000, 1)
    hits = cast(g, to_box(g, origins), vectors(d))
    lo, hi = np.array([-1, -2, -3.0]), np.array([2, 3, 1.0])
    expected = np.where(d > 0, (hi - origins) / d, (lo - origins) / d).min(axis=1)
    assert np.array(hits.hit).all() and np.array(hits.front).all()
    np.testing.assert_allclose(np.array(hits.t), expected, rtol=1e-5, atol=1e-5)
    uv = np.stack([np.array(hits.u), np.array(hits.v)], axis=1)
    points = points_on_triangles(g, np.array(hits.triangle), uv)
    np.testing.assert_allclose(points, origins + expected[:, None] * d, atol=2e-5)


def test_miss_is_infinite_and_back_is_not_front() -> None:
    g = build_geometry(scene([quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])]))
    origins = np.array([[0.3, 0.6, 1.0], [0.3, 0.6, -1.0], [0.3, 0.6, 1.0]])
    d = np.array([[0, 0, -1.0], [0, 0, 1.0], [0, 0, 1.0]])
    hits = cast(g, to_box(g, origins), vectors(d))
    assert np.array(hits.hit).tolist() == [True, True, False]
    assert np.array(hits.front).tolist() == [True, False, False]
    assert np.array(hits.t).tolist() == pytest.approx([1.0, 1.0, np.inf])


@pytest.mark.parametrize("offset", [0.0, 1e2, 1e4, 1e6])
def test_closed_box_far_from_the_origin_does_not_leak(offset: float) -> None:
    """failure-catalogue A1: a 0.2 m box; the miss share must be 0."""
    low = np.full(3, offset)
    g = build_geometry(scene([box(low, low + 0.2)]))
    d = random_units(200_000, 2)
    # half of the rays towards edges and corners, where a crack would be
    d[::2] = np.sign(d[::2]) * (1.0, 1.0, 0.999999)
    d[1::4, 0] = d[1::4, 1]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    hits = cast(g, to_box(g, np.repeat([low + 0.1], len(d), axis=0)), vectors(d))
    assert not (~np.array(hits.hit)).any()


def test_occlusion_obeys_the_distance() -> None:
    g = build_geometry(scene([quad([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])]))
    origins = np.array([[0.2, 0.1, -2.0]] * 3)
    d = np.array([[0, 0, 1.0]] * 3)
    reach = np.array([1.9, 2.1, np.inf], np.float32) / np.float32(g.scale)
    assert np.array(occluded(g, to_box(g, origins), vectors(d), reach)).tolist() == [False, True, True]


def test_merge_keeps_owner_and_order() -> None:
    a, b = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), box((0, 0, 0), (1, 1, 1))
    vertices, faces, owner = merge([a, b], [4, 7])
    assert len(vertices) == 4 + 24 and owner.tolist() == [4] * 2 + [7] * 12
    np.testing.assert_array_equal(vertices[faces[2:]], b.vertices[b.faces])


def test_frames_of_triangles() -> None:
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [4, 0, 0.0]])
    normals, areas = triangle_frames(vertices, np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3]], np.int32))
    np.testing.assert_allclose(normals, [[0, 0, 1], [0, 0, -1], [0, 0, 0]])
    assert areas.tolist() == [3.0, 3.0, 0.0]


def test_what_counts_as_the_inside_of_something() -> None:
    sheet = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], mat=1)
    crate = box((2, 0, 0), (3, 1, 1), inward=False, mat=1)
    plain = quad([[0, 0, 5], [1, 0, 5], [1, 1, 5], [0, 1, 5]])
    g = build_geometry(scene([sheet, crate, plain], [material(), material(two_sided=True)]))
    assert g.two_sided.tolist() == [True] * 14 + [False] * 2
    assert g.counts_as_back.tolist() == [False] * 2 + [True] * 12 + [True] * 2


def test_glass_and_moving_meshes_are_left_out() -> None:
    room = box((0, 0, 0), (1, 1, 1))
    pane = quad([[0, 0, 0.5], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0.5]], mat=1)
    cart = box((0.2, 0.2, 0.2), (0.3, 0.3, 0.3), inward=False, static=False)
    s = scene([room, pane, cart], [material(), material(passes_light=True)])
    assert set(build_geometry(s).mesh.tolist()) == {0}
    assert set(build_geometry(s, moving=True).mesh.tolist()) == {0, 2}
    with pytest.raises(ValueError, match="no static, opaque mesh"):
        build_geometry(scene([pane], [material(), material(passes_light=True)]))


def test_unit_box_is_independent_of_units() -> None:
    """failure-catalogue A11: the same scene × 1e-4 … 1e4 gives the same hits."""
    d = random_units(5000, 3)
    answers = []
    for unit in (1e-4, 1.0, 1e4):
        g = build_geometry(scene([sphere_mesh(unit, 2)]))
        hits = cast(g, to_box(g, np.tile([0.3, 0.1, -0.2], (5000, 1)) * unit), vectors(d))
        answers.append((np.array(hits.triangle), np.array(hits.t) / unit))
    for triangle, t in answers[1:]:
        assert (triangle != answers[0][0]).mean() < 1e-3
        np.testing.assert_allclose(t, answers[0][1], rtol=1e-5)


def test_a_degenerate_triangle_is_no_obstacle() -> None:
    s = scene(
        [mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, -1], [1, 0, -1], [0, 1, -1]], [[0, 1, 2], [4, 5, 6]])]
    )
    g = build_geometry(s)
    hits = cast(g, to_box(g, np.array([[0.2, 0.2, 1.0]])), vectors(np.array([[0, 0, -1.0]])))
    assert np.array(hits.triangle)[0] == 1
