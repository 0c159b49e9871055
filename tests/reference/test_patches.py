"""Patches: areas, clustering, two sides, textures, sampling."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from lightgauge.reference.directions import rotate, rotations, sobol
from lightgauge.reference.transport.patches import (
    _coprime,
    auto_patch_size,
    build_patches,
    exitance_of,
    surface_samples,
)
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, grid_quad, material, quad, scene, sphere_mesh, surfaces

FLOOR = [[0, 0, 0], [0, 0, 2], [3, 0, 2], [3, 0, 0]]


@pytest.mark.parametrize("size", [0.05, 0.3, 1.0, 50.0])
def test_areas_sum_to_the_surface(size: float) -> None:
    _, p = surfaces(scene([box((0, 0, 0), (3, 2, 1)), sphere_mesh(0.3, 2, inward=False)]), size)
    ball = sphere_mesh(0.3, 2)
    a, b, c = (ball.vertices[ball.faces[:, i]] for i in range(3))
    exact = 2 * (6 + 2 + 3) + 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert p.area.sum() == pytest.approx(exact, rel=1e-12)
    assert (p.area > 0).all()


@pytest.mark.parametrize("size", [0.25, 0.5])
def test_clusters_do_not_depend_on_how_the_mesh_is_cut(size: float) -> None:
    """A floor of 2 or of 3,200 triangles: the same patches."""
    _, coarse = surfaces(scene([quad(FLOOR)]), size)
    g, fine = surfaces(scene([grid_quad(FLOOR, 40)]), size)
    assert len(g.areas) == 3200
    expected = round(3 / size) * round(2 / size)
    assert coarse.count == pytest.approx(expected, rel=0.25)
    assert fine.count == pytest.approx(expected, rel=0.25)
    assert np.max(fine.area) < 2.3 * size**2 and np.max(coarse.area) < 2.3 * size**2
    assert fine.element_patch.max() + 1 == fine.count < 0.2 * len(g.areas)


def test_two_sided_patches_have_twins() -> None:
    sheet, floor = quad(FLOOR, mat=1), quad(np.array(FLOOR) - [0, 1, 0], emission=2.0)
    g, p = surfaces(scene([sheet, floor], [material(0.2), material(0.7, two_sided=True)]), 0.7)
    backs = np.arange(p.front, p.count)
    assert len(backs) == p.front / 2
    front = p.twin[backs]
    assert (front < p.front).all() and len(set(front.tolist())) == len(backs)
    np.testing.assert_allclose(p.area[backs], p.area[front])
    np.testing.assert_allclose(p.normal[backs], -p.normal[front])
    np.testing.assert_allclose(p.albedo[backs], 0.7)
    assert (p.element_back[~g.two_sided[p.element_triangle]] == -1).all()
    two = g.two_sided[p.element_triangle]
    np.testing.assert_array_equal(p.twin[p.element_back[two]], p.element_patch[two])
    assert (p.exitance[backs] == 0).all()


def test_emitters_shine_from_their_front_only_and_by_tag() -> None:
    a, b = (
        quad(FLOOR, mat=0, emission=(1, 2, 3)),
        quad(np.array(FLOOR) + np.array([0, 1, 0]), emission=5.0, engine=True),
    )
    _, p = surfaces(scene([a, b], [material(0.5, two_sided=True)]), 10.0)
    assert p.front == 2 and p.count == 4
    np.testing.assert_allclose(np.pi * np.array([1, 2, 3]), p.exitance[p.exitance.any(axis=1)][0])
    np.testing.assert_allclose(np.pi * np.array([5, 5, 5]), p.engine_exitance[p.engine_exitance.any(axis=1)][0])
    assert p.exitance.any(axis=1).sum() == 1 and p.engine_exitance.any(axis=1).sum() == 1
    assert not (p.exitance[2:].any() or p.engine_exitance[2:].any())


def test_materials_and_emitters_never_share_a_patch() -> None:
    halves = [quad(np.array(FLOOR) * [0.5, 1, 1] + [x, 0, 0], mat=i) for i, x in enumerate((0.0, 1.5))]
    lamp = quad([[0.5, 0, 0.5], [0.5, 0, 0.6], [0.6, 0, 0.6], [0.6, 0, 0.5]], emission=1.0)
    _, p = surfaces(scene([*halves, lamp], [material(0.2), material(0.8)]), 1.0)
    assert set(np.unique(p.albedo.round(12))) == {0.2, 0.8}
    assert p.area[p.exitance.any(axis=1)].sum() == pytest.approx(0.01)


def test_opposite_sides_of_a_thin_wall_are_different_patches() -> None:
    _, p = surfaces(scene([box((0, 0, 0), (1, 1, 1e-3), inward=False)]), 0.5)
    assert np.abs(p.normal).max(axis=1).min() == pytest.approx(1.0)


def test_texture_becomes_the_mean_albedo() -> None:
    """Left half black, right half white: patches wholly in a half have its albedo; row 0 of the picture is v = 1."""
    picture = np.zeros((8, 8, 3), np.float32)
    picture[:, 4:, 0] = 1.0
    picture[:4, :, 1] = 1.0  # upper half
    uvs = np.float32([[0, 0], [1, 0], [1, 1], [0, 1]])
    sheet = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], uvs=uvs)
    _, p = surfaces(scene([sheet], [material(texture=picture)]), 0.125)
    mean = (p.area @ p.albedo) / p.area.sum()
    np.testing.assert_allclose(mean, [0.5, 0.5, 0.0], atol=0.03)
    right, top = p.centroid[:, 0] > 0.6, p.centroid[:, 1] > 0.6
    np.testing.assert_allclose(p.albedo[right, 0], 1.0)
    np.testing.assert_allclose(p.albedo[top, 1], 1.0)
    np.testing.assert_allclose(p.albedo[p.centroid[:, 0] < 0.4, 0], 0.0)


@pytest.mark.parametrize("cells", [4, 32, 128])
def test_pictures_finer_than_elements_do_not_alias(cells: int) -> None:
    """A chequerboard: every patch has the mean of what lies on it, looked up at many points of it at random."""
    board = np.indices((cells, cells)).sum(axis=0) % 2 == 1
    picture = np.repeat(np.float32(0.8) * board[..., None], 3, axis=2)
    uvs = np.float32([[0, 0], [1, 0], [1, 1], [0, 1]])
    sheet = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], uvs=uvs)
    g, p = surfaces(scene([sheet], [material(texture=picture)]), 0.25)
    uvw = np.random.default_rng(5).random((p.count, 1 << 13, 3))
    points, _ = surface_samples(g, p, np.arange(p.count), uvw)
    column, row = np.floor(points[..., :2] * cells).astype(int).clip(0, cells - 1).transpose(2, 0, 1)
    looked_up = 0.8 * board[cells - 1 - row, column].mean(axis=1)
    np.testing.assert_allclose(p.albedo[:, 0], looked_up, atol=0.02)


def test_emission_texture_becomes_the_mean_exitance() -> None:
    """A picture of which the left half shines red, the lower half green: exitance is π × radiance × its mean over each patch, and
    the whole is that of the picture. Only the mesh's own emission counts, only the front shines, albedo stays."""
    picture = np.zeros((8, 8, 3), np.float32)
    picture[:, :4, 0] = 2.0
    picture[4:, :, 1] = 0.5
    uvs = np.float32([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    sign = quad(corners, uvs=uvs, emission=(3.0, 3.0, 3.0))
    unlit = quad(corners + np.array([2.0, 0, 0]), uvs=uvs)
    _, p = surfaces(scene([sign, unlit], [material(0.3, two_sided=True, emission_texture=picture)]), 0.125)
    front = p.exitance[: p.front]
    np.testing.assert_allclose(p.area[: p.front] @ front, math.pi * 3.0 * np.array([1.0, 0.25, 0.0]), rtol=0.03)
    own = p.centroid[: p.front, 0] < 1.5
    left, low = p.centroid[: p.front, 0] < 0.4, p.centroid[: p.front, 1] < 0.4
    np.testing.assert_allclose(front[left, 0], 6.0 * math.pi, rtol=1e-6)
    np.testing.assert_allclose(front[own & low, 1], 1.5 * math.pi, rtol=1e-6)
    assert not front[own & (p.centroid[: p.front, 0] > 0.6), 0].any() and not front[~own].any()
    assert not p.exitance[p.front :].any() and not p.engine_exitance.any()
    np.testing.assert_allclose(p.albedo, 0.3)
    np.testing.assert_array_equal(p.emitter[: p.front], np.where(own, 0, -1))
    np.testing.assert_allclose(p.shine[: p.front][own], front[own] / (3.0 * math.pi), rtol=1e-6)


def test_emission_follows_new_lights() -> None:
    """Exitance of the same patches under another emission of their mesh."""
    lamp, wall = quad(FLOOR, emission=(1, 2, 3)), quad(np.array(FLOOR) + np.array([0, 1, 0]), emission=5.0, engine=True)
    s = scene([lamp, wall])
    _, p = surfaces(s, 0.8)
    for was, now in zip((p.exitance, p.engine_exitance), exitance_of(s.meshes, p.emitter, p.shine), strict=True):
        np.testing.assert_array_equal(was, now)
    other = [dataclasses.replace(m, emission=m.emission * 2.0, engine_lit=False) for m in s.meshes]
    exitance, engine = exitance_of(other, p.emitter, p.shine)
    np.testing.assert_allclose(exitance, 2.0 * (p.exitance + p.engine_exitance))
    assert not engine.any()


@pytest.mark.parametrize("scale, shift", [(1e-4, 0.0), (1e4, 0.0), (1 / 3, 0.0), (1.0, 1e4), (0.1, -3e3)])
def test_neither_scale_nor_place_changes_the_patches(scale: float, shift: float) -> None:
    """Sizes that divide edges and places evenly, where rounding could fall either way; slopes of 45° and 1 : 3."""
    ridge = quad([[0, 1, 0], [1.5, 2.5, 0], [1.5, 2.5, 2], [0, 1, 2]])
    roof = quad([[0, 3, 0], [0, 3, 2], [3, 4, 2], [3, 4, 0]])
    meshes = [quad(FLOOR), ridge, roof, box((1, 0, 0.5), (1.6, 0.8, 1.1), inward=False)]
    for size in (0.1, 0.25, 0.4, 0.6):
        _, p = surfaces(scene(meshes), size)
        moved = [dataclasses.replace(m, vertices=scale * (m.vertices + shift)) for m in meshes]
        _, q = surfaces(scene(moved), scale * size)
        np.testing.assert_array_equal(q.key, p.key)
        np.testing.assert_array_equal(q.element_patch, p.element_patch)
        np.testing.assert_allclose(q.area, scale**2 * p.area, rtol=1e-7)


def test_a_cut_patch_becomes_four_and_others_stay() -> None:
    """Away from borders with elements of another size, keys and areas of the others are what they were."""
    s = scene([quad([[0, 0, 0], [0, 0, 2], [2, 0, 2], [2, 0, 0]]), box((5, 0, 0), (6, 1, 1))])
    g = build_geometry(s)
    p = build_patches(s, g, 0.5)
    chosen = p.key[np.flatnonzero(p.centroid[: p.front, 0] < 4.0)[[5]]]
    q = build_patches(s, g, 0.5, [chosen])
    of = (q.key[:, 0] == 1) & (q.key[:, 3:] // 2 == chosen[0, 3:]).all(axis=1)
    assert of.sum() == 4 and (q.key[~of, 0] == 0).all() and len(q.key) == len(p.key) + 3
    assert q.area[: q.front][of].sum() == pytest.approx(0.25, rel=0.2)
    room = p.centroid[: p.front, 0] > 4.0
    np.testing.assert_array_equal(q.area[: q.front][q.centroid[: q.front, 0] > 4.0], p.area[: p.front][room])
    assert q.area.sum() == pytest.approx(p.area.sum(), rel=1e-12)


def test_samples_are_uniform_over_a_patch() -> None:
    """One patch of 3,200 + 2 triangles of unlike size: points by area. Chi-square on 6 × 4 cells."""
    n = 4096
    meshes = [
        grid_quad([[0, 0, 0], [0, 0, 2], [1.5, 0, 2], [1.5, 0, 0]], 40),
        quad(np.array(FLOOR) * [0.5, 1, 1] + [1.5, 0, 0]),
    ]
    g, p = surfaces(scene(meshes), 100.0)
    assert p.count == 1
    chi = []
    for seed in range(10):
        xi = np.random.default_rng(seed).random((1, n, 3)).astype(np.float32)
        points, normals = surface_samples(g, p, np.array([0]), xi)
        assert np.allclose(normals, [0, 1, 0]) and np.allclose(points[..., 1], 0)
        cell = (points[0, :, 0] / 0.5).astype(int) * 4 + (points[0, :, 2] / 0.5).astype(int)
        chi.append(((np.bincount(cell, minlength=24) - n / 24) ** 2 / (n / 24)).sum())
    # 230 degrees of freedom; stratification may only lower it: over 230 + 5 sd = 337 has a chance under 1e-5
    assert 0 < sum(chi) < 337


def test_sobol_samples_are_stratified() -> None:
    """The same with the product's point set: the discrepancy of 4,096 points is far under random."""
    g, p = surfaces(scene([quad(FLOOR)]), 100.0)
    xi = rotate(sobol(4096, 5, 1)[None], rotations(1, 5, 1)[:, None])
    points, _ = surface_samples(g, p, np.array([0]), xi[..., :3])
    cell = (points[0, :, 0] / 0.5).astype(int) * 4 + (points[0, :, 2] / 0.5).astype(int)
    assert np.abs(np.bincount(cell, minlength=24) / 4096 - 1 / 24).max() < 0.25 / 24
    np.testing.assert_allclose(points[0].mean(axis=0), [1.5, 0, 1], atol=0.02)


def test_backs_are_sampled_with_their_own_normal() -> None:
    g, p = surfaces(scene([quad(FLOOR)], [material(two_sided=True)]), 1.0)
    xi = np.random.default_rng(0).random((p.count, 5, 3)).astype(np.float32)
    _, normals = surface_samples(g, p, np.arange(p.count), xi)
    np.testing.assert_allclose(normals[: p.front], np.broadcast_to([0, 1, 0], normals[: p.front].shape), atol=1e-12)
    np.testing.assert_allclose(normals[p.front :], np.broadcast_to([0, -1, 0], normals[p.front :].shape), atol=1e-12)


def test_strata_are_a_permutation() -> None:
    for n in (*range(1, 70), 512, 1000, 1024, 4096):
        assert sorted((np.arange(n) * _coprime(n)) % n) == list(range(n))


def test_auto_size_gives_about_2500_patches() -> None:
    g = build_geometry(scene([box((0, 0, 0), (4, 3, 5))]))
    _, p = surfaces(scene([box((0, 0, 0), (4, 3, 5))]), auto_patch_size(g))
    assert 2000 < p.count < 4000
