"""Samples per second of a whole texture: our layouts, and the peers, on the same positions in the same run.

    ratio = time of the peer / time of ours, repeat by repeat      Msamples/s = samples / device time / 10^6

Against kernels by device time; against SciPy and Dr.Jit by the wall clock for both, launch and waiting included, each after a rest and
WARM_S seconds that are not counted: threads that still spin from the task before slow none, and none has gone to sleep. All data lie
where each likes them; nothing is transferred, and results go to memory that was touched before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...fastpath.device import OpenDevice, open_device
from ...fastpath.launch import DeviceSamples
from ...fastpath.layout import Layout, cache_textures
from ...fastpath.sampler import Sampler
from ...reference.datatypes import F32, F64
from ...reference.progress import Progress
from ...reference.texture_types import Storage, VirtualTexture
from .fastpath_peers import DeviceView, Half4, dense_grid, drjit_texture, map_coordinates, on_device, stream
from .fastpath_world import HEIGHT, WIDTH, build_world, scattered, view
from .rows import Group, Row, Wanted, row_of
from .timing import Task, interleaved, timed

SIDE, SMALL_SIDE = 128, 16
EYE = np.array([-29.0, 3.0, 1.0])
REPEATS, REST_S, WARM_S = 9, 0.05, 0.1
SCIPY_SHARE = 8  # SciPy samples every eighth pixel
# Dr.Jit's ways to the same data: widths of its textures, and whether irradiance is computed in the same kernel.
DRJIT: dict[str, tuple[tuple[int, ...], bool]] = {
    "drjit_13": ((13,), False), "drjit_16": ((16,), False), "drjit_rgba": ((4, 4, 4, 1), False), "drjit_fused": ((16,), True),
}  # fmt: skip
STREAMED_BYTES = 44  # position, normal, irradiance, level, weight
OURS = "packed"
TALK: tuple[Storage, Layout] = ("half8", "split")
FORMATS: dict[str, tuple[Storage, Layout]] = {
    "packed": ("half", "packed"), "split": ("half16", "split"), "image": ("half8", "images"), "float32": ("float32", "packed"),
}  # fmt: skip
NAMES = (
    "coherent_vs_image", "random_vs_image", "coherent_vs_half4", "random_vs_half4", "coherent_vs_split", "coherent_vs_map_coordinates",
    "coherent_vs_drjit_texture", "coherent_vs_drjit_rgba", "coherent_vs_drjit_fused", "coherent_msamples", "random_msamples",
    "coherent_msamples_float32", "coherent_msamples_image",
    "coherent_msamples_half4", "coherent_msamples_drjit_texture", "cycles_per_sample", "floor_share", "floor_cycles_per_sample",
)  # fmt: skip
BYTES = ("bytes_per_texel_talk", "bytes_per_tile_talk", "bytes_per_texel_packed", "bytes_per_tile_packed")


def device_time(launch: Callable[[], Any]) -> Task:
    """Seconds on the device, by its own clock, of the event that `launch` gives."""

    def work(repeat: int) -> float:
        del repeat
        event = launch()
        event.wait()
        return float(event.profile.end - event.profile.start) * 1e-9

    return work


def sampling(
    device: OpenDevice, texture: VirtualTexture, storage: Storage, layout: Layout
) -> Callable[[DeviceView], Any]:
    """Our sampler in one format as a launch that gives its event."""
    sampler = Sampler(device, texture, storage, layout)
    kept: dict[int, DeviceSamples] = {}

    def launch(view: DeviceView) -> Any:
        """As a renderer does it: frame after frame into the same memory."""
        made = sampler.on_device(view.positions, view.normals, anchor=np.zeros(3), out=kept.get(len(view.positions)))
        kept[len(view.positions)] = made
        return made.event

    return launch


def launches(device: OpenDevice, texture: VirtualTexture) -> dict[str, Callable[[DeviceView], Any]]:
    """Every kernel by name: our formats, the one by the book, and the floor. Images only where the device has them."""
    formats = {k: v for k, v in FORMATS.items() if k != "image" or min(device.info.image3d) > 0}
    made = {name: sampling(device, texture, *v) for name, v in formats.items()}
    return {**made, "half4": Half4(device, texture), "stream": stream(device)}


def peers(texture: VirtualTexture, positions: F32, normals: F32) -> dict[str, Callable[[], Any]]:
    """What is timed by the wall clock, by name."""
    dense, part = dense_grid(texture), slice(None, None, SCIPY_SHARE)
    made = {k: drjit_texture(texture, dense, positions, normals, *v) for k, v in DRJIT.items()}
    return made | {"scipy": map_coordinates(texture, dense, positions[part])}


@dataclass(frozen=True, eq=False)
class Timed:
    """Seconds by task, (repeats,) each: on the device, and by the wall clock. samples: of each."""

    device: dict[str, F64]
    wall: dict[str, F64]
    samples: int

    def ratio(self, peer: str, ours: str) -> F64:
        """Of device times."""
        return self.device[peer] / self.device[ours]

    def rate(self, name: str) -> F64:
        """Msamples/s."""
        return 1e-6 * self.samples / self.device[name]


def settled(task: Task) -> Task:
    """The task with a rest before and after it, not counted: thread pools go on spinning for a while, on the next one's cores. Nor are
    calls of the first WARM_S seconds, by which cores that slept are as fast as between the frames of a renderer, for short tasks and
    long."""

    def work(repeat: int) -> float:
        time.sleep(REST_S)
        began = time.perf_counter()
        while time.perf_counter() - began < WARM_S:
            task(repeat)
        taken = task(repeat)
        time.sleep(REST_S)
        return taken

    return work


Launches = dict[str, Callable[[DeviceView], Any]]


def measured(
    stage: str, kernels: Launches, at: DeviceView, others: dict[str, Callable[[], Any]], progress: Progress
) -> Timed:
    """All of them in turn, REPEATS times; by the wall clock the others, and ours beside them."""

    def launched(launch: Callable[[DeviceView], Any]) -> Callable[[], Any]:
        return lambda: launch(at)

    tasks = {name: device_time(launched(launch)) for name, launch in kernels.items()}
    walls = {OURS: lambda: kernels[OURS](at).wait()} | others if others else {}
    found = interleaved(tasks | {f"{k}, wall": settled(timed(v)) for k, v in walls.items()}, REPEATS, progress, stage)
    return Timed({k: found[k] for k in kernels}, {k: found[f"{k}, wall"] for k in walls}, len(at.positions))


def rates(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """All rows of speed: coherent positions with every peer, random ones with the kernels."""
    device = open_device()
    world = build_world(SIDE)
    texture = world.texture
    kernels = launches(device, texture)
    seen, anywhere = view(world.grid, EYE), scattered(world.grid, WIDTH * HEIGHT)
    others = peers(texture, *seen) if any("drjit" in name or "map" in name for name in wanted) else {}
    coherent = measured("coherent", kernels, on_device(device, *seen), others, progress)
    spread = measured("random", kernels, on_device(device, *anywhere), {}, progress)
    where = f"{WIDTH}×{HEIGHT}, {world.layout.tiles} tiles of {texture.level} levels, {device.info.name}"
    yield from _against_kernels(coherent, spread, OURS, where)
    if others:
        yield from _against_wall(coherent, where)
    yield from _floor(device, coherent, where)


def _against_kernels(coherent: Timed, spread: Timed, ours: str, where: str) -> Iterator[Row]:
    if "image" in coherent.device:
        note = f"{where}; our own kernel through the image sampler, three RGBA half images and an 8-bit weight, device time"
        yield row_of("coherent_vs_image", coherent.ratio("image", ours), "ratio", "higher", 5.0, note)
        yield row_of("random_vs_image", spread.ratio("image", ours), "ratio", "higher", 4.0, note)
        yield row_of("coherent_msamples_image", coherent.rate("image"), "M/s", "higher")
    note = f"{where}; half4.cl: eight vload_half4 from each of three buffers, device time"
    yield row_of("coherent_vs_half4", coherent.ratio("half4", ours), "ratio", "higher", 2.0, note)
    yield row_of("random_vs_half4", spread.ratio("half4", ours), "ratio", "higher", note=note)
    yield row_of(
        "coherent_vs_split", coherent.ratio("split", ours), "ratio", "higher", note="our own split layout, half16"
    )
    yield row_of("coherent_msamples", coherent.rate(ours), "M/s", "higher", note=f"{where}; packed half")
    yield row_of(
        "random_msamples", spread.rate(ours), "M/s", "higher", note=f"{where}; packed half, anywhere in the world"
    )
    yield row_of("coherent_msamples_float32", coherent.rate("float32"), "M/s", "higher", note="packed float32")
    yield row_of("coherent_msamples_half4", coherent.rate("half4"), "M/s", "higher")


def _against_wall(coherent: Timed, where: str) -> Iterator[Row]:
    ours = coherent.wall[OURS]
    note = f"{where}; wall clock; SciPy: order 1, 13 channels of a dense grid, every {SCIPY_SHARE}th pixel, on one core as it is made"
    share = -(-coherent.samples // SCIPY_SHARE) / coherent.samples
    ratio = coherent.wall["scipy"] / share / ours
    yield row_of("coherent_vs_map_coordinates", ratio, "ratio", "higher", 20.0, note)
    best = min(("drjit_13", "drjit_16"), key=lambda name: float(np.median(coherent.wall[name])))
    note = f"{where}; wall clock; one Texture3f, float32, of {best[6:]} channels (the faster of 13 and 16), all of them evaluated"
    yield row_of("coherent_vs_drjit_texture", coherent.wall[best] / ours, "ratio", "higher", 3.0, note)
    note = "the same in the talk's parts: three RGBA textures and a weight"
    yield row_of("coherent_vs_drjit_rgba", coherent.wall["drjit_rgba"] / ours, "ratio", "higher", note=note)
    note = (
        "its best case: 16 channels, no channel written, irradiance from the same kernel, an array per axis in and out"
    )
    yield row_of("coherent_vs_drjit_fused", coherent.wall["drjit_fused"] / ours, "ratio", "higher", note=note)
    rate = 1e-6 * coherent.samples / coherent.wall[best]
    yield row_of("coherent_msamples_drjit_texture", rate, "M/s", "higher", note="wall clock")


def _floor(device: OpenDevice, coherent: Timed, where: str) -> Iterator[Row]:
    """Cycles, and how near to a kernel that only reads and writes what every sampler must."""
    clock = int(device.context.devices[0].max_clock_frequency)
    if cycles := clock * device.info.compute_units:
        note = f"{where}; {device.info.compute_units} units at their nominal {clock} MHz"
        yield row_of("cycles_per_sample", cycles / coherent.rate("packed"), "cycles", "lower", note=note)
        yield row_of(
            "floor_cycles_per_sample", cycles / coherent.rate("stream"), "cycles", "lower", note="in and out alone"
        )
    gb = 1e-3 * STREAMED_BYTES * coherent.rate("stream")
    note = (
        f"time of reading and writing {STREAMED_BYTES} bytes a sample ({np.median(gb):.1f} GB/s) over that of sampling"
    )
    yield row_of("floor_share", coherent.ratio("stream", "packed"), "ratio", "higher", note=note)


def sizes(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """Bytes of a texel and of a tile, as arrays of a small world hold them; the pointer's four bytes are nowhere counted."""
    del wanted, progress
    texture = build_world(SMALL_SIDE).texture
    for name, (storage, layout) in {"talk": TALK, "packed": FORMATS["packed"]}.items():
        slots = len(texture.texels) if layout == "packed" else int(np.prod(texture.indirection.cache))
        each = cache_textures(texture, storage, layout).bytes / (27 * slots)
        note = f"{storage}, {layout}: 12 coefficients and a weight"
        yield row_of(f"bytes_per_texel_{name}", each, "B", "lower", 25.0 if name == "talk" else None, note)
        yield row_of(f"bytes_per_tile_{name}", 27 * each, "B", "lower", note="27 texels")


GROUPS = (Group(NAMES, rates), Group(BYTES, sizes))
