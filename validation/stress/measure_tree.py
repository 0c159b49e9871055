"""Virtual voxels, chains of virtual probes, weights and invalid probes, without light transport (failure-catalogue D1 … D5)."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from unittest import mock

import numpy as np

from ...reference.datatypes import F32, F64, I32, I64
from ...reference.lattice import Grid, Octree, cells, keys
from ...reference.texture_types import WEIGHT, Samples, Storage, VirtualTexture
from ...reference.volume import layout
from ...reference.volume.sampler import resolve
from ..metrics.seams import SeamPoints, measure_seams, seam_points
from .case import Reading
from .kernel_reads import both_sides, kernel_off, kernel_samples, mean_light
from .texture_worlds import units
from .trees import (
    Filled,
    every_cell,
    facing,
    filled,
    lone_branch,
    longest_chain,
    masks_tree,
    random_probes,
    random_tree,
    tree_of,
)

RINGS = {0: 0, 6: 1, 18: 2, 26: 3}
LOOKS = 30_000
GRID_LEVEL = 5


def _seams(texture: VirtualTexture, points: SeamPoints, suffix: str = "") -> dict[str, Reading]:
    """sup and area (share of border points with a jump over 1 %, with its binomial error)."""
    found = measure_seams(texture, points)
    area, n = found["seam_area"].value, found["seam_area"].n
    return {
        f"sup{suffix}": Reading(found["seam_sup"].value, 0.0, n),
        f"area{suffix}": Reading(area, math.sqrt(area * (1.0 - area) / n), n),
    }


def _parents_of_ring(ring: int, grid: Grid, level: int, voxels: I64) -> I64:
    """What `tiling.tile_parents` gives for all 26 neighbours, for those of `ring` only."""
    around = (cells(voxels)[:, None, :] + facing(ring)[None]).reshape(-1, 3)
    inside = ((around >= 0) & (around <= grid.last(level))).all(axis=1)
    return np.unique(keys(around[inside] >> 1))


@functools.cache
def _masks() -> Octree:
    return masks_tree()


def neighbours(sides: float, seed: int) -> Mapping[str, Reading]:
    """D1: seams at faces, edges and corners round voxels with each of the 256 sets of children, all probes valid, where virtual
    voxels surround each voxel on 0, 6, 18 or 26 sides; `ours`: as the product lays tiles, read at 26."""
    rng = np.random.default_rng([seed, 111])
    tree, ring = _masks(), RINGS[round(sides)]
    probes = random_probes(len(tree.corners), 0.0, rng)
    ours = filled(tree, probes)
    points = seam_points(ours.texture, _near_leaves(tree), seed)
    if ring == 3:
        found = _seams(ours.texture, points)
        read = kernel_off(ours.texture, both_sides(ours.texture, points.q, seed), seed)
        return {"ours_sup": found["sup"], "ours_area": found["area"], **read}
    with mock.patch.object(layout, "tile_parents", functools.partial(_parents_of_ring, ring)):
        fewer = filled(tree, probes, layout.build_layout(tree))
    found = _seams(fewer.texture, points)
    return {"fewer_sup": found["sup"], "fewer_area": found["area"]}


def _near_leaves(tree: Octree) -> F32:
    """Middles of the voxels of the two finest levels, in finest voxels."""
    top = tree.grid.level
    middles = [(tree.voxels[level] + 0.5) * (1 << (top - level)) for level in (top - 1, top)]
    return np.concatenate(middles).astype(np.float32)


def chains(depth: float, seed: int) -> Mapping[str, Reading]:
    """D2: a branch of single voxels beside a voxel `depth` - 1 levels coarser: seam; orphans: virtual texels that do not hang on a
    tile one level up that is filled before; chain: the longest. refused: 1 if a tree that leaves a level out is refused."""
    count = round(depth)
    rng = np.random.default_rng([seed, 112])
    tree = lone_branch(count)
    made = filled(tree, random_probes(len(tree.corners), 0.0, rng))
    home = tree.voxels[-1].astype(np.float64) + 0.5
    points = seam_points(made.texture, home, seed)
    found = _seams(made.texture, points) | kernel_off(made.texture, both_sides(made.texture, points.q, seed), seed)
    gap = [*tree.voxels[:-1], np.zeros((0, 3), dtype=np.int64), 4 * tree.voxels[-2]]
    try:
        layout.build_layout(tree_of(gap))
        refused = 0.0
    except AssertionError:
        refused = 1.0
    return {
        **{name: found[name] for name in ("sup", "kernel") if name in found},
        "orphans": Reading(float(_orphans(made)), 0.0, made.layout.tiles * layout.TEXELS),
        "chain": Reading(float(longest_chain(made.layout)), 0.0, made.layout.tiles),
        "refused": Reading(refused),
    }


def _orphans(made: Filled) -> int:
    """Virtual texels whose tile's parent is not the voxel one level up, or is filled later."""
    tiles, wrong = made.layout, 0
    for i in range(1, len(tiles.parents)):
        virtual = (tiles.probe[i] < 0).sum(axis=1)
        parent = tiles.parent_tile[i]
        holds = (tiles.parents[i - 1][parent] == tiles.parents[i] >> 1).all(axis=1)
        early = tiles.first_slot[i - 1] + parent < tiles.first_slot[i]
        wrong += int(virtual[~(holds & early & (parent >= 0))].sum())
    return wrong


def premultiplied(invalid: float, seed: int) -> Mapping[str, Reading]:
    """D3: seams with a share of invalid probes; `ours`, and `divided`: mixed texels hold light already divided by its weight."""
    rng = np.random.default_rng([seed, 113])
    tree = random_tree(6, 0.4, rng)
    made = filled(tree, random_probes(len(tree.corners), invalid, rng))
    points = seam_points(made.texture, None, seed)
    texels = made.texture.texels.copy()
    mixed = (np.concatenate(made.layout.probe) < 0) & (texels[..., WEIGHT] > 0.0)
    texels[mixed] /= texels[mixed][:, WEIGHT:]
    read = kernel_off(made.texture, both_sides(made.texture, points.q, seed), seed)
    return {**_seams(made.texture, points, "_ours"), **_seams(made.holding(texels), points, "_divided"), **read}


def weights(depth: float, seed: int) -> Mapping[str, Reading]:
    """D4: virtual voxels that hang on each other `depth` times. By storage (`half`, `half16`, `half8`, and `bare8`: weights of 8
    bits beside light that was stored with the exact ones): seam_…: its 99th percentile where one probe of eight is valid; lost_…:
    share of places that find light only at a coarser level than with exact weights, or none, where each voxel has one corner with
    any weight: 8^-`depth` at the end, by the plain sampler or the kernel. kernel: the largest of the three storages."""
    rng = np.random.default_rng([seed, 114])
    count = round(depth)
    mixed, last = _one_of_eight(count, rng), _one_corner(count, rng)
    points = seam_points(mixed.texture, mixed.tree.voxels[-1].astype(np.float64) + 0.5, seed)
    top = last.tree.grid.level
    places = 0.5 * float(1 << top) + 2.0 ** rng.uniform(0.0, top - 1.0, (LOOKS, 1)) * rng.random((LOOKS, 3))
    level = resolve(last.texture, places, places, top)[2]
    found, off = {}, []
    for name in ("half", "half16", "half8", "bare8"):
        kept = _kept(mixed, name)
        found[f"seam_{name}"] = Reading(measure_seams(kept, points)["seam_p99"].value, 0.0, len(points.q))
        if name == "bare8":  # its weights are those of half8
            continue
        off.append(kernel_off(kept, both_sides(kept, points.q, seed), seed, _storage(name)))
        lost = float((_worst_level(_kept(last, name), places, _storage(name), seed) < level).mean())
        found[f"lost_{name}"] = Reading(lost, math.sqrt(lost * (1.0 - lost) / LOOKS), LOOKS)
    return {**found, **{name: max((one[name] for one in off), key=lambda r: r.value) for name in off[0]}}


def _worst_level(texture: VirtualTexture, places: F64, storage: Storage, seed: int) -> I32:
    """Level (N,) that answers at `places` (N, 3) finest voxels: the coarser of the plain sampler's and the kernel's."""
    plain = resolve(texture, places, places, texture.level)[2]
    at = texture.origin + places * texture.finest
    kernel = kernel_samples(texture, at, units(len(at), seed), storage)
    return plain if kernel is None else np.minimum(plain, kernel.level)


def _storage(name: str) -> Storage:
    return "half" if name == "half" else "half16" if name == "half16" else "half8"


def _one_of_eight(count: int, rng: np.random.Generator) -> Filled:
    """A branch of single voxels; of its probes every eighth is valid, and the root's own."""
    tree = lone_branch(count + 1)
    probes = random_probes(len(tree.corners), 0.0, rng)
    probes[(tree.corner_level > 0) & (np.arange(len(probes)) % 8 != 0)] = 0.0
    return filled(tree, probes)


def _one_corner(count: int, rng: np.random.Generator) -> Filled:
    """A branch towards the root's middle; on its other side virtual voxels alone, and the one valid probe: the root's last
    corner."""
    voxels = lone_branch(count + 1).voxels
    tree = tree_of([voxels[0], every_cell(1), *voxels[2:]])
    probes = random_probes(len(tree.corners), 0.0, rng)
    probes[:-1] = 0.0
    return filled(tree, probes)


def _kept(made: Filled, name: str) -> VirtualTexture:
    """The texture in one of the storages of `weights`."""
    if name == "bare8":
        texels = made.texture.texels.copy()
        texels[..., WEIGHT] = np.round(texels[..., WEIGHT] * 255.0) / 255.0
        return made.holding(texels)
    return made.stored(_storage(name))


def all_invalid(invalid: float, seed: int) -> Mapping[str, Reading]:
    """D5: a uniform grid of 32³ voxels, light 1, a share of its probes invalid. nan: answers that are not finite; off: largest
    error where something answers; fell: share of places that the finest level does not answer; dark: none does. Each the worst of the
    plain sampler's and the kernel's."""
    rng = np.random.default_rng([seed, 115])
    tree = tree_of([every_cell(level) for level in range(GRID_LEVEL + 1)])
    probes = np.ones((len(tree.corners), 13), dtype=np.float32)
    probes[rng.random(len(probes)) < invalid] = 0.0
    texture = filled(tree, probes).texture
    places = rng.uniform(0.0, 1 << GRID_LEVEL, (LOOKS, 3))
    light, weight, level = resolve(texture, places, places, texture.level)
    lit = level > 0
    bad = int((~np.isfinite(light)).sum())
    found = [np.asarray(light[lit] / weight[lit][:, None], dtype=np.float64)]
    read = _even(texture, places, seed)
    if read is not None:
        found.append(mean_light(read.irradiance[read.level > 0]))
        bad += int((~np.isfinite(read.irradiance)).sum())
        level = np.minimum(level, read.level)
    fell, dark = float((level < texture.level).mean()), float((level == 0).mean())
    return {
        "nan": Reading(float(bad + sum(int((~np.isfinite(v)).sum()) for v in found)), 0.0, LOOKS),
        "off": Reading(max(float(np.abs(v - 1.0).max(initial=0.0)) for v in found), 0.0, int(lit.sum())),
        "fell": Reading(fell, math.sqrt(fell * (1.0 - fell) / LOOKS), LOOKS),
        "dark": Reading(dark, math.sqrt(dark * (1.0 - dark) / LOOKS), LOOKS),
    }


def _even(texture: VirtualTexture, places: F64, seed: int) -> Samples | None:
    """What the kernel reads where the same light comes from everywhere: of the texture without its order 1."""
    texels = texture.texels.copy()
    texels[..., [c for c in range(WEIGHT) if c % 4]] = 0.0
    even = dataclasses.replace(texture, texels=texels)
    return kernel_samples(even, texture.origin + places * texture.finest, units(len(places), seed))
