"""Per-pixel sampling of the virtual texture on an OpenCL device: the host side of sampler.cl.

The tile cache is read either as buffers with eight explicit loads (exact, and faster on CPUs) or as images through the
linear sampler (what a GPU's texture units do, with their coarse fractions).
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Any

import numpy as np

from ..reference.datatypes import F32, F64, I32, Samples, VirtualTexture, check_lod
from .device import OpenDevice
from .layout import LIGHT_TYPE, WEIGHT_STEPS, CacheTextures, Storage, cache_textures, grid_words, lod_table

_LIGHT_C = {"float32": "float", "half16": "half", "half8": "half"}
_WEIGHT_C = {"float32": "float", "half16": "ushort", "half8": "uchar"}


class Sampler:
    """A virtual texture on a device. Build once, call often; `seconds` is the device time of the last call."""

    def __init__(self, device: OpenDevice, texture: VirtualTexture, storage: Storage, images: bool = False) -> None:
        """Upload `texture` in the given storage format. Raises ValueError on images in float32 (no such format here)."""
        if images and storage == "float32":
            raise ValueError("images hold half16 or half8, got storage 'float32'")
        import pyopencl as cl

        self._device, self._level = device, texture.level
        self._cache = cache_textures(texture, storage)
        self._kernel = cl.Kernel(_program(device, storage, images), "sample")
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        # Kept as attributes: a cl.Sampler or buffer released before the launch has finished reads garbage.
        self._textures = _image_args(device, self._cache) if images else _buffer_args(device, self._cache)
        self._indirection = cl.Buffer(device.context, flags, hostbuf=texture.indirection.texels)
        self._lods = cl.Buffer(device.context, flags, hostbuf=lod_table(texture))
        self._grid = np.frombuffer(grid_words(texture, storage), dtype=np.uint8).view(np.dtype((np.void, 48)))[0]
        self.bytes = self._cache.bytes + texture.indirection.texels.nbytes
        self.seconds = 0.0

    def __call__(self, positions: F32 | F64, normals: F32 | F64, lod: int | I32 | None = None) -> Samples:
        """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3); `lod`: finest level to use, one for all or (N,) i32;
        see reference/volume/sampler.py.

        Raises ValueError on other shapes, and for a `lod` that the texture does not have.
        """
        if positions.ndim != 2 or positions.shape[1] != 3 or positions.shape != normals.shape:
            raise ValueError(f"expected positions and normals (N, 3), got {positions.shape} and {normals.shape}")
        n = len(positions)
        check_lod(lod, self._level, n)
        asked = np.asarray(self._level if lod is None else lod, dtype=np.int32)
        import pyopencl as cl

        if n == 0:
            return Samples(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))
        context, queue = self._device.context, self._device.queue
        read = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        p = cl.Buffer(context, read, hostbuf=np.ascontiguousarray(positions, dtype=np.float32))
        d = cl.Buffer(context, read, hostbuf=np.ascontiguousarray(normals, dtype=np.float32))
        own_lods = cl.Buffer(context, read, hostbuf=np.ascontiguousarray(asked)) if asked.ndim else None
        irradiance, levels = np.empty((n, 3), np.float32), np.empty(n, np.int32)
        weight = np.empty(n, np.float32)
        outs = [cl.Buffer(context, cl.mem_flags.WRITE_ONLY, a.nbytes) for a in (irradiance, levels, weight)]
        arguments = (
            *self._textures,
            self._indirection,
            self._lods,
            self._grid,
            np.int32(0 if asked.ndim else asked),
            own_lods,
            p,
            d,
            *outs,
        )
        event = self._kernel(queue, (n,), None, *arguments)
        event.wait()
        self.seconds = (event.profile.end - event.profile.start) * 1e-9
        for host, buffer in zip((irradiance, levels, weight), outs, strict=True):
            cl.enqueue_copy(queue, host, buffer)
        return Samples(irradiance, levels, weight)


def _program(device: OpenDevice, storage: Storage, images: bool) -> Any:
    import pyopencl as cl

    source = resources.files(__package__).joinpath("sampler.cl").read_text(encoding="utf-8")
    # L1 irradiance: A0 Y0 and A1 Y1 of reference/sh.py.
    w0, w1 = math.pi * 0.5 * math.sqrt(1 / math.pi), 2 * math.pi / 3 * 0.5 * math.sqrt(3 / math.pi)
    options = [
        f"-DLIGHT={_LIGHT_C[storage]}",
        f"-DWEIGHT={_WEIGHT_C[storage]}",
        f"-DWEIGHT_SCALE={WEIGHT_STEPS[storage]}.0f",
        f"-DIRRADIANCE_W0={w0:.9g}f",
        f"-DIRRADIANCE_W1={w1:.9g}f",
        "-cl-fp32-correctly-rounded-divide-sqrt",
    ]
    options += ["-DHALF_LIGHT"] if LIGHT_TYPE[storage] is np.float16 else []
    options += ["-DIMAGES"] if images else []
    return cl.Program(device.context, source).build(options=options)


def _buffer_args(device: OpenDevice, cache: CacheTextures) -> list[Any]:
    import pyopencl as cl

    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    return [cl.Buffer(device.context, flags, hostbuf=a) for a in (*cache.light, cache.weight)]


def _image_args(device: OpenDevice, cache: CacheTextures) -> list[Any]:
    import pyopencl as cl

    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    shape = cache.weight.shape[::-1]
    half = cl.ImageFormat(cl.channel_order.RGBA, cl.channel_type.HALF_FLOAT)
    unorm = cl.channel_type.UNORM_INT16 if cache.weight.dtype == np.uint16 else cl.channel_type.UNORM_INT8
    images = [cl.create_image(device.context, flags, half, shape, hostbuf=np.ascontiguousarray(a)) for a in cache.light]
    # RGBA for the weight too: PoCL reads single-channel images wrong.
    weight = np.ascontiguousarray(np.repeat(cache.weight[..., None], 4, axis=-1))
    order = cl.ImageFormat(cl.channel_order.RGBA, unorm)
    images.append(cl.create_image(device.context, flags, order, shape, hostbuf=weight))
    linear = cl.Sampler(device.context, False, cl.addressing_mode.CLAMP_TO_EDGE, cl.filter_mode.LINEAR)
    return [*images, linear]
