"""What the fast path is compared with: the kernel by the book, a dense grid in SciPy, a Dr.Jit texture, and the floor of in and out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from scipy import ndimage

from ...fastpath.arrays import empty, uploaded
from ...fastpath.device import OpenDevice, pyopencl_module
from ...fastpath.layout import cache_textures, exposure
from ...fastpath.sampler import lod_table
from ...reference.datatypes import F32
from ...reference.device_arrays import to_f32
from ...reference.sh import irradiance_weights
from ...reference.texture_types import WEIGHT, VirtualTexture
from ...reference.variant import ensure_variant
from ...reference.volume.sampler import resolve

CHANNELS = 13
DENSE_BATCH = 1 << 19


@dataclass(frozen=True, eq=False)
class DeviceView:
    """Positions and normals (N, 3) f32 on the device, and room for what a sampler returns of them."""

    positions: Any
    normals: Any
    irradiance: Any
    level: Any
    weight: Any

    @property
    def outputs(self) -> tuple[Any, ...]:
        """Buffers of the results."""
        return self.irradiance.base_data, self.level.base_data, self.weight.base_data


def on_device(device: OpenDevice, positions: F32, normals: F32) -> DeviceView:
    """Upload positions and normals (N, 3)."""
    import pyopencl.array

    n = len(positions)
    put = pyopencl.array.to_device
    room = [empty(device, (n, 3), np.float32), empty(device, (n,), np.int32), empty(device, (n,), np.float32)]
    return DeviceView(put(device.queue, positions), put(device.queue, normals), room[0], room[1], room[2])


def _program(device: OpenDevice) -> Any:
    text = resources.files(__package__).joinpath("half4.cl").read_text(encoding="utf-8")
    # L1 irradiance: A0 Y0 and A1 Y1 of reference/sh.py.
    weights = irradiance_weights(np.array([[1.0, 0.0, 0.0]]))[0]
    options = [f"-DIRRADIANCE_W0={weights[0]:.9g}f", f"-DIRRADIANCE_W1={weights[3]:.9g}f"]
    return pyopencl_module().Program(device.context, text).build(options=options)


class Half4:
    """The kernel by the book on a whole texture."""

    def __init__(self, device: OpenDevice, texture: VirtualTexture) -> None:
        """Upload `texture` as three half4 textures and a 16-bit weight."""
        self._device = device
        self._kernel = pyopencl_module().Kernel(_program(device), "sample_half4")
        cache = cache_textures(texture, "half16", "split")
        assert cache.weight is not None
        tables = (texture.indirection.texels, lod_table(texture))
        self._read = tuple(uploaded(device, a) for a in (*cache.light, cache.weight, *tables))
        words = np.zeros((), dtype=[("origin", np.float32, 4), ("extent", np.float32, 4), ("cache", np.int32, 4)])
        words["origin"] = [*texture.origin, 1.0 / texture.finest]
        words["extent"] = [*texture.extent, exposure(texture, "half16")]
        words["cache"] = [*texture.indirection.cache, texture.level]
        self._words = words[()]

    def __call__(self, view: DeviceView) -> Any:
        """Sample; the event."""
        given = (view.positions.base_data, view.normals.base_data, *view.outputs)
        return self._kernel(self._device.queue, (len(view.positions),), None, *self._read, self._words, *given)


def stream(device: OpenDevice) -> Callable[[DeviceView], Any]:
    """Reads and writes what a sampler must, 44 bytes a sample, and no texel."""
    kernel = pyopencl_module().Kernel(_program(device), "stream")

    def work(view: DeviceView) -> Any:
        given = (view.positions.base_data, view.normals.base_data, *view.outputs)
        return kernel(device.queue, (len(view.positions),), None, *given)

    return work


def dense_grid(texture: VirtualTexture) -> F32:
    """The texture at every corner of its finest voxels, (X, Y, Z, 13) f32: 12 coefficients times the weight, and the weight."""
    shape = tuple(int(n) + 1 for n in texture.extent)
    out = np.zeros((math.prod(shape), CHANNELS), dtype=np.float32)
    for begin in range(0, len(out), DENSE_BATCH):
        flat = np.arange(begin, min(begin + DENSE_BATCH, len(out)))
        q = np.stack(np.unravel_index(flat, shape), axis=1).astype(np.float64)
        light, weight, _ = resolve(texture, q, q, texture.level)
        out[flat, :WEIGHT], out[flat, WEIGHT] = light, weight
    return out.reshape(*shape, CHANNELS)


def map_coordinates(texture: VirtualTexture, dense: F32, positions: F32) -> Callable[[], F32]:
    """SciPy's lookup of the 13 channels, each contiguous, at positions (N, 3) m: (13, N) f32. On one core, as SciPy does it."""
    channels = np.ascontiguousarray(np.moveaxis(dense, 3, 0))
    q = np.ascontiguousarray(((positions - texture.origin) / texture.finest).T)
    out = np.empty((CHANNELS, len(positions)), dtype=np.float32)

    def work() -> F32:
        for channel, values in zip(channels, out, strict=True):
            ndimage.map_coordinates(channel, q, output=values, order=1, mode="nearest", prefilter=False)
        return out

    return work


def drjit_texture(
    texture: VirtualTexture, dense: F32, positions: F32, normals: F32, widths: tuple[int, ...], fused: bool = False
) -> Callable[[], Any]:
    """Dr.Jit `Texture3f` of the dense grid, as many as there are `widths`, which say their channels, at (N, 3): what is evaluated and
    waited for is every channel, or with `fused` irradiance alone, computed in the same kernel; a list of mi.Float.

    Positions and normals lie on its device, an array per axis, as it likes them.
    """
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    shape = np.array(dense.shape[:3])
    padded = np.zeros((*dense.shape[2::-1], max(sum(widths), CHANNELS)), dtype=np.float32)
    padded[..., :CHANNELS] = dense.transpose(2, 1, 0, 3)
    ends = np.cumsum(widths)
    parts = [padded[..., end - width : end] for end, width in zip(ends, widths, strict=True)]
    held = [mi.Texture3f(mi.TensorXf(to_f32(part), shape=part.shape)) for part in parts]
    unit = ((positions - texture.origin) / texture.finest + 0.5) / shape
    p = mi.Point3f(*(to_f32(unit[:, axis]) for axis in range(3)))
    w = mi.Vector4f(*(to_f32(column) for column in irradiance_weights(normals.astype(np.float64)).T))
    dr.eval(p, w)
    dr.sync_thread()

    def work() -> Any:
        channels = [channel for part in held for channel in part.eval(p)]
        if fused:
            channels = [dr.dot(mi.Vector4f(*channels[4 * c : 4 * c + 4]), w) / channels[WEIGHT] for c in range(3)]
        dr.eval(channels)
        dr.sync_thread()
        return channels

    return work
