"""The virtual texture as a device holds it: three RGBA textures and a weight texture in tile-cache order, the
indirection texels, and a table of its levels of detail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32, I32, VirtualTexture, pre_exposure, weight_ratio

Storage = Literal["float32", "half16", "half8"]
WEIGHT_STEPS: dict[Storage, int] = {"float32": 1, "half16": 65535, "half8": 255}
LIGHT_TYPE: dict[Storage, type[np.floating]] = {"float32": np.float32, "half16": np.float16, "half8": np.float16}
WEIGHT_TYPE: dict[Storage, type[np.generic]] = {"float32": np.float32, "half16": np.uint16, "half8": np.uint8}


@dataclass(frozen=True, eq=False)
class CacheTextures:
    """light (3, Z, Y, X, 4): red, green and blue SH; weight (Z, Y, X); X = 3 × tiles along x, and so on, x fastest."""

    light: npt.NDArray[np.floating]
    weight: npt.NDArray[np.generic]

    @property
    def bytes(self) -> int:
        """Size of the cache."""
        return self.light.nbytes + self.weight.nbytes


def cache_textures(texture: VirtualTexture, storage: Storage) -> CacheTextures:
    """Put the tiles (T, 27, 13) into cache order."""
    cx, cy, cz = (int(n) for n in texture.indirection.cache)
    slots = np.zeros((cx * cy * cz, 27, 13), dtype=np.float32)
    slots[: len(texture.texels)] = texture.texels
    # slot = x + cx (y + cy z) over tiles; a tile's texels are x slowest
    grid = slots.reshape(cz, cy, cx, 3, 3, 3, 13).transpose(0, 5, 1, 4, 2, 3, 6).reshape(3 * cz, 3 * cy, 3 * cx, 13)
    light = np.stack([grid[..., 4 * c : 4 * c + 4] for c in range(3)])
    weight = grid[..., 12]
    if storage != "float32":
        steps = np.float32(WEIGHT_STEPS[storage])
        exact, weight = weight, np.round(weight * steps)
        light = light * weight_ratio((weight / steps).astype(np.float32), exact)[..., None]
    light = (light / np.float32(exposure(texture, storage))).astype(LIGHT_TYPE[storage])
    return CacheTextures(np.ascontiguousarray(light), np.ascontiguousarray(weight.astype(WEIGHT_TYPE[storage])))


def exposure(texture: VirtualTexture, storage: Storage) -> float:
    """What stored light is to be multiplied by: see `pre_exposure`; 1 for float32."""
    return 1.0 if storage == "float32" else pre_exposure(texture.texels)


def lod_table(texture: VirtualTexture) -> I32:
    """Per LOD the first indirection texel and the dimensions, (L, 4) i32."""
    i = texture.indirection
    return np.column_stack([i.first[:-1], i.dims]).astype(np.int32)


def grid_words(texture: VirtualTexture, storage: Storage) -> bytes:
    """The kernel's `Grid` structure: float4 origin and 1/h, float4 extent and exposure, int4 cache and level."""
    inverse = np.float32(1.0 / texture.finest)
    floats: F32 = np.array([*texture.origin, inverse, *texture.extent, exposure(texture, storage)], dtype=np.float32)
    ints: I32 = np.array([*texture.indirection.cache, texture.level], dtype=np.int32)
    return floats.tobytes() + ints.tobytes()
