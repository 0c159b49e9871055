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
from ..lattice import Grid, Octree, cells, finer_keys, index_of, keys, parent_keys, steps, union
from ..tiling import tile_parents

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
    grid = tree.grid
    parents = [tile_parents(grid, level, keys(tree.voxels[level])) for level in range(1, grid.level + 1)]
    probe_keys = keys(tree.corners)
    probe, parent_tile, octant, virtual = [], [], [], []
    for i, p in enumerate(parents):
        sources, count = _texel_sources(grid, i + 1, p, probe_keys)
        probe.append(sources)
        virtual.append(count)
        holder = index_of(parents[i - 1], parent_keys(p)) if i else np.full(len(p), -1)
        if i and (holder < 0).any():
            raise AssertionError(f"level {i + 1}: a tile has no parent tile one level up (level jump over 1)")
        parent_tile.append(holder.astype(np.int32))
        octant.append(((cells(p) & 1) @ np.array([4, 2, 1])).astype(np.int32))
    first = np.concatenate([[0], np.cumsum([len(p) for p in parents])]).astype(np.int64)
    return TileLayout(
        grid,
        tuple(cells(p) for p in parents),
        tuple(probe),
        tuple(parent_tile),
        tuple(octant),
        first,
        np.array(virtual, dtype=np.int64),
    )


def _texel_sources(grid: Grid, level: int, parents: I64, probes: I64) -> tuple[I32, int]:
    """Real probe (T, 27) of each texel of the tiles over `parents`, keys (T,), or -1; and the number of distinct virtual probes.

    probes: sorted keys of the real ones. Texel by texel: the keys looked up then ascend, which is many times faster.
    """
    sources = np.empty((len(parents), TEXELS), dtype=np.int32)
    virtual = []
    first = finer_keys(parents, grid.level - level + 1)
    for texel, step in enumerate(steps(TEXEL_OFFSETS << (grid.level - level))):
        corner = first + step
        sources[:, texel] = index_of(probes, corner)
        virtual.append(corner[sources[:, texel] < 0])
    return sources, len(union(*virtual))
