"""Columns in which rays end: the kernel against a NumPy twin that goes by `element_of` and `bin_of`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.sky import BINS_PER_EDGE, SKY_BINS, bin_of
from lightgauge.reference.transport.elements import element_of
from lightgauge.reference.transport.hits import columns_of_rays, element_at, upload_patches
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.visibility import Geometry, cast, to_box, vectors
from small_scenes import box, box_quads, grid_quad, material, quad, random_units, scene, sphere_mesh, surfaces

Array = npt.NDArray[Any]
RAYS = 300_000


def mixed_room() -> Scene:
    """Open at +z: one-sided walls, a two-sided sheet, a closed crate, a closed two-sided ball, a fine floor."""
    walls = [quad(q) for q in box_quads((0, 0, 0), (3, 2, 2))[:5]]
    sheet = quad([[1, 0.2, 0.5], [2, 0.2, 0.7], [2, 1.2, 0.9], [1, 1.2, 0.5]], mat=1)
    crate = box((0.2, 0.1, 0.2), (0.7, 0.8, 0.6), inward=False)
    ball = sphere_mesh(0.3, 1, inward=False, mat=1)
    moved = type(ball)(**{**vars(ball), "vertices": ball.vertices + np.array([2.3, 1.0, 1.2])})
    fine = grid_quad([[0.1, 0.05, 1.9], [2.9, 0.05, 1.9], [2.9, 0.05, 1.1], [0.1, 0.05, 1.1]], 13)
    return scene([*walls, sheet, crate, moved, fine], [material(), material(two_sided=True)])


def columns_plain(g: Geometry, p: Patches, origins: Array, directions: Array) -> tuple[Array, Array, Array]:
    """Column (N,), met the inside (N,), and whether it lies within rounding of an element's or a bin's border."""
    hits = cast(g, to_box(g, origins), vectors(directions))
    hit, triangle, front = (np.array(x) for x in (hits.hit, hits.triangle, hits.front))
    u, v = (np.where(hit, np.array(x), 0.0).astype(np.float64) for x in (hits.u, hits.v))
    element = element_of(p.cuts, p.first_element, triangle, u, v)
    side = np.where(front, p.element_patch[element], p.element_back[element])
    absorbed = p.count + SKY_BINS
    column = np.where(hit, np.where(side < 0, absorbed, side), p.count + bin_of(directions.astype(np.float32)))
    k, size = p.cuts[triangle], np.sort(np.abs(directions), axis=1)
    in_element = np.stack([u * k, v * k, (u + v) * k])
    in_sky = np.stack([size[:, 0] / size[:, 2], size[:, 1] / size[:, 2], 0.125 + 0.0 * k]) * BINS_PER_EDGE / 2
    borders = np.where(hit, in_element, in_sky)
    return column, hit & ~front & g.counts_as_back[triangle], np.abs(borders - np.round(borders)).min(axis=0) < 1e-4


@pytest.mark.parametrize("size", [0.13, 0.6, 50.0])
def test_columns_are_those_of_the_numpy_twin(size: float) -> None:
    """300,000 rays from everywhere, insides included. Where they differ they must lie on a border between elements."""
    g, p = surfaces(mixed_room(), size)
    rng = np.random.default_rng(1)
    origins, d = rng.uniform((-0.5, -0.5, -0.5), (3.5, 2.5, 2.5), (RAYS, 3)), random_units(RAYS, 2)
    column, back = (np.array(x) for x in columns_of_rays(g, upload_patches(g, p), to_box(g, origins), vectors(d)))
    expected, met_back, near_border = columns_plain(g, p, origins, d)
    np.testing.assert_array_equal(back.astype(bool), met_back)
    differ = column != expected
    assert differ.mean() < 1e-4 and near_border[differ].all() and near_border.mean() < 0.05
    for kind in (column < p.front, (column >= p.front) & (column < p.count), column == p.count + SKY_BINS, back):
        assert kind.mean() > 0.005  # fronts, backs, absorbed: all kinds are there
    assert ((column >= p.count) & (column < p.count + SKY_BINS)).mean() > 0.1


def test_inside_of_a_closed_two_sided_mesh_reflects_and_counts_as_back() -> None:
    g, p = surfaces(scene([sphere_mesh(1.0, 2, inward=False)], [material(two_sided=True)]), 0.4)
    d = random_units(1000, 3)
    column, back = columns_of_rays(g, upload_patches(g, p), to_box(g, np.zeros((1000, 3))), vectors(d))
    assert np.array(back).all()
    assert (np.array(column) >= p.front).all() and (np.array(column) < p.count).all()


@pytest.mark.parametrize("k", [1, 2, 3, 64, 511, 512])
def test_element_at_is_element_of(k: int) -> None:
    """200,000 points, corners and edges with rounding over them; the kernel's float32 products decide at borders only."""
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    rng = np.random.default_rng(k)
    uv = rng.random((200_000, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    edge = np.array([[0, 0], [1, 0], [0, 1], [-1e-7, 0.5], [0.5, -1e-7], [0.5, 0.5 + 1e-7], [1 + 1e-7, -1e-7]])
    u, v = np.concatenate([uv, edge]).astype(np.float32).T
    cuts, first = np.array([k], np.int32), np.array([17])
    expected = element_of(cuts, first, np.zeros(len(u), int), u.astype(np.float64), v.astype(np.float64))
    count = mi.UInt32(np.full(len(u), k, np.uint32))
    found = np.array(element_at(count, dr.opaque(mi.UInt32, 17), mi.Float(u), mi.Float(v))).astype(np.int64)
    assert found.min() >= 17 and found.max() < 17 + k * k
    borders = np.stack([u * k, v * k, (u + v) * k]).astype(np.float64)
    near = np.abs(borders - np.round(borders)).min(axis=0) < 1e-6 * k + 1e-7
    assert (near | (found == expected)).all() and (found != expected).mean() < 1e-3
