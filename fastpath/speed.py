"""How fast a device samples each layout, found out in under a second; and which one to use without asking.

    packed   (half)    what CPUs like: a texel is one load
    images   (half8)   what GPUs like: the texture units interpolate, 25 bytes a texel as in the talk
    split    (half16)  for devices with neither

The measurement samples SAMPLES places along a curve through a texture of TILES tiles, as neighbouring pixels do. It runs in a process
of its own, for a broken driver may abort it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np

from ..reference.errors import EnvironmentLacks
from ..reference.texture_types import Indirection, Storage, VirtualTexture, cache_shape
from .device import DeviceInfo, OpenDevice, list_devices, open_device, pyopencl_module
from .launch import DeviceSamples
from .layout import LAYOUTS, Layout
from .sampler import Sampler

STORAGE_OF: dict[Layout, Storage] = {"packed": "half", "split": "half16", "images": "half8"}
LEVEL = 5
CLEARLY = 1.5
TILES_SIDE = 1 << (LEVEL - 1)
SAMPLES, BUDGET_S = 1 << 16, 0.2
TIME_LIMIT_S = 120.0
Speeds = dict[Layout, float]


def preferred(info: DeviceInfo, speeds: Speeds | None = None) -> tuple[Storage, Layout]:
    """Storage and layout for a device: that of its kind, unless another is CLEARLY times faster by `speeds` (samples/s).

    Noise then never decides what a run's numbers are.
    """
    layout: Layout = "images" if info.kind == "gpu" and "images" in layouts_of(info) else "packed"
    speeds = {
        name: value for name, value in (speeds or {}).items() if name != "split"
    }  # which no tile cache is filled in
    if speeds:
        fastest = max(speeds, key=lambda name: speeds[name])
        layout = fastest if speeds[fastest] > CLEARLY * speeds.get(layout, 0.0) else layout
    return STORAGE_OF[layout], layout


def layouts_of(info: DeviceInfo) -> list[Layout]:
    """Those that the device has."""
    return [layout for layout in LAYOUTS if layout != "images" or min(info.image3d) >= 3 * TILES_SIDE]


def measure(device: OpenDevice) -> Speeds:
    """Samples/s of each layout: the fastest launch of BUDGET_S seconds of them, by the device's clock."""
    import pyopencl.array

    texture = _texture()
    t = np.linspace(0.0, 1.0, SAMPLES)
    curve = 0.5 + 0.5 * np.stack([np.sin(9.0 * t), np.sin(31.0 * t), np.cos(17.0 * t)], axis=1)
    positions = (curve * texture.extent * texture.finest).astype(np.float32)
    p, n = (pyopencl.array.to_device(device.queue, a) for a in (positions, np.full_like(positions, 3.0**-0.5)))
    samplers = {layout: Sampler(device, texture, STORAGE_OF[layout], layout) for layout in layouts_of(device.info)}
    held: dict[Layout, DeviceSamples] = {}
    taken: dict[Layout, list[float]] = {layout: [] for layout in samplers}
    while any(
        sum(t) < BUDGET_S or len(t) < 2 for t in taken.values()
    ):  # in turn, so that what else runs falls on all of them
        for layout, sampler in samplers.items():
            if sum(taken[layout]) < BUDGET_S or len(taken[layout]) < 2:
                held[layout] = sampler.on_device(p, n, out=held.get(layout))
                event = held[layout].event
                event.wait()
                taken[layout].append(1e-9 * max(event.profile.end - event.profile.start, 1000))
    return {layout: SAMPLES / min(t[1:]) for layout, t in taken.items()}  # the first touches memory


def _texture() -> VirtualTexture:
    """One level of TILES_SIDE^3 tiles anyhow in the cache, every probe valid, and the same tile for all coarser levels."""
    rng = np.random.default_rng(0)
    tiles = TILES_SIDE**3
    shape = cache_shape(tiles)
    slot = rng.permutation(tiles)
    pointer = (
        slot % shape[0] | slot // shape[0] % shape[1] << 8 | slot // (shape[0] * shape[1]) << 16 | LEVEL << 24
    ).astype(np.uint32)
    dims = np.array([[1, 1, 1]] * (LEVEL - 1) + [[TILES_SIDE] * 3])
    first = np.concatenate([[0], np.cumsum(dims.prod(axis=1))])
    texels = rng.random((tiles, 27, 13), dtype=np.float32)
    texels[..., 12] = 1.0
    indirection = Indirection(np.concatenate([pointer[: LEVEL - 1], pointer]), first, dims, shape)
    return VirtualTexture(np.zeros(3), 1.0, LEVEL, np.full(3, 2 * TILES_SIDE), indirection, texels)


def measure_isolated(info: DeviceInfo) -> Speeds:
    """`measure` in a process of its own; nothing where the device fails. Raises EnvironmentLacks as `open_device` does."""
    command = [sys.executable, "-m", __name__, str(info.index)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return {}
    if done.returncode == 3:
        raise EnvironmentLacks(done.stderr.strip())
    if done.returncode != 0:
        return {}
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return {layout: float(found[layout]) for layout in LAYOUTS if layout in found}


def _main(index: int) -> int:
    """Measure one device; its JSON on standard output."""
    try:
        print(json.dumps(measure(open_device(str(list_devices()[index].index)))))
    except EnvironmentLacks as error:
        print(error, file=sys.stderr)
        return 3
    except pyopencl_module().Error as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main(int(sys.argv[1])))
