"""The octree as a 3D virtual texture: tiles of 3×3×3 texels, virtual voxels and probes (talk, "Octree as a virtual texture").

A tile of level l covers one voxel of level l - 1, cut into 2×2×2 voxels of level l. Tiles exist for the parents of all
existing voxels and of their 26 neighbours; filling whole tiles adds the remaining virtual voxels. Then every voxel of
level l has, on all sides, either neighbours of its own level or virtual ones that interpolate level l - 1: no seams
(failure-catalogue D1, D2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import I32, I64
from ..lattice import NEIGHBOURS, Grid, Octree, cells, index_of, keys

TEXELS = 27
# Position of texel t within its tile, (27, 3), x slowest; octants in the same order.
TEXEL_OFFSETS = np.array([(x, y, z) for x in range(3) for y in range(3) for z in range(3)], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class TileLayout:
    """Which tiles there are and where their texels' values come from. Level arrays start with level 1.

    parents: per level l = 1 … L, (T_l, 3) i64 voxels of level l - 1 that a tile covers, sorted by key.
    probe: per level (T_l, 27) i32, real probe of a texel or -1. parent_tile: per level (T_l,) i32, tile of level l - 1
    that holds the covered voxel, -1 for level 1; octant (T_l,) i32, which of its voxels.
    first_slot (L + 1,) i64: slots of the tile cache are numbered level by level.
    virtual_probes, virtual_by_level: distinct virtual positions.
    """

    grid: Grid
    parents: tuple[I64, ...]
    probe: tuple[I32, ...]
    parent_tile: tuple[I32, ...]
    octant: tuple[I32, ...]
    first_slot: I64
    virtual_by_level: I64

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return int(self.first_slot[-1])

    @property
    def virtual_probes(self) -> int:
        """Number of distinct virtual probes over all levels."""
        return int(self.virtual_by_level.sum())


def build_layout(tree: Octree) -> TileLayout:
    """Tiles, virtual voxels and texel sources for an octree."""
    parents = [_tile_parents(tree, level) for level in range(1, tree.grid.level + 1)]
    probe_keys = keys(tree.corners)
    probe, parent_tile, octant, virtual = [], [], [], []
    for i, p in enumerate(parents):
        level = i + 1
        corner = (2 * p[:, None, :] + TEXEL_OFFSETS[None]) << (tree.grid.level - level)
        corner_keys = keys(corner.reshape(-1, 3))
        at = index_of(probe_keys, corner_keys)
        probe.append(at.reshape(-1, TEXELS).astype(np.int32))
        virtual.append(len(np.unique(corner_keys[at < 0])))
        holder = index_of(keys(parents[i - 1]), keys(p >> 1)) if i else np.full(len(p), -1)
        if i and (holder < 0).any():
            raise AssertionError(f"level {level}: a tile has no parent tile one level up (level jump over 1)")
        parent_tile.append(holder.astype(np.int32))
        octant.append(((p & 1) @ np.array([4, 2, 1])).astype(np.int32))
    first = np.concatenate([[0], np.cumsum([len(p) for p in parents])]).astype(np.int64)
    return TileLayout(
        tree.grid,
        tuple(parents),
        tuple(probe),
        tuple(parent_tile),
        tuple(octant),
        first,
        np.array(virtual, dtype=np.int64),
    )


def _tile_parents(tree: Octree, level: int) -> I64:
    """Voxels of level - 1 whose children include an existing voxel of `level` or one of its 26 neighbours."""
    if level == 1:
        return np.zeros((1, 3), dtype=np.int64)
    v = tree.voxels[level]
    around = (v[:, None, :] + NEIGHBOURS[None]).reshape(-1, 3)
    limit = (1 << level) - 1
    around = around[((around >= 0) & (around <= limit)).all(axis=1)]
    return cells(np.unique(keys(around >> 1)))
