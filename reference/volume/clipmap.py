"""The plain streamed texture: which tile answers where only some are resident, and what a clipmap's texels must hold.

    LOD of a sample = lod_of_distance(d)                                talk, "Per-pixel LOD"
    answering tile  = finest resident tile of level ≤ LOD that holds the place

Slow and obvious, the specification of the device's clipmap. It knows no windows: those are an economy that must not show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

import numpy as np

from ..datatypes import F32, F64, I64, U32
from ..reconstruction import Reconstruction
from ..texture_types import Samples, TileTable, Viewer, VirtualTexture
from .indirection import pack, slot_offset
from .sampler import sample


def sample_resident(
    texture: VirtualTexture,
    resident: Collection[int],
    positions: F32 | F64,
    normals: F32 | F64,
    viewer: Viewer,
    anchor: F64 | None = None,
    reconstruction: Reconstruction = "linear",
) -> Samples:
    """What `viewer` gets at `positions` (N, 3) m where of `texture`, which holds all tiles, only those in the slots `resident`
    are there.

    Otherwise as `sample`. Raises ValueError as `resident_texture` does.
    """
    return sample(resident_texture(texture, resident), positions, normals, viewer, anchor, reconstruction)


def resident_texture(texture: VirtualTexture, resident: Collection[int]) -> VirtualTexture:
    """`texture` whose indirection points to tiles in the slots `resident` only: to the nearest ancestor in place of the others.

    Raises ValueError where the root is not resident: it has no ancestor.
    """
    i, there = texture.indirection, np.array(sorted(resident), dtype=np.int64)
    lods: list[U32] = []
    for lod, dims in enumerate(i.dims, start=1):
        texels = i.texels[i.first[lod - 1] : i.first[lod]].reshape(dims).astype(np.int64)
        slot = (texels & 255) + i.cache[0] * ((texels >> 8 & 255) + i.cache[1] * (texels >> 16 & 255))
        absent = ~np.isin(slot, there)
        if lod == 1 and absent.any():
            raise ValueError("the root tile must be resident")
        cell = np.stack(np.nonzero(absent))
        own = texels.astype(np.uint32)
        own[absent] = (
            lods[-1][tuple(cell >> 1)] if lod > 1 else 0
        )  # coarse to fine: the parent's texel is right already
        lods.append(own)
    flat = np.concatenate([own.ravel() for own in lods])
    return dataclasses.replace(texture, indirection=dataclasses.replace(i, texels=flat))


def window_texels(table: TileTable, slots: Mapping[int, int], cache: I64, first: I64, side: int) -> U32:
    """Texels (L, side, side, side) u32 of windows whose first cells are `first` (L, 3), built from nothing.

    slots: of each resident tile; cache (3,): tiles per axis. Texel (x mod side, y mod side, z mod side) is that of cell (x, y,
    z); 0 where no tile is. side: a power of two.
    """
    held: dict[tuple[int, ...], int] = {}
    for level in range(1, table.level + 1):
        tiles = [tile for tile in slots if table.tile_level[tile] == level]
        texels = pack(slot_offset(np.array([slots[tile] for tile in tiles], dtype=np.int64), cache), level)
        held |= {(level, *table.cell[tile].tolist()): int(texel) for tile, texel in zip(tiles, texels, strict=True)}
    out = np.zeros((table.level, side, side, side), dtype=np.uint32)
    for lod in range(1, table.level + 1):
        low = [int(c) for c in first[lod - 1]]
        for step in np.ndindex(side, side, side):
            x, y, z = (a + b for a, b in zip(low, step, strict=True))
            for up in range(lod):
                texel = held.get((lod - up, x >> up, y >> up, z >> up), 0)
                if texel:
                    break
            out[lod - 1, x % side, y % side, z % side] = texel
    return out
