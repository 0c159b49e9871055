"""What goes into a kernel and comes out of it: NumPy arrays, or arrays that are on the device already and stay there."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .device import OpenDevice, pyopencl_module


def is_on_device(value: object) -> bool:
    """True for a pyopencl.array.Array or a pyopencl.Buffer."""
    return hasattr(value, "base_data") or _is_buffer(value)


def _is_buffer(value: object) -> bool:
    return hasattr(value, "int_ptr") and hasattr(value, "size") and not hasattr(value, "shape")


def buffer_of(value: Any) -> Any:
    """The buffer behind an array on the device; a buffer is its own."""
    return value.base_data if hasattr(value, "base_data") else value


def events_of(*values: Any) -> list[Any]:
    """What must be over before arrays on the device may be read."""
    return [event for value in values for event in getattr(value, "events", ())]


def check_contiguous(name: str, value: Any) -> None:
    """Raises ValueError for an array on the device that is not float32 in C order from its buffer's start."""
    if hasattr(value, "base_data") and (value.dtype != np.float32 or not value.flags.c_contiguous or value.offset != 0):
        raise ValueError(
            f"{name}: on the device expected float32 in C order from a buffer's start, got {value.dtype}, a view perhaps"
        )


def check_triples(name: str, value: Any, count: int | None = None) -> int:
    """Number of rows of `value`, a (N, 3) array of floats on host or device, or a buffer of 12 N bytes; of `count` rows, if given.

    Raises ValueError naming the array for another shape, for numbers that are not floats, and on the device for another type
    than float32 in C order.
    """
    if _is_buffer(value):
        if value.size % 12 or (count is not None and value.size != 12 * count):
            rows = "N" if count is None else str(count)
            raise ValueError(f"{name}: expected a buffer of 12 × {rows} bytes, got {value.size}")
        return int(value.size // 12)
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is None or len(shape) != 2 or shape[1] != 3 or (count is not None and shape[0] != count):
        rows = "N" if count is None else str(count)
        raise ValueError(
            f"{name}: expected shape ({rows}, 3), got {shape if shape is not None else type(value).__name__}"
        )
    if np.dtype(dtype).kind != "f":
        raise ValueError(f"{name}: expected floats, got {dtype}")
    check_contiguous(name, value)
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
