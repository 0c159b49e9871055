"""What an OpenCL device can do, found out by trying.

The sampler reads RGBA half 3D textures with linear filtering. The probe makes a 4×4×4 texture whose texel values are
affine in position, reads between texels, and compares with the affine function, which linear filtering reproduces.
RGBA, because PoCL reads single-channel half images wrong; fractions of 1/4, because GPUs filter with 8-bit fractions.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F32
from ..reference.errors import EnvironmentLacks
from .device import DeviceInfo, OpenDevice, list_devices, open_device, pyopencl_module

TIME_LIMIT_S = 120.0
_SIDE = 4
_POINT = (1.75, 2.25, 1.5)
_SLOPE = np.array([[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.25], [0.0, 0.0, 1.0, 0.125]])
_TOLERANCE = 2e-3
_SOURCE = """
kernel void probe(read_only image3d_t image, sampler_t linear_sampler, float4 at, global float4 *out) {
    out[0] = read_imagef(image, linear_sampler, at);
}
"""


@dataclass(frozen=True)
class Probe:
    """What the device read at a known point. reason says what went wrong, and is empty when ok."""

    ok: bool
    expected: tuple[float, ...]
    got: tuple[float, ...]
    reason: str


def _expected(point: tuple[float, float, float]) -> F32:
    """The probe's affine function at `point`, texels, where texel i has its centre at i + 1/2. (4,) f32."""
    return np.asarray((np.array(point) - 0.5) @ _SLOPE, np.float32)


def _texels() -> Any:
    """(depth, height, width, 4) f16 values of the affine function at the texel centres."""
    z, y, x = np.meshgrid(*[np.arange(_SIDE) + 0.5] * 3, indexing="ij")
    return np.ascontiguousarray(((np.stack([x, y, z], -1) - 0.5) @ _SLOPE).astype(np.float16))


def _read(device: OpenDevice) -> F32:
    """What `device` reads at the known point. (4,) f32."""
    cl = pyopencl_module()
    flags = cl.mem_flags
    out = np.full(4, np.nan, np.float32)
    buffer = cl.Buffer(device.context, flags.WRITE_ONLY, out.nbytes)
    image = cl.create_image(
        device.context,
        flags.READ_ONLY | flags.COPY_HOST_PTR,
        cl.ImageFormat(cl.channel_order.RGBA, cl.channel_type.HALF_FLOAT),
        shape=(_SIDE,) * 3,
        hostbuf=_texels(),
    )
    sampler = cl.Sampler(device.context, False, cl.addressing_mode.CLAMP_TO_EDGE, cl.filter_mode.LINEAR)
    kernel = cl.Kernel(cl.Program(device.context, _SOURCE).build(), "probe")
    kernel.set_args(image, sampler, np.array([*_POINT, 0.0], np.float32), buffer)
    cl.enqueue_nd_range_kernel(device.queue, kernel, (1,), None)
    cl.enqueue_copy(device.queue, out, buffer)
    device.queue.finish()
    del sampler, image  # OpenCL does not own kernel arguments: both had to live until the launch was over
    return out


def probe(info: DeviceInfo) -> Probe:
    """Read a known half-float 3D texture with linear filtering on one device. Never raises for what the device does."""
    expected = tuple(float(v) for v in _expected(_POINT))
    if min(info.image3d) < _SIDE:
        return Probe(False, expected, (), "no 3D images")
    try:
        got = tuple(float(v) for v in _read(open_device(str(info.index))))
    except pyopencl_module().Error as error:
        return Probe(False, expected, (), str(error).strip().splitlines()[0])
    good = bool(np.allclose(got, expected, rtol=0.0, atol=_TOLERANCE))
    return Probe(good, expected, got, "" if good else "linear read of an RGBA half 3D image is wrong")


def probe_isolated(info: DeviceInfo) -> Probe:
    """`probe` in a process of its own: a broken driver may abort it. Raises EnvironmentLacks as `open_device` does."""
    expected = tuple(float(v) for v in _expected(_POINT))
    command = [sys.executable, "-m", __name__, str(info.index)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return Probe(False, expected, (), f"no answer in {TIME_LIMIT_S:.0f} s")
    if done.returncode == 3:
        raise EnvironmentLacks(done.stderr.strip())
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[0]
        return Probe(False, expected, (), f"the driver ended the process ({done.returncode}): {last}")
    found = json.loads(done.stdout.splitlines()[-1])
    return Probe(found["ok"], tuple(found["expected"]), tuple(found["got"]), found["reason"])


def _main(index: int) -> int:
    """Probe one device; its JSON on standard output."""
    try:
        print(json.dumps(asdict(probe(list_devices()[index]))))
    except EnvironmentLacks as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(_main(int(sys.argv[1])))
