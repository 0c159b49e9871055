"""Per-pixel sampling of a whole virtual texture on an OpenCL device: the host side of sampler.cl. Textures that are streamed around a
viewer are `streamed`'s."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..reference.datatypes import F64, I32
from ..reference.texture_types import Storage, Viewer, VirtualTexture
from .arrays import uploaded
from .device import OpenDevice
from .grid import Lattice
from .images import image_arguments, image_texel_bytes
from .launch import DeviceSamples, Launcher, Source
from .layout import CacheTextures, Layout, cache_textures, exposure
from .tile_cache import TileCache


class Sampler:
    """A virtual texture on a device. Build once, call often; `seconds` is the device time of the last call that waited."""

    def __init__(
        self,
        device: OpenDevice,
        texture: VirtualTexture,
        storage: Storage,
        layout: Layout = "split",
        reconstruction: str = "linear",
        filled: TileCache | None = None,
    ) -> None:
        """Upload `texture` in the given storage format and layout; with `filled`, a cache in that format that holds its tiles in its
        slots, only the indirection, and samples are what was filled there.

        Raises ValueError for a format that does not exist, or for reconstruction l2 of a texture without order 2, and
        EnvironmentLacks for a device that cannot hold the images.
        """
        channels = texture.texels.shape[2]
        if reconstruction == "l2" and channels != 28:
            raise ValueError(f"reconstruction 'l2' wants texels of 28 channels, got {channels}")
        self._launcher = Launcher(device, storage, layout, reconstruction)
        self._filled = filled
        if filled is not None:
            _check_filled(filled, texture, storage, layout, reconstruction == "l2")
        if filled is None:
            held = cache_textures(texture, storage, layout)
            if layout == "images" and held.weight is not None:
                textures = image_arguments(device, held.light, held.weight)
                size = held.weight.size * image_texel_bytes(storage)
            else:
                textures, size = _uploaded(device, held, reconstruction == "l2")
            divisor = exposure(texture, storage)
        else:
            textures, size, divisor = filled.textures, filled.bytes, filled.exposure
        i = texture.indirection
        self._lattice = Lattice(texture.origin, texture.finest, texture.level, texture.extent, i.cache)
        self._source = Source(textures, uploaded(device, i.texels), uploaded(device, lod_table(texture)), divisor)
        self.bytes = size + i.texels.nbytes

    @property
    def seconds(self) -> float:
        """Device time of the last call with NumPy arrays."""
        return self._launcher.seconds

    def __call__(
        self, positions: Any, normals: Any, lod: int | I32 | Viewer | None = None, anchor: F64 | None = None,
        out: DeviceSamples | None = None,
    ) -> Any:  # fmt: skip
        """`Samples` at `positions` (N, 3) m for unit `normals` (N, 3); lod, anchor and NaN as in reference/volume/sampler.py.

        Arrays on the device (pyopencl.array.Array, f32, positions in metres from `anchor`) give `DeviceSamples` without a copy,
        in new memory or in that of `out`.
        Raises ValueError on other shapes or types, and for a `lod` that the texture does not have.
        """
        source = self._source
        if self._filled is not None:  # whose light may be new since
            source = dataclasses.replace(source, exposure=self._filled.exposure)
        return self._launcher(self._lattice, source, positions, normals, lod, anchor, out)

    def on_device(
        self,
        positions: Any,
        normals: Any,
        lod: int | Viewer | None = None,
        anchor: F64 | None = None,
        out: DeviceSamples | None = None,
    ) -> DeviceSamples:
        """The same for arrays that are on the device, with the type said."""
        found = self(positions, normals, lod, anchor, out)
        assert isinstance(found, DeviceSamples)
        return found


def _check_filled(cache: TileCache, texture: VirtualTexture, storage: Storage, layout: Layout, order2: bool) -> None:
    """Raises ValueError for a cache in another format, or that cannot hold this texture's tiles in its slots."""
    held, asked = (cache.storage, cache.layout, cache.order2), (storage, layout, order2)
    if held != asked:
        raise ValueError(f"the cache holds {held} (storage, layout, order 2), asked for {asked}")
    if (cache.shape != texture.indirection.cache).any() or cache.resident != len(texture.texels):
        raise ValueError(
            f"the cache has {cache.resident} tiles in {cache.shape} slots, the texture {len(texture.texels)} in "
            f"{texture.indirection.cache}: they come from different bakes"
        )


def _uploaded(device: OpenDevice, cache: CacheTextures, order2: bool) -> tuple[tuple[Any, ...], int]:
    """Kernel arguments with the cache's textures, and their size."""
    if cache.weight is None:
        held = (cache.light, cache.more) if order2 and cache.more is not None else (cache.light,)
        return tuple(uploaded(device, a) for a in held), cache.bytes
    return tuple(uploaded(device, a) for a in (*cache.light, cache.weight)), cache.bytes


def lod_table(texture: VirtualTexture) -> I32:
    """Per LOD the first indirection texel and the dimensions, (L, 4) i32."""
    i = texture.indirection
    return np.column_stack([i.first[:-1], i.dims]).astype(np.int32)
