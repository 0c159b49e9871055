"""Virtual textures in memory for the cases E1 … E8 and R4: octrees, probes with light, and the product's own texture over them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ...fastpath.device import OpenDevice, open_device
from ...reference.datatypes import F32, F64, Bool
from ...reference.lattice import Grid, Octree
from ...reference.placement.octree import uniform_octree
from ...reference.texture_types import Storage, TileTable, VirtualTexture
from ...reference.volume.indirection import build_indirection
from ...reference.volume.layout import TileLayout, build_layout
from ...reference.volume.table import tile_table
from ...reference.volume.tiles import fill_tiles, probe_texels

LIGHT_LOW, LIGHT_SPAN, DIRECTED = 0.5, 1.0, 0.25  # L00 of a random probe, and its L1 as a share of that


@dataclass(frozen=True, eq=False)
class World:
    """tree: where probes stand, R of them. light (R, 4, 3) f32 radiance SH; valid (R,) bool. layout, table, texture: the product's,
    in float32."""

    tree: Octree
    light: F32
    valid: Bool
    layout: TileLayout
    table: TileTable
    texture: VirtualTexture

    def texels(self, storage: Storage) -> F32:
        """Texels (tiles, 27, 13) as a cache in this storage holds them."""
        return fill_tiles(self.layout, probe_texels(self.light, self.valid), storage)


@cache
def device() -> OpenDevice:
    """The OpenCL device, opened once a process."""
    return open_device()


def uniform_tree(level: int) -> Octree:
    """2^level voxels of 1 m per axis from the origin on, all of them there."""
    return uniform_octree(Grid(np.zeros(3), 1.0, level, np.full(3, 1 << level, dtype=np.int64)))


def world(tree: Octree, light: F32, valid: Bool) -> World:
    """The texture of probes with this light."""
    layout, grid = build_layout(tree), tree.grid
    texels = fill_tiles(layout, probe_texels(light, valid))
    texture = VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, build_indirection(layout), texels)
    numbers = np.where(valid, np.arange(len(valid)), -1).astype(np.int32)
    return World(tree, light, valid, layout, tile_table(layout, numbers), texture)


def random_light(probes: int, seed: int) -> F32:
    """Radiance SH (probes, 4, 3): L00 uniform from LIGHT_LOW over LIGHT_SPAN, L1 within DIRECTED of it."""
    rng = np.random.default_rng([seed, 2])
    light = np.empty((probes, 4, 3))
    light[:, 0] = LIGHT_LOW + LIGHT_SPAN * rng.random((probes, 3))
    light[:, 1:] = DIRECTED * light[:, :1] * rng.uniform(-1.0, 1.0, (probes, 3, 3))
    return light.astype(np.float32)


def random_world(tree: Octree, invalid: float, seed: int) -> World:
    """Random light, of which a share `invalid` of the probes knows none."""
    probes = len(tree.corners)
    valid = np.random.default_rng([seed, 3]).random(probes) >= invalid
    return world(tree, random_light(probes, seed), valid)


def flat_light(values: F64 | F32) -> F32:
    """Light (R, 4, 3) that comes from everywhere alike, with coefficient L00 `values` (R,) in all colours."""
    light = np.zeros((len(values), 4, 3), dtype=np.float32)
    light[:, 0] = np.asarray(values, dtype=np.float32)[:, None]
    return light


def units(count: int, seed: int) -> F32:
    """Random unit vectors (count, 3) f32."""
    v = np.random.default_rng([seed, 4]).normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), dtype=np.float32)


def inside(w: World, count: int, seed: int) -> F64:
    """Random positions (count, 3) m in the texture."""
    edge = w.texture.extent * w.texture.finest
    return w.texture.origin + np.random.default_rng([seed, 5]).random((count, 3)) * edge
