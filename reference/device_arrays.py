"""NumPy arrays as Dr.Jit arrays, at addresses that do not make kernels compile again.

Dr.Jit 1.5 keeps NumPy's own memory and writes its alignment into the kernel: the same kernel is compiled anew whenever
NumPy happens to hand out memory aligned to 16 instead of 32 bytes. A copy at a multiple of 64 always gives one kernel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

ALIGNMENT = 64


def aligned(values: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """A flat copy of `values` as `dtype` whose address is a multiple of ALIGNMENT."""
    flat = np.asarray(values).ravel()
    size = flat.size * np.dtype(dtype).itemsize
    buffer = np.empty(size + ALIGNMENT, dtype=np.uint8)
    start = -buffer.ctypes.data % ALIGNMENT
    out = buffer[start : start + size].view(dtype)
    out[:] = flat
    return out


def drop_device_cache() -> None:
    """Give back what Dr.Jit keeps of freed arrays: batches of rays need tens of MiB that nothing after them does."""
    import drjit as dr

    dr.flush_malloc_cache()


def to_u32(values: npt.NDArray[Any]) -> Any:
    """Flat mi.UInt32 of `values`."""
    import mitsuba as mi

    return mi.UInt32(aligned(values, np.uint32))


def to_u64(values: npt.NDArray[Any]) -> Any:
    """Flat mi.UInt64 of `values`."""
    import mitsuba as mi

    return mi.UInt64(aligned(values, np.uint64))


def to_f32(values: npt.NDArray[Any]) -> Any:
    """Flat mi.Float of `values`."""
    import mitsuba as mi

    return mi.Float(aligned(values, np.float32))


def to_f64(values: npt.NDArray[Any]) -> Any:
    """Flat mi.Float64 of `values`."""
    import mitsuba as mi

    return mi.Float64(aligned(values, np.float64))


def to_lanes(values: npt.NDArray[Any]) -> Any:
    """Flat mi.UInt32 of `values`, at least two long: a single lane would be compiled as a constant, in a kernel of its own.

    The caller drops what the added lanes compute.
    """
    flat = np.asarray(values).ravel()
    return to_u32(np.repeat(flat, 2) if flat.size == 1 else flat)
