"""Rays of patches, points, probes and cubemap texels: where they start, where they go, and what they find."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.pipeline import bake_surfaces, light_patches
from lightgauge.reference.progress import silent
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport.form_factors import FormFactors, form_factors, patch_form_factors
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.receivers import (
    Receivers,
    area_receivers,
    patch_elements,
    patch_receivers,
    point_receivers,
    probe_receivers,
    some_of,
    texel_receivers,
)
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.visibility import LIFT, Geometry, build_geometry
from scipy import stats
from small_scenes import box, box_quads, material, polygon_mesh, quad, random_units, scene, surfaces

Array = npt.NDArray[Any]
WALLS = ("-x", "+x", "-y", "+y", "-z", "+z")  # the order of box_quads
FACES = ("+x", "-x", "+y", "-y", "+z", "-z")  # the order of cube maps
# OpenGL 4.6, table 8.19: which coordinates, with sign, grow along a row and down a column of each face.
ALONG = {"+x": "-z", "-x": "+z", "+y": "+x", "-y": "+x", "+z": "+x", "-z": "-x"}
DOWN = {"+x": "-y", "-x": "-y", "+y": "+z", "-y": "-z", "+z": "-y", "-z": "-y"}


def axis(name: str) -> Array:
    return np.eye(3)["xyz".index(name[1])] * (1.0 if name[0] == "+" else -1.0)


def rays_of(r: Receivers, rows: Array, u: Array) -> tuple[Array, Array]:
    """Origins and directions (N, 3) of receivers `rows` (N,) for numbers u (N, 4)."""
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    numbers = [mi.Float(np.ascontiguousarray(u[:, d], dtype=np.float32)) for d in range(4)]
    origin, direction = r.rays(mi.UInt32(rows.astype(np.uint32)), lambda d: numbers[d])
    dr.eval(origin, direction)
    return np.array(origin).T.astype(np.float64), np.array(direction).T.astype(np.float64)


def uniform(n: int, seed: int) -> Array:
    return np.random.default_rng(seed).random((n, 4), dtype=np.float32)


# Patches


def test_origins_are_uniform_over_triangles_of_unlike_size() -> None:
    """Two receivers: one of a large, a small and a tiny triangle, one of a single other. 100,000 points: shares of the area, and
    of the four similar pieces of each triangle, by chi-square (9 + 3 and 3 + 3 degrees: under 40 has a chance of 1e-4)."""
    g = build_geometry(scene([quad([[0, 0, 0], [8, 0, 0], [8, 8, 0], [0, 8, 0]])]))
    triangles = np.array([[[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[5, 0, 0], [6, 0, 0], [5, 2, 0]], [[5, 5, 0], [5.2, 5, 0], [5, 5.2, 0]],
                          [[0, 5, 1], [1, 5, 2], [0, 7, 1]]], float)  # fmt: skip
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normals = cross / (2.0 * area[:, None])
    r = area_receivers(g, triangles, normals, np.array([0, 3]), np.array([3, 4]))
    assert r.count == 2
    for row, mine in ((0, [0, 1, 2]), (1, [3])):
        origin, d = rays_of(r, np.full(100_000, row), uniform(100_000, row))
        place = origin * g.scale + g.centre
        chi = 0.0
        for t in mine:
            a, b, c = triangles[t]
            off = (place - a) @ normals[t] / g.scale
            e = np.stack([b - a, c - a], axis=1)
            uv = np.linalg.lstsq(e, (place - a).T, rcond=None)[0].T
            inside = (uv > -1e-5).all(axis=1) & (uv.sum(axis=1) < 1 + 1e-5) & (np.abs(off - LIFT) < 1e-6)
            share = area[t] / area[mine].sum()
            piece = np.where(
                uv[inside].sum(axis=1) < 0.5, 0, np.where(uv[inside, 0] > 0.5, 1, np.where(uv[inside, 1] > 0.5, 2, 3))
            )
            count, expected = np.bincount(piece, minlength=4), 25_000 * share
            chi += float(((count - expected) ** 2 / expected).sum())
            cosine = d[inside] @ normals[t]
            assert (cosine >= 0.0).all() and cosine.mean() == pytest.approx(
                2 / 3, abs=4 * 0.24 / math.sqrt(inside.sum())
            )
        assert chi < 40.0, chi


def test_directions_follow_the_cosine() -> None:
    """cos² is uniform, the azimuth too: Kolmogorov and Smirnov on 20,000 rays, error rate 1e-4 each; fronts and backs."""
    g, p = surfaces(scene([quad([[0, 0, 0], [0, 0.5, 2], [3, 0.5, 2], [3, 0, 0]])], [material(two_sided=True)]), 9.0)
    r = patch_receivers(g, p)
    for row in range(2):
        origin, d = rays_of(r, np.full(20_000, row), uniform(20_000, 3 + row))
        n = p.normal[row]
        across = np.cross(n, [1.0, 0.0, 0.0])
        azimuth = np.arctan2(d @ across, d[:, 0]) / (2 * math.pi) + 0.5
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, rtol=1e-5)
        for x in ((d @ n) ** 2, azimuth):
            assert stats.kstest(x, "uniform").pvalue > 1e-4
        corner = (g.vertices[0] - g.centre) / g.scale
        np.testing.assert_allclose((origin - corner) @ n, LIFT, atol=3e-7)  # on the patch's own side
    assert (p.normal[0] == -p.normal[1]).all()


def test_elements_of_all_patches_backs_included() -> None:
    sheet, floor = (quad([[0, y, 0], [0, y, 2], [3, y, 2], [3, y, 0]], mat=m) for y, m in ((1, 1), (0, 0)))
    _, p = surfaces(scene([sheet, floor], [material(), material(two_sided=True)]), 0.5)
    element, sign, patch = patch_elements(p)
    assert len(element) == len(p.element_triangle) + (p.element_back >= 0).sum()
    front = sign > 0
    np.testing.assert_array_equal(np.sort(element[front]), np.arange(len(p.element_triangle)))
    np.testing.assert_array_equal(p.element_patch[element[front]], patch[front])
    np.testing.assert_array_equal(p.element_back[element[~front]], patch[~front])
    assert (np.diff(patch) >= 0).all()


def test_some_of_them() -> None:
    g, p = surfaces(scene([box((0, 0, 0), (1, 2, 3))]), 0.8)
    whole, rows = patch_receivers(g, p), np.array([3, 0, 7, 7])
    u = uniform(4000, 9)
    number = np.arange(4000) % 4
    for a, b in zip(rays_of(some_of(whole, rows), number, u), rays_of(whole, rows[number], u), strict=True):
        np.testing.assert_array_equal(a, b)
    assert some_of(whole, rows).count == 4


# Points and probes


def test_points_and_probes() -> None:
    g, _ = surfaces(scene([box((1, 2, 3), (3, 6, 5))]), 1.0)
    places, normals = np.array([[1.5, 3, 4], [2.5, 5, 3.5]]), random_units(2, 4)
    for row in range(2):
        origin, d = rays_of(point_receivers(g, places, normals), np.full(20_000, row), uniform(20_000, row))
        np.testing.assert_allclose(
            origin, np.tile((places[row] - g.centre) / g.scale + LIFT * normals[row], (20_000, 1)), atol=1e-7
        )
        assert stats.kstest((d @ normals[row]) ** 2, "uniform").pvalue > 1e-4
        origin, d = rays_of(probe_receivers(g, places), np.full(20_000, row), uniform(20_000, 5 + row))
        np.testing.assert_allclose(origin, np.tile((places[row] - g.centre) / g.scale, (20_000, 1)), atol=1e-7)
        for k in range(3):
            assert stats.kstest((d[:, k] + 1.0) / 2.0, "uniform").pvalue > 1e-4


# Cubemaps


def test_texels_lie_as_in_opengl() -> None:
    """Directions of two cubemaps of 5 × 5 texels a face against the table, and that every ray lies in its texel."""
    g, size = build_geometry(scene([box((0, 0, 0), (1, 1, 1))])), 5
    r = texel_receivers(g, np.array([[0.3, 0.5, 0.7], [0.6, 0.1, 0.2]]), size)
    assert r.count == 2 * 6 * size * size and r.weight == 1.0 / math.pi
    rows = np.repeat(np.arange(r.count), 50)
    u = uniform(len(rows), 2)
    origin, d = rays_of(r, rows, u)
    column, row, face, cube = rows % size, rows // size % size, rows // size**2 % 6, rows // size**2 // 6
    np.testing.assert_allclose(
        origin, (np.array([[0.3, 0.5, 0.7], [0.6, 0.1, 0.2]])[cube] - g.centre) / g.scale, atol=1e-7
    )
    for k, name in enumerate(FACES):
        mine = face == k
        assert (np.abs(d[mine]).max(axis=1) == d[mine] @ axis(name)).all()  # the face's axis is the largest
        s, t = (0.5 * (d[mine] @ axis(table[name]) / (d[mine] @ axis(name)) + 1.0) * size for table in (ALONG, DOWN))
        np.testing.assert_allclose(s, column[mine] + u[mine, 0], atol=1e-5)
        np.testing.assert_allclose(t, row[mine] + u[mine, 1], atol=1e-5)


def lit_room(centre: Array, size: int, rays: int) -> tuple[Array, FormFactors, Patches, Array]:
    """Radiance (6, size, size) seen in a room whose walls shine with 1 … 6 (in the order of WALLS), from `centre`."""
    walls = [quad(q, mat=i, emission=float(i + 1)) for i, q in enumerate(box_quads((-1, -1, -1), (1, 1, 1)))]
    g, p = surfaces(scene(walls, [material(0.0)] * 6), 0.5)
    rows = form_factors(g, p, texel_receivers(g, centre[None], size), rays, 3, silent, "texels")
    light = np.concatenate([p.exitance[:, 0], np.zeros(SKY_BINS + 1)])
    return (rows.matrix() @ light).reshape(6, size, size), rows, p, light


def test_faces_show_the_walls_they_look_at() -> None:
    """From the middle every face sees one wall whole: its radiance, 1 … 6 W·m⁻²·sr⁻¹, in all texels."""
    found, rows, p, _ = lit_room(np.zeros(3), 4, 64)
    for k, name in enumerate(FACES):
        np.testing.assert_allclose(found[k], WALLS.index(name) + 1.0, rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(rows.matrix().sum(axis=1), 1.0 / math.pi, rtol=1e-6)
    assert rows.patches == p.count and (rows.se >= 0.0).all()


def test_texels_are_means_over_their_square() -> None:
    """Away from the middle texels see two walls and three: against 200 × 200 points of each by hand. 1,024 rays a texel: standard
    errors from the rows, 216 texels within 6 of them or 2e-2."""
    centre, size, fine = np.array([0.4, -0.3, 0.2]), 6, 200
    found, rows, _, light = lit_room(centre, size, 1024)
    grid = (np.arange(size * fine) + 0.5) / (size * fine) * 2.0 - 1.0
    t, s = np.meshgrid(grid, grid, indexing="ij")
    runs = zip(rows.indptr[:-1], rows.indptr[1:], strict=True)
    squares = [((rows.se[a:b, 0] * light[rows.columns[a:b]]) ** 2).sum() for a, b in runs]
    noise, mixed = np.sqrt(squares).reshape(6, size, size), 0
    for k, name in enumerate(FACES):
        d = axis(name) + s[..., None] * axis(ALONG[name]) + t[..., None] * axis(DOWN[name])
        with np.errstate(divide="ignore"):
            reach = np.where(d > 0, (1.0 - centre) / d, (-1.0 - centre) / d)
        wall = reach.argmin(axis=2)
        positive = np.take_along_axis(d, wall[..., None], 2)[..., 0] > 0
        radiance = 2.0 * wall + positive + 1.0
        exact = radiance.reshape(size, fine, size, fine).mean(axis=(1, 3))
        assert (np.abs(found[k] - exact) <= 6.0 * noise[k] + 2e-2).all(), name
        mixed += int((exact != np.round(exact)).sum())
    assert mixed > 20


def test_edges_of_faces_meet() -> None:
    """A function of the direction, x + 2y + 3z, at the middles of 16 × 16 texels a face: from a texel to its four nearest it jumps
    over edges of faces no more than within them."""
    g, size = build_geometry(scene([box((0, 0, 0), (1, 1, 1))])), 16
    r = texel_receivers(g, np.array([[0.5, 0.5, 0.5]]), size)
    rows = np.arange(r.count)
    _, d = rays_of(r, rows, np.full((r.count, 4), 0.5))
    value, face = d @ [1.0, 2.0, 3.0], rows // size**2
    neighbours = np.argsort(d @ d.T, axis=1)[:, -5:-1]
    jump = np.abs(value[neighbours] - value[:, None])
    across = face[neighbours] != face[:, None]
    assert across.sum() >= 12 * size and jump[across].max() < 1.2 * jump[~across].max()
    # the same function by place on each face is smooth, so rows and columns run on: no texel lies where another does
    assert len(np.unique(d.round(6), axis=0)) == r.count


# Any scale and place


@pytest.mark.parametrize("scale, shift", [(1e-4, 0.0), (1e-2, 0.0), (1e4, 0.0), (1.0, 1e4), (0.1, -3e3)])
def test_rays_do_not_care_for_scale_or_place(scale: float, shift: float) -> None:
    """A closed room with a block on its floor and a sheet: form factors from 16,384 rays of the same seed, all within 1e-4 (one
    ray is 6e-5); closure 1e-6 and energy balance 1e-4 through the pipeline."""
    walls = [quad(q, emission=(1.0 if i == 3 else 0.0)) for i, q in enumerate(box_quads((0, 0, 0), (3, 2, 2)))]
    block = box((1.0, 0.0, 0.5), (1.6, 0.8, 1.1), inward=False)
    sheet = quad([[1.6, 0.8, 0.5], [2.2, 0.0, 0.5], [2.2, 0.0, 1.3], [1.6, 0.8, 1.3]], mat=1)
    materials = [material(0.7), material(0.7, two_sided=True)]

    def matrix(meshes: list[Any], size: float) -> Array:
        g, p = surfaces(scene(meshes, materials), size)
        return np.asarray(patch_form_factors(g, p, 1 << 14, 3, silent).matrix().toarray())

    plain = [*walls, block, sheet]
    moved = [dataclasses.replace(m, vertices=scale * (m.vertices + shift)) for m in plain]
    np.testing.assert_allclose(matrix(moved, scale * 0.9), matrix(plain, 0.9), atol=1e-4)
    s = scene(moved, materials, radiosity={"patch_size": scale * 0.5, "rays": 256})
    baked = bake_surfaces(s, 1)
    assert baked.laws.closure <= 1e-6 and baked.laws.reciprocity <= 1e-6
    assert light_patches(s, baked, 1).radiosity.energy_residual <= 1e-4


def test_what_a_row_of_each_kind_is() -> None:
    """Count, weight of a ray, and whether rows are spherical."""
    g: Geometry = build_geometry(scene([box((0, 0, 0), (1, 1, 1))]))
    kinds: list[tuple[Receivers, int, bool, float]] = [
        (point_receivers(g, np.zeros((3, 3)), random_units(3, 1)), 3, False, 1.0),
        (probe_receivers(g, np.zeros((4, 3))), 4, True, 4.0),
        (texel_receivers(g, np.zeros((1, 3)), 2), 24, False, 1.0 / math.pi),
    ]
    for r, count, spherical, weight in kinds:
        assert (r.count, r.spherical, r.weight) == (count, spherical, weight)


def test_no_ray_slips_behind_a_sharp_edge() -> None:
    """A closed wedge of 23°: an origin lifted beside its sharp edge must not come to lie behind the other wall. Without the inset
    one ray in 100,000 did, and its row saw the sky."""
    sharp = [[0, 0, 0], [2, 0, 0], [0, 0.85, 0], [0, 0, 9], [2, 0, 9], [0, 0.85, 9]]
    faces = [[0, 1, 2], [5, 4, 3], [0, 3, 4, 1], [1, 4, 5, 2], [2, 5, 3, 0]]
    g, p = surfaces(scene([polygon_mesh(sharp, faces)]), 0.7)
    rows = patch_form_factors(g, p, 8192, 1, silent)
    assert rows.columns.max() < p.count
