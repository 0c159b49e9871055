"""Patches cut where the light within them varies: at shadow lines and contacts, nowhere else, and to good purpose."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.datatypes import Scene, Sky
from lightgauge.reference.pipeline import bake_surfaces
from lightgauge.reference.progress import silent
from lightgauge.reference.transport import subdivide
from lightgauge.reference.transport.elements import element_of, points_in_elements
from lightgauge.reference.transport.patch_light import direct_on_patches
from lightgauge.reference.transport.patches import Patches, build_patches
from lightgauge.reference.transport.subdivide import LEVELS, _parents, subdivided_patches
from lightgauge.reference.visibility import Geometry, build_geometry, points_on_triangles
from small_scenes import box, material, quad, scene, sphere_mesh

Array = npt.NDArray[Any]
FLOOR = [[0, 0, 0], [0, 0, 4], [4, 0, 4], [4, 0, 0]]
SIZE, LINE = 0.5, 2.27
BRIGHT = Sky(np.ones((1, 1, 3), np.float32), 0.0, False)


def shadow_line(slope: float = 0.0, **radiosity: float) -> Scene:
    """A floor under half a lid, sun from straight above: shadow up to x = LINE + slope (z - 2)."""
    lid = quad([[-1, 1, -1], [LINE - 3.0 * slope, 1, -1], [LINE + 3.0 * slope, 1, 5], [-1, 1, 5]], mat=1)
    sun = {"type": "directional", "direction": (0, -1, 0), "irradiance": (1, 1, 1)}
    return scene([quad(FLOOR), lid], [material(0.5), material(0.0)], lights={"sun": sun}, radiosity=radiosity)


def contact() -> Scene:
    """A block in the middle of a floor under an even sky: the floor darkens towards it."""
    return scene([quad(FLOOR), box((1.5, 0, 1.5), (2.5, 1, 2.5), inward=False, mat=1)], [material(0.0)] * 2, sky=BRIGHT)


def even() -> Scene:
    """A floor and a ball that does not shade it, under an even sky; a lamp far away that shines evenly."""
    far = {"type": "point", "position": (2, 1e5, 2), "intensity": (1e10, 1e10, 1e10)}
    return scene([quad(FLOOR)], [material(0.5)], sky=BRIGHT, lights={"far": far})


def cut(s: Scene, tolerance: float, seed: int = 1, size: float = SIZE) -> tuple[Geometry, Patches]:
    g = build_geometry(s)

    def guess(p: Patches) -> Array:
        sky = np.full(p.count + 385, 0.0 if s.sky is None else np.pi)
        sky[: p.count], sky[-1] = 0.0, 0.0
        return sky

    def direct(p: Patches) -> Array:
        return np.asarray(direct_on_patches(s, g, p, 16, seed, silent).mean(axis=1))

    return g, subdivided_patches(s, g, size, tolerance, seed, guess, direct)


def on_floor(p: Patches) -> Array:
    return np.flatnonzero(np.abs(p.centroid[: p.front, 1]) < 1e-9)


def extent(g: Geometry, p: Patches, axis: int) -> Array:
    """Smallest and largest coordinate (P_front, 2) of each patch."""
    low, high = np.full(p.front, np.inf), np.full(p.front, -np.inf)
    element = np.arange(len(p.element_triangle))
    for xy in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        uv = points_in_elements(p.cuts, p.first_element, p.element_triangle, element, np.tile(xy, (len(element), 1)))
        x = points_on_triangles(g, p.element_triangle, uv)[:, axis]
        np.minimum.at(low, p.element_patch, x)
        np.maximum.at(high, p.element_patch, x)
    return np.stack([low, high], axis=1)


def test_a_shadow_line_gets_small_patches_and_nothing_else() -> None:
    """A patch of which a share q is lit has a spread √(q(1 - q)): all are cut to the end where that is over 0.4, none where it is 0."""
    g, p = cut(shadow_line(), 0.2)
    level, x = p.key[:, 0], extent(g, p, 0)
    floor = np.isin(np.arange(p.front), on_floor(p))
    lit = direct_on_patches(shadow_line(), g, p, 64, 9, silent)[: p.front, 0]
    mixed = floor & (np.sqrt(lit * (1.0 - lit)) > 0.4)
    assert mixed.sum() >= 16 and (level[mixed] == LEVELS).all()
    away = floor & ((x[:, 1] < LINE - SIZE) | (x[:, 0] > LINE + SIZE))
    assert away.sum() > 30 and not level[away].any() and not level[~floor].any()
    small = p.area[: p.front][level == LEVELS]
    assert np.median(small) == pytest.approx((SIZE / 2**LEVELS) ** 2, rel=0.5)


def test_a_contact_gets_small_patches() -> None:
    """All four sides of the block, and none further than two patches from it: there the floor is even to 2 %."""
    g, p = cut(contact(), 0.04)
    level = p.key[:, 0]
    floor = np.isin(np.arange(p.front), on_floor(p))
    outside = np.abs(p.centroid[: p.front, [0, 2]] - 2.0).max(axis=1) - 0.5  # to the block's outline
    for axis, side in ((0, -1), (0, 1), (2, -1), (2, 1)):
        across = p.centroid[: p.front, 2 - axis]
        near = (
            floor & (side * (p.centroid[: p.front, axis] - 2.0) > 0.5) & (np.abs(across - 2.0) < 0.5) & (outside < 0.25)
        )
        assert near.sum() >= 4 and (level[near] > 0).mean() > 0.5, (axis, side)
    assert not level[floor & (outside > 2.0 * SIZE)].any()
    assert level[floor].max() >= 1 and extent(g, p, 0).shape == (p.front, 2)


@pytest.mark.parametrize("seed", range(5))
def test_none_where_light_is_even(seed: int) -> None:
    """Pilot rays find the same sky everywhere; the far lamp is even to 1e-4."""
    _, p = cut(even(), 0.02, seed)
    assert not p.key[:, 0].any()


def test_noise_of_the_pilot_cuts_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the sky is bright: 64 rays see it with a noise of 6 %, each piece another; the light itself is even. At a tolerance of
    half of that 7.9 ± 2.9 (sd over 30 seeds) of 512 patches are cut; 106 where the noise is not taken off, 61 unconfirmed."""
    monkeypatch.setattr(subdivide, "LEVELS", 1)
    s = scene([quad(FLOOR)], [material(0.5)], sky=BRIGHT)
    g = build_geometry(s)

    def guess(p: Patches) -> Array:
        light = np.zeros(p.count + 385)
        light[p.count : p.count + 384 : 2] = 1.0
        return light

    cuts = 0
    for seed in range(0, 400, 50):  # neighbours would share pilots
        p = subdivided_patches(s, g, SIZE, 0.03, seed, guess, lambda q: np.zeros(q.count))
        cuts += 64 - int((p.key[:, 0] == 0).sum())
    assert cuts < 24


def every_scene() -> dict[str, tuple[Geometry, Patches, float]]:
    ball = sphere_mesh(0.5, 1, inward=False)
    raised = type(ball)(**{**vars(ball), "vertices": ball.vertices + np.array([1.0, 0.5, 1.0])})
    bent = scene([quad(FLOOR), raised], [material(0.5, two_sided=True)], sky=BRIGHT)
    made = {"shadow": (shadow_line(), 0.2), "contact": (contact(), 0.03), "bent": (bent, 0.05)}
    return {name: (*cut(s, tolerance, size=2.0 * SIZE), 2.0 * SIZE) for name, (s, tolerance) in made.items()}


def test_patches_partition_the_surface() -> None:
    """Areas sum to the surface; every element has one patch; keys are unique; points fall into the element they came from, and
    that into the place its key names."""
    for name, (g, p, size) in every_scene().items():
        assert p.key[:, 0].max() > 0, name
        assert p.area[: p.front].sum() == pytest.approx(g.areas.sum(), rel=1e-12)
        assert len(np.unique(p.key, axis=0)) == p.front == p.element_patch.max() + 1
        assert (np.bincount(p.element_patch, minlength=p.front) > 0).all()
        assert sorted(p.order.tolist()) == list(range(len(p.element_triangle)))
        np.testing.assert_array_equal(p.element_patch[p.order], np.repeat(np.arange(p.front), np.diff(p.start)))
        element = np.arange(len(p.element_triangle))
        uv = points_in_elements(p.cuts, p.first_element, p.element_triangle, element, np.full((len(element), 2), 0.3))
        found = element_of(p.cuts, p.first_element, p.element_triangle, uv[:, 0], uv[:, 1])
        np.testing.assert_array_equal(found, element)
        centre = np.full((len(element), 2), 1 / 3)
        place = points_on_triangles(g, p.element_triangle, points_in_elements(
            p.cuts, p.first_element, p.element_triangle, element, centre))  # fmt: skip
        key = p.key[p.element_patch]
        cell = (place - g.lower) / size * 2.0 ** key[:, :1]
        assert (np.abs(cell - key[:, 3:] - 0.5) <= 0.5 + 1e-4).all(), name


def test_pieces_know_their_parents() -> None:
    """Every piece of a trial lies in the place of its parent, and every cut patch has pieces, about four."""
    s = contact()
    g = build_geometry(s)
    p = build_patches(s, g, SIZE)
    trial = build_patches(s, g, SIZE, [p.key])
    parent = _parents(p, trial, 0)
    known = parent >= 0
    assert known.mean() > 0.98
    np.testing.assert_array_equal(trial.key[known, 3:] // 2, p.key[parent[known], 3:])
    np.testing.assert_array_equal(trial.key[known, 1:3], p.key[parent[known], 1:3])
    pieces = np.bincount(parent[known], minlength=p.front)
    assert np.median(pieces) == 4 and pieces.max() <= 8 and (pieces > 0).all()
    area = np.bincount(parent[known], trial.area[: trial.front][known], p.front)
    np.testing.assert_allclose(area.sum(), p.area[: p.front].sum(), rtol=0.02)


SLOPE = 0.5  # of a shadow line that crosses patches at every place: it can lie on no lattice of them by luck


def floor_error(s: Scene, g: Geometry, p: Patches) -> float:
    """Root mean square over 50,000 points of the floor of what their patch says less the sun or no sun there is."""
    light = direct_on_patches(s, g, p, 64, 5, silent).mean(axis=1)
    floor = np.flatnonzero(g.mesh == 0)
    rng = np.random.default_rng(3)
    triangle = floor[rng.integers(len(floor), size=50_000)]
    uv = rng.random((50_000, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    x = points_on_triangles(g, triangle, uv)
    exact = x[:, 0] > LINE + SLOPE * (x[:, 2] - 2.0)
    patch = p.element_patch[element_of(p.cuts, p.first_element, triangle, uv[:, 0], uv[:, 1])]
    return float(np.sqrt(((light[patch] - exact) ** 2).mean()))


def test_the_error_falls_more_per_patch_than_by_cutting_everywhere() -> None:
    """Irradiance on the floor against the exact step: the cut patches beat uniform ones of twice their number. Errors over
    30 seeds: 0.602 ± 0.015 (sd) of the uniform ones', theirs 0.589 ± 0.008 of the coarse ones'."""
    s = shadow_line(SLOPE)
    g, p = cut(s, 0.2)
    fine = SIZE
    while len(on_floor(build_patches(s, g, fine))) < 2 * len(on_floor(p)):
        fine *= 0.9
    uniform, coarse = build_patches(s, g, fine), build_patches(s, g, SIZE)
    errors = [floor_error(s, g, q) for q in (coarse, uniform, p)]
    assert errors[2] < 0.75 * errors[1] < 0.75 * errors[0], (errors, len(on_floor(uniform)), len(on_floor(p)))


def test_a_smaller_tolerance_cuts_more() -> None:
    """With one seed for all. Of 30 patches 100 and then 430 are made, ± 16 over seeds."""
    found = [cut(contact(), tolerance, size=2.0 * SIZE)[1] for tolerance in (10.0, 0.06, 0.02)]
    assert found[0].count < found[1].count < found[2].count
    assert not found[0].key[:, 0].any()


def test_a_bake_cuts_where_its_settings_ask_for_it() -> None:
    """radiosity.patch_error, and its absence; rows of the cut patches keep both laws."""
    plain = bake_surfaces(shadow_line(patch_size=SIZE, rays=128), 1)
    fine = bake_surfaces(shadow_line(patch_size=SIZE, rays=128, patch_error=0.2), 1)
    assert not plain.patches.key[:, 0].any() and fine.patches.key[:, 0].max() == LEVELS
    assert fine.patches.count < 4 * plain.patches.count
    assert fine.laws.closure <= 1e-6 and fine.laws.reciprocity <= 1e-6
