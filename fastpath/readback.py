"""The texels of a tile cache as the device holds them, back on the host: what a check of the cache itself reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32
from .device import OpenDevice, pyopencl_module
from .layout import BAND2, LIGHT_TYPE, PACKED_SIZE, TEXELS, WEIGHT_STEPS, WEIGHT_TYPE
from .tile_cache import TileCache

COEFFICIENTS = 13  # of order 1, and the weight


def held_texels(device: OpenDevice, cache: TileCache, slots: npt.NDArray[np.integer]) -> F32:
    """Texels (n, 27, 13 or 28) f32 in `slots` (n,), in the order of `VirtualTexture.texels`: light in W·m⁻²·sr⁻¹, times the weight."""
    found = _images(device, cache) if cache.layout == "images" else _packed(device, cache)
    chosen = found[np.asarray(slots)].astype(np.float32)
    if cache.storage != "float32":
        chosen[..., : COEFFICIENTS - 1] *= np.float32(cache.exposure)
        chosen[..., COEFFICIENTS:] *= np.float32(cache.exposure)
    return chosen


def _packed(device: OpenDevice, cache: TileCache) -> npt.NDArray[np.floating]:
    kind = np.dtype(LIGHT_TYPE[cache.storage])
    parts = []
    for buffer, count in zip(cache.textures, (COEFFICIENTS, BAND2), strict=False):
        host = np.empty(buffer.size // kind.itemsize, kind)
        pyopencl_module().enqueue_copy(device.queue, host, buffer)
        parts.append(host.reshape(-1, TEXELS, PACKED_SIZE)[..., :count])
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)


def _images(device: OpenDevice, cache: TileCache) -> npt.NDArray[np.floating]:
    x, y, z = (int(n) for n in cache.shape)
    volumes = []
    for image, channels in zip(cache.textures[:4], (4, 4, 4, 1), strict=True):
        weights = channels == 1
        kind: Any = WEIGHT_TYPE[cache.storage] if weights else LIGHT_TYPE[cache.storage]
        host = np.empty((3 * z, 3 * y, 3 * x, 4), kind)
        pyopencl_module().enqueue_copy(device.queue, host, image, origin=(0, 0, 0), region=(3 * x, 3 * y, 3 * z))
        values = host[..., :channels].astype(np.float32)
        volumes.append(values / np.float32(WEIGHT_STEPS[cache.storage]) if weights else values)
    whole = np.concatenate(volumes, axis=-1).reshape(z, 3, y, 3, x, 3, COEFFICIENTS)
    return whole.transpose(0, 2, 4, 5, 3, 1, 6).reshape(-1, TEXELS, COEFFICIENTS)
