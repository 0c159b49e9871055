"""Tiles of the virtual texture as far as placement and texture must agree on them: which there are, and how many there can be.

A tile of level l covers one voxel of level l - 1, cut into 2×2×2 voxels of level l. An indirection texel has 32 bits: 8 for
the tile's place in the cache along each axis, 8 for its level (talk, "Indirection texture").
"""

from __future__ import annotations

import numpy as np

from .datatypes import I64
from .lattice import OCTANTS, Grid, cells, distinct, keys, parent_keys, parities, steps
from .texture_types import MAX_OFFSET

OFFSET_BITS = 8
assert MAX_OFFSET == 1 << OFFSET_BITS
MAX_TILES = MAX_OFFSET**3
# 512 MiB over all levels of detail; the finest alone may be 512³ texels less an eighth.
MAX_INDIRECTION_TEXELS = 1 << 27


def indirection_dims(grid: Grid) -> I64:
    """Texels per axis of each level of detail 1 … L, (L, 3): the voxels of level l - 1 that the bounds reach."""
    return np.stack([grid.last(level - 1) + 1 for level in range(1, grid.level + 1)])


def tile_parents(grid: Grid, level: int, voxels: I64) -> I64:
    """Sorted keys (T,) of the voxels of level - 1 whose children include one of `voxels`, keys (N,) of `level`, or one of its 26
    neighbours: those that tiles of `level` must cover. What lies outside the bounds is left out: nothing points there."""
    if level == 1:
        return keys(np.zeros((1, 3), dtype=np.int64))
    above, odd = parent_keys(voxels), parities(voxels)
    # Along an axis a voxel's parent and the one it faces: the next if the voxel is the parent's second, else the one before.
    facing = [above + 2 * (odd & axes) - axes for axes in steps(OCTANTS)]
    found = distinct(np.concatenate(facing))
    c = cells(found)
    return found[((c >= 0) & (c <= grid.last(level - 1))).all(axis=1)]
