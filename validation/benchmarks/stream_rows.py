"""What streaming costs: samples in worlds of any size and with any number of levels of detail, new light, moving windows, memory.

    tiles_cost_ratio = time a sample in the largest world / in the smallest, same view, same budget, same lod_distance
    lods_cost_ratio  = time a sample with eight levels of detail in the view / with one, same view

Device time throughout; what the host takes beside it are rows of their own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ...fastpath.device import OpenDevice, open_device
from ...fastpath.streamed import StreamedTexture
from ...fastpath.tile_cache import TileCache, Tiles
from ...reference.datatypes import F32, F64
from ...reference.progress import Progress
from ...reference.texture_types import VIRTUAL, TileTable
from .fastpath_peers import DeviceView, on_device
from .fastpath_rows import device_time
from .fastpath_world import World, build_world, grid_of, height, view
from .rows import CannotMeasure, Group, Row, Wanted, row_of
from .timing import interleaved

REPEATS = 15
SIDES = {"1e3": 32, "1e4": 128, "1e5": 360, "1e6": 1024}
WORLD_EYE, WORLD_DISTANCE, WORLD_BUDGET = np.array([-7.0, 3.0, 0.5]), 3.0, 4096
INSIDE = 1e-5  # 0.2 mm of 16 m, where float32 has steps of 0.002 mm
LOD_SIDE, LOD_VIEW, LOD_NEAR, LOD_FAR = 256, 96, 0.55, 44.0  # finest voxels, and m
UPDATE_SIDE, UPDATE_PROBES = 72, 10_000  # 30,000 virtual probes and over 4,000 tiles
FLIGHT_SIDE, FLIGHT_DISTANCE, FLIGHT_BUDGET = 256, 8.0, 2_000
FRAMES, TIME_LIMIT_S = 1_000, 300.0
WORLD_NAMES = ("tiles_cost_ratio_1e6_1e3", *(f"msamples_{name}_tiles" for name in SIDES))
LOD_NAMES = ("lods_cost_ratio_8_1", "msamples_1_lod", "msamples_8_lods")
UPDATE_NAMES = ("update_ms", "update_wall_ms")
SHIFT_NAMES = ("clipmap_shift_ms", "clipmap_shift_worst_ms", "move_ms", "move_wall_ms", "tiles_per_move")
GROWTH_NAMES = ("flythrough_growth_mib", "flythrough_peak_mib", "flythrough_wrong_reads")


def streamed(device: OpenDevice, world: World, eye: F64, lod_distance: float, budget: int) -> StreamedTexture:
    """`world` lit and streamed to a viewer at `eye`. Raises CannotMeasure if the budget does not hold what he wants."""
    found = StreamedTexture(device, world.table, budget, lod_distance)
    found.relight(world.light)
    moved = found.move(eye)
    if moved.missing:
        raise CannotMeasure(f"{moved.missing} of {moved.wanted} tiles wanted are missing with a budget of {budget}")
    return found


def _cost(
    textures: dict[str, StreamedTexture], at: DeviceView, eye: F64, progress: Progress, stage: str
) -> dict[str, F64]:
    """Seconds of a whole view by each, in turn. at: positions from `eye`."""

    def launched(texture: StreamedTexture) -> Callable[[], Any]:
        room = texture.on_device(at.positions, at.normals, anchor=eye)
        return lambda: texture.on_device(at.positions, at.normals, anchor=eye, out=room).event

    tasks = {name: device_time(launched(texture)) for name, texture in textures.items()}
    return interleaved(tasks, REPEATS, progress, stage)


def _from_eye(device: OpenDevice, seen: tuple[F32, F32], eye: F64) -> DeviceView:
    return on_device(device, (seen[0] - eye).astype(np.float32), seen[1])


def _within(seen: tuple[F32, F32], eye: F64) -> tuple[F32, F32]:
    """A view nearer to the eye by INSIDE of the way. What a ray sees where it leaves the world lies on the world's face: there the last
    bit of a position says in which of two voxels it is, pixel by pixel, but not in the smallest world, which ends there. Unmoved, a
    tenth more voxels are read in all others for the same picture."""
    return (eye + (seen[0] - eye) * (1.0 - INSIDE)).astype(np.float32), seen[1]


def worlds(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """The same view in worlds from a thousand to a million tiles."""
    device, textures, tiles = open_device(), {}, {}
    ends = {"tiles_cost_ratio_1e6_1e3": ("1e3", "1e6")}
    needed = {n for n in SIDES if f"msamples_{n}_tiles" in wanted} | {n for k in wanted for n in ends.get(k, ())}
    for name in (n for n in SIDES if n in needed):
        world = build_world(SIDES[name])
        tiles[name] = world.layout.tiles
        textures[name] = streamed(device, world, WORLD_EYE, WORLD_DISTANCE, WORLD_BUDGET)
    seen = _within(view(grid_of(SIDES["1e3"]), WORLD_EYE), WORLD_EYE)
    s = _cost(textures, _from_eye(device, seen, WORLD_EYE), WORLD_EYE, progress, "worlds")
    what = f"finest level up to {WORLD_DISTANCE:g} m, {WORLD_BUDGET} slots, {device.info.name}"
    if {"1e3", "1e6"} <= set(s):
        note = f"{tiles['1e6']} tiles of world against {tiles['1e3']}; the same view of 1080p, {what}"
        yield row_of("tiles_cost_ratio_1e6_1e3", s["1e6"] / s["1e3"], "ratio", "lower", 1.1, note)
    for name in s:
        rate = 1e-6 * len(seen[0]) / s[name]
        yield row_of(f"msamples_{name}_tiles", rate, "M/s", "higher", note=f"{tiles[name]} tiles of world, {what}")


def lods(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """One view with one level of detail and with eight."""
    del wanted
    device, world = open_device(), build_world(LOD_SIDE)
    eye = lod_eye()
    seen = view(grid_of(LOD_VIEW), eye)
    at = _from_eye(device, seen, eye)
    textures = {str(n): streamed(device, world, eye, d, world.layout.tiles) for n, d in ((1, LOD_FAR), (8, LOD_NEAR))}
    used = lods_in_view(seen[0], eye, LOD_NEAR)
    if used != 8 or lods_in_view(seen[0], eye, LOD_FAR) != 1:
        raise CannotMeasure(f"the view uses {used} levels of detail, wanted 8")
    s = _cost(textures, at, eye, progress, "levels of detail")
    note = f"1080p, {world.layout.tiles} tiles; finest level up to {LOD_NEAR:g} m against {LOD_FAR:g} m, {device.info.name}"
    yield row_of("lods_cost_ratio_8_1", s["8"] / s["1"], "ratio", "lower", 1.1, note)
    yield row_of("msamples_1_lod", 1e-6 * len(seen[0]) / s["1"], "M/s", "higher")
    yield row_of("msamples_8_lods", 1e-6 * len(seen[0]) / s["8"], "M/s", "higher")


def lod_eye() -> F64:
    """A viewer 30 cm above the ground: something is near, and the far hills are in sight."""
    return np.array([-9.5, height(-9.5, 1.0) + 0.3, 1.0])


def lods_in_view(positions: F32, eye: F64, lod_distance: float) -> int:
    """How many levels of detail the positions (N, 3) m ask for."""
    away = np.linalg.norm(positions - eye, axis=1)
    return len(np.unique(np.maximum(np.ceil(np.log2(away / lod_distance)), 0.0)))


def update(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """New light for every tile of a world of the size that the talk's game had."""
    del wanted
    device, world = open_device(), build_world(UPDATE_SIDE, sparse=True)
    table, virtual = culled(world, UPDATE_PROBES)
    cache = TileCache(device, table.tiles, "half", "packed", table.used())
    import pyopencl.array

    light = pyopencl.array.to_device(device.queue, world.light)
    cache.relight(light)
    cache.put(all_tiles(table))
    taken: list[tuple[float, float]] = []
    for repeat in range(-1, REPEATS):
        begin = time.perf_counter()
        cache.relight(light)
        if repeat >= 0:
            taken.append((cache.seconds, time.perf_counter() - begin))
        progress("update", repeat + 1, REPEATS)
    on_the_device, wall = 1e3 * np.array(taken).T
    note = f"{UPDATE_PROBES} probes on the device, {virtual} virtual ones, {table.tiles} tiles, packed half, {device.info.name}"
    yield row_of("update_ms", on_the_device, "ms", "lower", 10.0, note)
    yield row_of(
        "update_wall_ms", wall, "ms", "lower", note="the host's part included: brightest light, launches, waiting"
    )


def culled(world: World, probes: int, seed: int = 0) -> tuple[TileTable, int]:
    """The world's tiles with only `probes` valid real probes left, others made virtual at random; and the number of virtual ones.

    Raises ValueError if it has fewer.
    """
    table = world.table
    valid = np.flatnonzero(
        (world.light_from >= 0) & (world.tree.corner_level > 2)
    )  # the coarsest stay: others rest on them
    keep = np.random.default_rng(seed).permutation(valid)
    over = int((world.light_from >= 0).sum()) - probes
    if not 0 <= over <= len(keep):
        raise ValueError(f"expected a world of {probes} valid probes or more, got {len(valid)}")
    gone = np.zeros(len(world.light_from), dtype=np.bool_)
    gone[keep[:over]] = True
    sources = np.where((table.sources >= 0) & gone[np.maximum(table.sources, 0)], VIRTUAL, table.sources)
    return replace(table, sources=sources.astype(np.int32)), world.layout.virtual_probes + over


def all_tiles(table: TileTable) -> Tiles:
    """Every tile of a world, each in the slot of its own number."""
    slot = np.arange(table.tiles, dtype=np.int32)
    return Tiles(slot, table.parent, table.octant, table.tile_level, table.cell, table.sources)


def shift(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """A walk of FRAMES / 10 steps of a tile's width: windows move at every one."""
    del wanted
    device, world = open_device(), build_world(FLIGHT_SIDE)
    texture = StreamedTexture(device, world.table, FLIGHT_BUDGET, FLIGHT_DISTANCE)
    texture.relight(world.light)
    frames, found = FRAMES // 10, []  # of moved.clipmap_seconds, moved.seconds, wall clock, tiles
    for frame in range(frames):
        begin = time.perf_counter()
        moved = texture.move(walk(frame))
        if frame and moved.shifted_lods:
            found.append((moved.clipmap_seconds, moved.seconds, time.perf_counter() - begin, moved.loaded))
        progress("clipmap", frame + 1, frames)
    clipmap, device_time, wall, loaded = np.array(found).T
    note = f"windows of {texture.window}^3 texels, {world.grid.level} levels, and tiles that come and go, {device.info.name}"
    yield row_of("clipmap_shift_ms", 1e3 * clipmap, "ms", "lower", 1.0, note)
    yield row_of("clipmap_shift_worst_ms", 1e3 * clipmap.max(), "ms", "lower", note=f"of {len(found)} shifts")
    yield row_of("move_ms", 1e3 * device_time, "ms", "lower", note="tiles put and lit too")
    yield row_of("move_wall_ms", 1e3 * wall, "ms", "lower", note="the host's part included: which tiles are wanted")
    yield row_of(
        "tiles_per_move", loaded, "tiles", "lower", note=f"{FLIGHT_BUDGET} slots, {world.layout.tiles} tiles of world"
    )


def walk(frame: int) -> F64:
    """Where the viewer is in frame `frame`: (3,) m; a loop of a metre a step, each axis at its own pace."""
    turn = frame / 40.0
    return np.array([40.0 * np.sin(turn), 2.0 + np.sin(0.7 * turn), 40.0 * np.cos(1.3 * turn)])


def growth(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """Memory of a process that flies, from the first lap's end on."""
    del wanted
    progress("fly-through", 0, 1)
    command = [sys.executable, "-m", f"{__package__}.growth_child", str(FRAMES)]
    # glibc's allocator gives large arrays back when they are freed only while this threshold is fixed (mallopt(3)); otherwise what it
    # keeps for later drowns what is really held.
    environment = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "131072"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        raise CannotMeasure(f"{FRAMES} frames in a process of their own took over {TIME_LIMIT_S:g} s") from None
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise CannotMeasure(f"{FRAMES} frames in a process of their own failed ({done.returncode}): {last}")
    found = json.loads(done.stdout.splitlines()[-1])
    progress("fly-through", 1, 1)
    note = f"resident memory after {FRAMES} frames less that before them, {found['loaded']} tiles loaded meanwhile"
    yield row_of("flythrough_growth_mib", found["growth"] / 2**20, "MiB", "lower", 1.0, note)
    yield row_of("flythrough_peak_mib", found["peak"] / 2**20, "MiB", "lower", note="the whole process")
    yield row_of("flythrough_wrong_reads", found["wrong"], "samples", "lower", 0.0, f"of {found['samples']}")


GROUPS = (
    Group(WORLD_NAMES, worlds),
    Group(LOD_NAMES, lods),
    Group(UPDATE_NAMES, update),
    Group(SHIFT_NAMES, shift),
    Group(GROWTH_NAMES, growth),
)
