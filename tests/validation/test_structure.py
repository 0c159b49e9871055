"""Metrics of the structure itself: sound textures read 0, planted faults of each kind read what was planted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.fastpath.device import open_device
from lightgauge.fastpath.sampler import Sampler
from lightgauge.reference.datatypes import F64
from lightgauge.reference.lattice import OCTANTS, Octree, keys
from lightgauge.reference.texture_types import WEIGHT, Samples, VirtualTexture
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.visibility import build_geometry
from lightgauge.reference.volume.layout import TileLayout
from lightgauge.reference.volume.sampler import interpolate, locate, sample
from lightgauge.validation.metrics.coarse import PLACES, finest_holding, measure_coarse, places_on
from lightgauge.validation.metrics.dead_voxels import dead_voxels, measure_dead_voxels
from lightgauge.validation.metrics.error import Measured
from lightgauge.validation.metrics.pointers import measure_pointers
from small_scenes import box, quad, random_probes, random_tree, scene, texture_of, tree_of


def world(invalid: float, seed: int = 3) -> tuple[VirtualTexture, TileLayout]:
    tree = random_tree(4, 0.45, seed)
    return texture_of(tree, random_probes(len(tree.corners), invalid, seed))


def with_texels(texture: VirtualTexture, texels: np.ndarray) -> VirtualTexture:
    return dataclasses.replace(texture, indirection=dataclasses.replace(texture.indirection, texels=texels))


def test_the_indirection_points_where_it_should_and_each_wrong_bit_is_seen() -> None:
    texture, layout = world(0.0)
    found = measure_pointers(texture, layout, 0)["wrong_pointers"]
    assert found.value == 0.0 and found.n == 4 * 4000
    i = texture.indirection
    x, y, z, level = (i.texels >> shift & 255 for shift in (0, 8, 16, 24))
    swapped = x | z << 8 | y << 16 | level << 24
    above = x | y << 8 | z << 16 | np.maximum(level, 2) - 1 << 24
    beyond = np.full_like(x, i.cache[0]) | y << 8 | z << 16 | level << 24
    lost = i.texels.copy()
    last = lost[i.first[3] :].reshape(i.dims[3])
    last[-1] = last[-2]  # the last row of the finest level of detail
    for texels, least in ((swapped, 0.1), (above, 0.1), (beyond, 1.0), (lost, 0.01)):
        assert measure_pointers(with_texels(texture, texels), layout, 0)["wrong_pointers"].value >= least


def by_hand(texture: VirtualTexture) -> set[tuple[int, ...]]:
    """Cells of the finest lattice whose own tile's voxel, of level 2 or finer, has no weight anywhere: in eight inner places each."""
    n = int(texture.extent[0])
    cell = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float64)
    dead = np.ones(len(cell), dtype=np.bool_)
    for corner in OCTANTS:
        q = cell + 0.01 + 0.98 * corner
        slot, level = locate(texture, q, np.full(len(q), texture.level))
        dead &= (interpolate(texture, q, q, slot, level)[:, WEIGHT] == 0.0) & (level >= 2)
    return set(map(tuple, cell[dead].astype(int).tolist()))


def test_dead_voxels_are_those_without_any_weight() -> None:
    """A coarse voxel may have weight in one half alone: then its cells in the other differ from it, so only whole voxels count."""
    texture, layout = world(0.8)
    corner, level = dead_voxels(texture, layout)
    assert len(corner) > 20
    size = 1 << (texture.level - level)
    cells = {tuple((c + o).tolist()) for c, s in zip(corner, size, strict=True) for o in np.ndindex(s, s, s)}
    assert cells <= by_hand(texture)
    finest = {c for c in by_hand(texture) if locate(texture, np.array([c]) + 0.5, np.array([4]))[1][0] == 4}
    assert finest == {tuple(c.tolist()) for c in corner[level == 4]}


def dead(texture: VirtualTexture, layout: TileLayout, kernel: object) -> dict[str, Measured]:
    return measure_dead_voxels(texture, layout, kernel, "linear", 1.0, 5)  # type: ignore[arg-type]


def test_what_answers_dead_voxels_wrongly_is_seen() -> None:
    texture, layout = world(0.8)

    def plain(where: F64, normals: F64) -> Samples:
        return sample(texture, where, normals)

    def spoilt(where: F64, normals: F64) -> Samples:
        found = plain(where, normals)
        return dataclasses.replace(found, irradiance=np.full_like(found.irradiance, np.nan))

    def dark(where: F64, normals: F64) -> Samples:
        found = plain(where, normals)
        return dataclasses.replace(found, irradiance=np.zeros_like(found.irradiance))

    def brighter(where: F64, normals: F64) -> Samples:
        found = plain(where, normals)
        return dataclasses.replace(found, irradiance=found.irradiance * np.float32(1.01))

    good, nan, black, more = (dead(texture, layout, k) for k in (plain, spoilt, dark, brighter))
    assert good["dead_voxel_deviation"].value == good["dead_voxel_lost"].value == 0.0
    assert nan["dead_voxel_deviation"].value == nan["dead_voxel_lost"].value == 1.0
    assert black["dead_voxel_lost"].value > 0.2 and black["dead_voxel_deviation"].value > 0.1
    assert 1e-3 < more["dead_voxel_deviation"].value < 0.01 and more["dead_voxel_lost"].value == 0.0
    assert dead(*world(0.0), plain) == {}


def test_the_kernel_asks_the_level_above() -> None:
    texture, layout = world(0.8)
    found = dead(texture, layout, Sampler(open_device(), texture, "float32", "packed"))
    assert found["dead_voxel_deviation"].value < 1e-5 and found["dead_voxel_lost"].value == 0.0


def full(levels: int) -> list[np.ndarray]:
    return [np.stack(np.meshgrid(*[np.arange(1 << n)] * 3, indexing="ij"), -1).reshape(-1, 3) for n in range(levels)]


def shares(tree: Octree, wanted: Octree, placed: Octree | None, touched: int, places: F64) -> tuple[float, float]:
    levels = [[keys(v) for v in t.voxels] if t else [] for t in (tree, wanted, placed)]
    found = measure_coarse(tree.grid, *levels, touched, places)
    return found["coarse_share"].value, found["unmet_share"].value


def test_coarse_shares_are_those_of_what_is_missing() -> None:
    """4 × 4 × 4 m in voxels of 1 m are asked for; the octree lacks its half with x ≥ 2 at the finest level."""
    every = full(3)
    half = tree_of([*every[:2], every[2][every[2][:, 0] < 2]])
    wanted = tree_of(every)
    places = np.random.default_rng(0).random((4000, 3)) * 4.0
    there = float((places[:, 0] >= 2.0).mean())
    assert shares(wanted, wanted, None, 2, places) == (0.0, 0.0)
    assert shares(half, wanted, None, 2, places) == (there, there)
    assert shares(half, wanted, None, 1, places) == (there, 0.0)  # nothing is promised at the finest level
    assert shares(half, half, wanted, 0, places) == (0.0, there)  # a file places what nobody else asks for
    some = np.array([[-0.5, 1, 1], [1, 1, 1], [3, 1, 1]])
    assert finest_holding(half.grid, [keys(v) for v in half.voxels], some).tolist() == [0, 2, 1]
    assert measure_coarse(half.grid, [], [], [], 0, places[:0]) == {}


def test_places_are_uniform_over_lit_surfaces() -> None:
    ensure_variant()
    lit = quad([(0, 0, 0), (0, 0, 3), (1, 0, 3), (1, 0, 0)], name="lit")
    other = box((5, 5, 5), (9, 9, 9), name="other")
    g = build_geometry(scene([lit, other]))
    places = places_on(g, np.array([True, False]), 1)
    assert places.shape == (PLACES, 3) and (places[:, 1] == 0.0).all()
    assert places[:, [0, 2]].mean(axis=0) == pytest.approx([0.5, 1.5], abs=0.04)
    assert places[:, [0, 2]].std(axis=0) == pytest.approx([0.2887, 0.866], rel=0.03)
    assert not (places == places_on(g, np.array([True, False]), 2)).all()
    assert places_on(g, np.array([False, False]), 1).shape == (0, 3)
