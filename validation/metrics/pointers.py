"""Whether the indirection texture points to the tile that it should, for places and levels of detail at random.

    wrong_pointers = share of places and levels of detail whose texel names another slot or level than the finest tile there

The finest tile is looked for among the tiles themselves, by the voxels that they cover, and the texel is taken apart bit by bit as the
format says: 8 bits of tile offset per axis, x lowest, then 8 bits of level. A texel that names a slot outside of the cache is a
wrong one, too; whoever follows it reads what is not there, so this is asked before anything is sampled.
"""

from __future__ import annotations

import numpy as np

from ...reference.datatypes import F64, I64
from ...reference.lattice import index_of, keys
from ...reference.texture_types import VirtualTexture
from ...reference.volume.layout import TileLayout
from .error import Measured

PLACES = 4000
AXES = np.array([0, 8, 16])  # where the offset's bits begin in a texel


def measure_pointers(texture: VirtualTexture, layout: TileLayout, seed: int) -> dict[str, Measured]:
    """wrong_pointers of the texture of `layout`, PLACES for each level of detail."""
    places = np.random.default_rng([seed, 59]).random((PLACES, 3)) * texture.extent  # finest voxels
    wrong, n = 0, 0
    for lod in range(1, texture.level + 1):
        slot, level = _said(texture, places, lod)
        right_slot, right_level = _finest_tile(texture, layout, places, lod)
        wrong += int(((slot != right_slot) | (level != right_level)).sum())
        n += PLACES
    return {"wrong_pointers": Measured(wrong / n, 0.0, n)}


def _said(texture: VirtualTexture, places: F64, lod: int) -> tuple[I64, I64]:
    """Slot (N,) and level (N,) that the indirection texels name at `places` (N, 3), finest voxels; slot -1 for an offset that the cache
    does not have."""
    i = texture.indirection
    texels = i.texels[i.first[lod - 1] : i.first[lod]].reshape(i.dims[lod - 1])
    found = texels[tuple(_cells(texture, places, lod).T)].astype(np.int64)
    offset = found[:, None] >> AXES & 255
    slot = offset @ np.array([1, i.cache[0], i.cache[0] * i.cache[1]])
    return np.where((offset < i.cache).all(axis=1), slot, -1), found >> 24


def _finest_tile(texture: VirtualTexture, layout: TileLayout, places: F64, lod: int) -> tuple[I64, I64]:
    """Slot (N,) and level (N,) of the finest tile of level `lod` or coarser over each place; 0 and 0 where there is none."""
    slot, found = np.zeros(len(places), dtype=np.int64), np.zeros(len(places), dtype=np.int64)
    for level in range(1, lod + 1):
        number = index_of(keys(layout.parents[level - 1]), keys(_cells(texture, places, level)))
        slot[number >= 0] = layout.first_slot[level - 1] + number[number >= 0]
        found[number >= 0] = level
    return slot, found


def _cells(texture: VirtualTexture, places: F64, level: int) -> I64:
    """The voxel (N, 3) of the level above, which a tile of `level` covers, at each place."""
    return np.floor(places / 2.0 ** (texture.level - level + 1)).astype(np.int64)
