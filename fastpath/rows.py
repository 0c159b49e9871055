"""Form-factor rows on an OpenCL device: their products with light, and whole frames of relighting. Host side of rows.cl.

    gather   out_r = Σ_j v_rj L_j        bounce   B' = M + ρ (E_direct + F B)

Columns are P patches, then S sky bins, then one absorbing column that never carries light. The slow twin is
reference/transport/gather.py. One work-group sums a row, in a fixed order: results repeat bit for bit on any number of threads.
What bounds the speed, and how near it is, stands in rows.cl.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32, I32, I64
from ..reference.errors import EnvironmentLacks
from .device import OpenDevice, pyopencl_module

PATCHES = "patches"
GPU_LANES = 32
_TEXEL = 16  # bytes of RGBX, float32


class Rows:
    """Compressed rows on a device: R rows of C columns, K values per non-zero. Upload once, multiply often."""

    def __init__(
        self, device: OpenDevice, indptr: I64, columns: I32, values: F32, columns_count: int, lanes: int | None = None
    ) -> None:
        """Upload indptr (R + 1,) i64, columns (nnz,) i32 in 0 … columns_count - 1, values (nnz, K) f32, K = 1 or 4.

        lanes: work-items per row, a power of two; 1 on CPUs and 32 on GPUs if None. Raises ValueError on other shapes or
        types and on columns that are not there, EnvironmentLacks where the device cannot hold the matrix.
        """
        _check_rows(indptr, columns, values, columns_count)
        lanes = (GPU_LANES if device.info.kind == "gpu" else 1) if lanes is None else lanes
        if lanes < 1 or lanes & (lanes - 1):
            raise ValueError(f"lanes must be a power of two, got {lanes}")
        cl = pyopencl_module()
        self.device, self.columns_count, self._lanes = device, columns_count, lanes
        self.rows, self.components = len(indptr) - 1, values.shape[1]
        self.bytes = columns.nbytes + values.nbytes  # what one product must read
        # Attributes, because a kernel does not keep its arguments: released before the launch is over, they read garbage.
        self._matrix = [_upload(device, array) for array in (indptr, columns, values)]
        program = _program(device, self.components, lanes)
        self._gather = cl.Kernel(program, "gather")
        self._bounce = cl.Kernel(program, "bounce") if self.components == 1 else None
        self._bound: tuple[Any, ...] = ()

    def gather(self, light: Any, out: Any) -> Any:
        """Enqueue the product of the rows with the buffer `light` (C, 4) f32 RGBX into the buffer `out` (R, K, 3) f32.

        Returns the event, None without rows. Both buffers must live until it is over. Raises ValueError on small buffers.
        """
        _check_size("light", light, self.columns_count * _TEXEL)
        _check_size("out", out, self.rows * self.components * 12)
        return self._launch(self._gather, light, out)

    def bounce(self, light: Any, albedo: Any, exitance: Any, direct: Any, out: Any) -> Any:
        """Enqueue M + ρ (E + F B) into the first R texels of `out`; all buffers RGBX f32 of R texels, `light` of C.

        Returns the event, None without rows. Raises ValueError on small buffers, and unless K = 1.
        """
        if self._bounce is None:
            raise ValueError(f"a bounce takes rows with 1 component, got {self.components}")
        _check_size("light", light, self.columns_count * _TEXEL)
        for buffer in (albedo, exitance, direct, out):
            _check_size("of the patches", buffer, self.rows * _TEXEL)
        return self._launch(self._bounce, light, albedo, exitance, direct, out)

    def _launch(self, kernel: Any, *buffers: Any) -> Any:
        if self.rows == 0:
            return None
        self._bound = buffers
        kernel.set_args(*self._matrix, *buffers)
        size = (self.rows * self._lanes,), (self._lanes,)
        return pyopencl_module().enqueue_nd_range_kernel(self.device.queue, kernel, *size)

    def __call__(self, light: F32) -> F32:
        """The product with `light` (C, 3) f32: (R, K, 3) f32. Allocates; frames go through `Relight`."""
        _check_array("light", light, (self.columns_count, 3))
        source = _upload(self.device, _padded(light))
        out = np.empty((self.rows, self.components, 3), dtype=np.float32)
        target = _empty(self.device, out.nbytes)
        self.gather(source, target)
        _copy(self.device.queue, out, target)
        return out


class Relight:
    """Frames of changing light through a bake, all on the device; after the first frame nothing is allocated.

    Radiosity is kept from frame to frame. One bounce per frame is the run-time mode with temporal feedback; n bounces from
    `reset` are the first n terms of the Neumann series. Receivers see the radiosity and a sky of their own: black where it is
    tagged `engine`, with its peaks where patches get those as direct light. Engine lights come in as `direct`; their
    exitance stays out of `exitance`.
    """

    def __init__(
        self, device: OpenDevice, patch_rows: Rows, receivers: Mapping[str, Rows], albedo: F32, exitance: F32
    ) -> None:
        """patch_rows: P rows, K = 1, P + S + 1 columns; receivers: rows over the same columns, by a name other than
        "patches"; albedo, exitance (P, 3) f32, 0 ≤ albedo < 1, exitance ≥ 0, W·m⁻². Raises ValueError otherwise."""
        _check_scene(device, patch_rows, receivers, albedo, exitance)
        self.patches, columns = patch_rows.rows, patch_rows.columns_count
        self.sky_bins = columns - self.patches - 1
        self._device, self._rows, self._receivers = device, patch_rows, dict(receivers)
        self._albedo, self._exitance = _upload(device, _padded(albedo)), _upload(device, _padded(exitance))
        # Bounces go from one to the other; then the receivers' sky takes the place of the patches' one in the last.
        self._light = [_upload(device, np.zeros((columns, 4), np.float32)) for _ in range(2)]
        self._events: list[Any] = []
        self._current = 0
        self._direct = _empty(device, self.patches * _TEXEL)
        counts = (("direct", self.patches), ("sky", self.sky_bins), ("seen_sky", self.sky_bins))
        self._staged = {name: np.zeros((count, 4), np.float32) for name, count in counts}
        self._finite = {name: np.empty((len(a), 3), np.bool_) for name, a in self._staged.items()}
        self._host = {n: np.zeros((r.rows, r.components, 3), np.float32) for n, r in receivers.items()}
        self._out = {name: _empty(device, a.nbytes) for name, a in self._host.items()}
        self._host[PATCHES] = np.zeros((self.patches, 4), np.float32)
        views = {name: a[:, :3] if name == PATCHES else a.view() for name, a in self._host.items()}
        for view in views.values():
            view.setflags(write=False)
        self._views: Mapping[str, F32] = MappingProxyType(views)

    def reset(self) -> None:
        """Forget the radiosity of earlier frames: B = 0."""
        black = np.zeros((self.patches, 4), np.float32)
        for buffer in self._light:
            _copy(self._device.queue, buffer, black)

    def frame(self, direct: F32, sky: F32, seen_sky: F32, bounces: int = 1) -> Mapping[str, F32]:
        """Light of engine lights on patches, `direct` (P, 3) f32 W·m⁻², and π × radiance of the sky's bins, (S, 3) f32, as
        patches reflect it, `sky`, and as receivers see it, `seen_sky`.

        Returns (R, K, 3) f32 by receiver and the radiosity (P, 3) f32 under "patches". These arrays belong to this
        object, are read-only and hold the next frame after the next call. Raises ValueError on other shapes or types, on NaN
        or infinity, which feedback would keep for ever, and on less than one bounce.
        """
        if bounces < 1:
            raise ValueError(f"bounces must be 1 or more, got {bounces}")
        self._events.clear()  # of the frame before; waits if that was broken off, as its copies read what is staged next
        self._stage("direct", direct)
        self._stage("sky", sky)
        self._stage("seen_sky", seen_sky)
        first_sky = self.patches * _TEXEL
        self._send(self._direct, self._staged["direct"])
        for buffer in self._light if bounces > 1 else [self._light[self._current]]:
            self._send(buffer, self._staged["sky"], dst_offset=first_sky)
        for _ in range(bounces):
            source, self._current = self._light[self._current], 1 - self._current
            self._rows.bounce(source, self._albedo, self._exitance, self._direct, self._light[self._current])
        seen = self._light[self._current]
        self._send(seen, self._staged["seen_sky"], dst_offset=first_sky)
        for name, rows in self._receivers.items():
            rows.gather(seen, self._out[name])
            self._send(self._host[name], self._out[name])
        _copy(self._device.queue, self._host[PATCHES], seen)  # waits, so the queue is empty and the inputs may change
        return self._views

    def _send(self, target: Any, source: Any, **options: int) -> None:
        """Enqueue a copy and go on: a wait costs PoCL's threads a nap each. Its event is kept, as one let go of early waits."""
        self._events.append(_copy(self._device.queue, target, source, is_blocking=False, **options))

    def _stage(self, name: str, given: F32) -> None:
        """Check an input and put it into its RGBX array."""
        finite, staged = self._finite[name], self._staged[name]
        _check_array(name, given, finite.shape)
        if not np.isfinite(given, out=finite).all():
            raise ValueError(f"{name} must be finite, got {given[~finite][0]}")
        staged[:, :3] = given


def _program(device: OpenDevice, components: int, lanes: int) -> Any:
    """rows.cl for this many components and lanes; pyopencl keeps the built program on disk."""
    source = resources.files(__package__).joinpath("rows.cl").read_text(encoding="utf-8")
    options = [f"-DCOMPONENTS={components}", f"-DLANES={lanes}"]
    return pyopencl_module().Program(device.context, source).build(options=options)


def _padded(colours: F32) -> F32:
    """(N, 3) as RGBX (N, 4), X = 0."""
    padded = np.zeros((len(colours), 4), dtype=np.float32)
    padded[:, :3] = colours
    return padded


def _empty(device: OpenDevice, size: int) -> Any:
    """A buffer of `size` bytes, never 0: OpenCL has no empty buffers."""
    cl = pyopencl_module()
    limit = int(device.context.devices[0].max_mem_alloc_size)
    if size > limit:
        what = f"the OpenCL device {device.info.name} holds at most {limit} bytes in one array, {size} are needed"
        raise EnvironmentLacks(f"{what}. To mend it: larger radiosity.patch_size, fewer rays, or another device")
    return cl.Buffer(device.context, cl.mem_flags.READ_WRITE, max(size, _TEXEL))


def _copy(queue: Any, target: Any, source: Any, **options: int) -> Any:
    """Copy between arrays and buffers, waiting where an array takes part unless `is_blocking` is 0. Returns the event, None for an
    empty array, which is passed over: OpenCL refuses it."""
    if any(isinstance(side, np.ndarray) and not side.size for side in (target, source)):
        return None
    return pyopencl_module().enqueue_copy(queue, target, source, **options)


def _upload(device: OpenDevice, array: npt.NDArray[Any]) -> Any:
    buffer = _empty(device, array.nbytes)
    _copy(device.queue, buffer, np.ascontiguousarray(array))
    return buffer


def _check_array(name: str, array: npt.NDArray[Any], shape: tuple[int, ...], dtype: type = np.float32) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(f"expected {name} {shape} {np.dtype(dtype)}, got {array.shape} {array.dtype}")


def _check_size(name: str, buffer: Any, size: int) -> None:
    if buffer.size < size:
        raise ValueError(f"the buffer {name} must hold {size} bytes or more, got {buffer.size}")


def _check_rows(indptr: I64, columns: I32, values: F32, columns_count: int) -> None:
    _check_array("indptr", indptr, (max(indptr.size, 1),), np.int64)
    _check_array("columns", columns, (columns.size,), np.int32)
    _check_array("values", values, (len(columns), 4 if values.shape[1:] == (4,) else 1))
    if indptr[0] != 0 or indptr[-1] != len(columns) or (indptr[1:] < indptr[:-1]).any():
        raise ValueError(f"indptr must rise from 0 to {len(columns)}, the number of columns")
    low, high = columns.min(initial=0), columns.max(initial=-1)
    if low < 0 or high >= columns_count:  # the kernel does not check
        raise ValueError(f"columns must lie in 0 … {columns_count - 1}, got {low} … {high}")


def _check_scene(device: OpenDevice, patch_rows: Rows, receivers: Mapping[str, Rows], *surface: F32) -> None:
    count, columns = patch_rows.rows, patch_rows.columns_count
    if patch_rows.components != 1 or not 0 < count < columns:
        got = f"{count}, {patch_rows.components} and {columns}"
        raise ValueError(f"patch rows must be 1 or more, with 1 component and more columns than rows, got {got}")
    for name, rows in receivers.items():
        if name == PATCHES or rows.columns_count != columns:
            raise ValueError(f"receiver {name!r} must have another name than {PATCHES!r} and {columns} columns")
    if not all(rows.device is device for rows in (patch_rows, *receivers.values())):
        raise ValueError("all rows must be on the device of the relight")
    for name, array, limit in zip(("albedo", "exitance"), surface, (1.0, np.inf), strict=True):
        _check_array(name, array, (count, 3))
        if not ((array >= 0.0) & (array < limit)).all():
            raise ValueError(f"{name} must be at least 0 and below {limit:g}, got {array.min()} … {array.max()}")
