"""Indirection texture: the octree flattened, one texture per level of detail (talk, "Indirection texture").

A texel of LOD l covers one voxel of level l - 1 (where a tile of level l could be) and points to the finest tile of
level l or coarser there. 32 bits: 8 bits of tile offset in the cache per axis (x lowest), then 8 bits of level.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import I64, U32
from ..errors import InputError
from ..texture_types import MAX_OFFSET, Indirection
from ..texture_types import cache_shape as of_tiles
from ..tiling import MAX_TILES, indirection_dims
from .layout import TileLayout


def cache_shape(tiles: int) -> I64:
    """Tiles per axis (3,) of a cache for `tiles` tiles, each within the texel's bit budget.

    Raises InputError above 256³ tiles.
    """
    if tiles > MAX_TILES:
        raise InputError(
            f"the tile cache needs {tiles} tiles, the 32-bit indirection texel addresses {MAX_TILES}; raise "
            "placement.min_voxel or the meshes' probe_size"
        )
    return of_tiles(tiles)


def slot_offset(slot: I64, cache: I64) -> I64:
    """Tile offset (N, 3) in the cache of slot numbers (N,): x fastest."""
    return np.stack([slot % cache[0], slot // cache[0] % cache[1], slot // (cache[0] * cache[1])], axis=-1)


def pack(offset: I64, level: int) -> U32:
    """Texels (N,) from tile offsets (N, 3) and level.

    Raises ValueError if an offset or the level needs more than 8 bits (failure-catalogue E6).
    """
    if offset.size and (offset.min() < 0 or offset.max() >= MAX_OFFSET):
        raise ValueError(f"tile offset must be 0 … {MAX_OFFSET - 1}, got {int(offset.max())}")
    if not 0 <= level < 256:
        raise ValueError(f"level must be 0 … 255, got {level}")
    o = offset.astype(np.uint32)
    return np.asarray(o[:, 0] | (o[:, 1] << 8) | (o[:, 2] << 16) | np.uint32(level << 24), dtype=np.uint32)


def build_indirection(layout: TileLayout) -> Indirection:
    """Flatten the tiles, coarse to fine."""
    cache, dims = cache_shape(layout.tiles), indirection_dims(layout.grid)
    lods: list[U32] = []
    below = np.zeros((1, 1, 1), dtype=np.uint32)
    for i, (parents, size) in enumerate(zip(layout.parents, dims, strict=True)):
        if i:
            below = below.repeat(2, 0).repeat(2, 1).repeat(2, 2)[: size[0], : size[1], : size[2]].copy()
        slots = np.arange(layout.first_slot[i], layout.first_slot[i + 1])
        below[tuple(parents.T)] = pack(slot_offset(slots, cache), i + 1)
        lods.append(below.ravel())
    first = np.concatenate([[0], np.cumsum([len(t) for t in lods])]).astype(np.int64)
    return Indirection(np.concatenate(lods), first, dims, cache)
