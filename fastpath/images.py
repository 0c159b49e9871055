"""The tile cache as 3D images: what a GPU's texture units read."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import I64
from ..reference.errors import EnvironmentLacks
from ..reference.texture_types import Storage
from .device import OpenDevice, pyopencl_module
from .layout import WEIGHT_TYPE


def image_arguments(device: OpenDevice, light: npt.NDArray[Any], weight: npt.NDArray[Any]) -> tuple[Any, ...]:
    """Light (3, Z, Y, X, 4) halves and weight (Z, Y, X) in 3D images, and the linear sampler: kernel arguments.

    Raises EnvironmentLacks where the device has no 3D images as large as that.
    """
    cl = pyopencl_module()
    x, y, z = weight.shape[::-1]
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    half, order = _formats(weight.dtype)
    _check(device, (x, y, z))
    made = [cl.create_image(device.context, flags, half, (x, y, z), hostbuf=np.ascontiguousarray(a)) for a in light]
    wide = np.ascontiguousarray(np.repeat(weight[..., None], 4, axis=-1))
    made.append(cl.create_image(device.context, flags, order, (x, y, z), hostbuf=wide))
    return (*made, _linear(device))


def empty_images(device: OpenDevice, tiles: I64, storage: Storage) -> tuple[Any, ...]:
    """The same for `tiles` (3,) per axis, all zero, to be written by kernels. Raises EnvironmentLacks as `image_arguments` does, and
    where kernels cannot write 3D images."""
    if not device.info.image3d_writes:
        raise EnvironmentLacks(
            f"kernels of the OpenCL device {device.info.name} cannot write 3D images (cl_khr_3d_image_writes); use the packed layout"
        )
    cl = pyopencl_module()
    x, y, z = (int(3 * n) for n in tiles)
    _check(device, (x, y, z))
    light, weight = _formats(np.dtype(WEIGHT_TYPE[storage]))
    made = []
    for order in (light, light, light, weight):
        image = cl.create_image(device.context, cl.mem_flags.READ_WRITE, order, (x, y, z))
        cl.enqueue_fill_image(device.queue, image, np.zeros(4, np.float32), (0, 0, 0), (x, y, z))
        made.append(image)
    return (*made, _linear(device))


def image_texel_bytes(storage: Storage) -> int:
    """Bytes of a texel in images as they are made here, with weights in four channels."""
    return 24 + 4 * np.dtype(WEIGHT_TYPE[storage]).itemsize


def _formats(weight: np.dtype[Any]) -> tuple[Any, Any]:
    """Formats of light and of weights. RGBA for weights too: PoCL reads single-channel images wrong."""
    cl = pyopencl_module()
    kinds = {"u2": cl.channel_type.UNORM_INT16, "u1": cl.channel_type.UNORM_INT8, "f2": cl.channel_type.HALF_FLOAT}
    rgba = cl.channel_order.RGBA
    return cl.ImageFormat(rgba, cl.channel_type.HALF_FLOAT), cl.ImageFormat(rgba, kinds[weight.str[1:]])


def _linear(device: OpenDevice) -> Any:
    cl = pyopencl_module()
    return cl.Sampler(device.context, False, cl.addressing_mode.CLAMP_TO_EDGE, cl.filter_mode.LINEAR)


def _check(device: OpenDevice, shape: tuple[int, int, int]) -> None:
    if any(size > most for size, most in zip(shape, device.info.image3d, strict=True)):
        raise EnvironmentLacks(
            f"the OpenCL device {device.info.name} has 3D images up to {device.info.image3d}, the tile cache needs {shape}; "
            "use the packed or split layout, or fewer tiles"
        )
