"""What goes into a kernel and comes out of it: NumPy arrays, or arrays that are on the device already and stay there."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .device import OpenDevice, pyopencl_module


def is_on_device(value: object) -> bool:
    """True for a pyopencl.array.Array."""
    return hasattr(value, "base_data") and hasattr(value, "queue")


def check_triples(name: str, value: Any, count: int | None = None) -> int:
    """Number of rows of `value`, a (N, 3) array of floats on host or device; of `count` rows, if given.

    Raises ValueError naming the array for another shape, for numbers that are not floats, and on the device for another type
    than float32 in C order.
    """
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is None or len(shape) != 2 or shape[1] != 3 or (count is not None and shape[0] != count):
        rows = "N" if count is None else str(count)
        raise ValueError(
            f"{name}: expected shape ({rows}, 3), got {shape if shape is not None else type(value).__name__}"
        )
    if np.dtype(dtype).kind != "f":
        raise ValueError(f"{name}: expected floats, got {dtype}")
    if is_on_device(value) and (dtype != np.float32 or not value.flags.c_contiguous or value.offset != 0):
        raise ValueError(
            f"{name}: on the device expected float32 in C order from a buffer's start, got {dtype}, a view perhaps"
        )
    return int(shape[0])


def uploaded(device: OpenDevice, value: npt.NDArray[Any]) -> Any:
    """A read-only buffer that holds a copy of `value`; an empty one holds a byte, as OpenCL wants."""
    cl = pyopencl_module()
    held = np.ascontiguousarray(value) if value.size else np.zeros(1, np.uint8)
    return cl.Buffer(device.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=held)


def empty(device: OpenDevice, shape: tuple[int, ...], dtype: npt.DTypeLike) -> Any:
    """A new array on the device (pyopencl.array.Array), not initialised."""
    import pyopencl.array

    pyopencl_module()
    return pyopencl.array.Array(device.queue, shape, np.dtype(dtype))
