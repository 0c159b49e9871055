"""The flight itself: frame by frame the viewer moves, the texture streams, and both are asked what they hold.

Each frame is sampled at fixed points of the world, where nothing may change, and at the picture the viewer sees. The picture is sampled
just before and just after the move: what changes there is the pop that the viewer would see.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from ...fastpath.device import OpenDevice
from ...fastpath.streamed import Moved, StreamedTexture
from ...reference.datatypes import F32, F64
from ...reference.progress import Progress
from ...reference.texture_types import Samples, Viewer
from ...reference.volume.sampler import sample
from .change import Lag, Still, jumps
from .paths import Path
from .plan import BLEND
from .reading import Read, Reader, unlike
from .texels import texel_deviation
from .world import World

MOVED = ("wanted", "resident", "loaded", "evicted", "missing", "hits", "bytes", "shifted_lods")


@dataclass(eq=False)
class Flight:
    """What was measured. frames: per name a number a frame. stills: the light at the fixed points, streamed and whole, without
    and with blend. last: per level, (N, 3) f32 what the streamed texture last said at each fixed point where the whole one
    answers with that level, NaN where it never did. lag: how long fixed points wait for their tiles. full (N, 3) f32: the whole
    texture without levels of detail. scale: the mean of that, W·m⁻². squares: in the picture, sums of squared differences by name,
    and of the light, over `terms` values. samples: how many were checked. twin: how far the kernel is from its plain twin at the
    fixed points, told from the last viewer; largest difference over `scale`. texels, held: how far the texels of tiles that are in the
    cache at the end are from the plain filling (see `texels`), and how many they are."""

    points: int
    scale: float
    full: F32
    frames: dict[str, list[float]] = field(default_factory=dict)
    stills: dict[str, Still] = field(default_factory=dict)
    last: dict[int, F32] = field(default_factory=dict)
    lag: Lag | None = None
    squares: dict[str, float] = field(default_factory=dict)
    terms: int = 0
    samples: int = 0
    twin: float = 0.0
    texels: float = 0.0
    held: int = 0

    def note(self, **values: float) -> None:
        """Add one number to each named column."""
        for name, value in values.items():
            self.frames.setdefault(name, []).append(value)


def fly(world: World, device: OpenDevice, texture: StreamedTexture, path: Path, progress: Progress) -> Flight:
    """Move along `path` through `texture`, which holds light already."""
    fixed = Reader(device, world.watched, world.table.origin)
    full = fixed.whole(world, None, 0.0).irradiance
    flight = Flight(fixed.count, max(float(full.mean(dtype=np.float64)), 1e-30), full)
    flight.lag = Lag(fixed.count, flight.scale)
    for name in ("streamed", "streamed_blend", "whole", "whole_blend"):
        flight.stills[name] = Still(fixed.count, flight.scale)
    for k, (position, target) in enumerate(zip(path.positions, path.targets, strict=True)):
        progress("flight", k, len(path.positions))
        seen = Reader(device, world.picture(position, target), position)
        before = [seen.streamed(texture, b) for b in (0.0, BLEND)] if k else None
        moved, seconds = _moved(texture, position, device)
        flight.note(**{name: getattr(moved, name) for name in MOVED})
        flight.note(host_ms=1e3 * seconds, device_ms=1e3 * moved.seconds)
        _fixed(flight, world, texture, fixed, position, moved)
        _seen(flight, world, texture, seen, before, position)
    flight.twin = _apart_from_twin(world, device, path.positions[-1]) / flight.scale
    tiles, held = texture.resident_texels()
    flight.texels, flight.held = texel_deviation(held, world.texture.texels[tiles]), held.shape[0] * held.shape[1]
    progress("flight", len(path.positions), len(path.positions))
    return flight


def _apart_from_twin(world: World, device: OpenDevice, viewer: F64) -> float:
    """Largest difference, W·m⁻², of the kernel to its specification at the fixed points, told from the viewer: on all sides of him."""
    at = world.watched
    lod, way = Viewer(viewer, world.lod_distance), world.scene.settings.sampling.reconstruction
    plain = sample(world.texture, at.positions, at.normals, lod, viewer, way)
    kernel = Reader(device, at, viewer).whole(world, viewer, 0.0)
    return float(np.abs(kernel.irradiance - plain.irradiance).max())


def _moved(texture: StreamedTexture, position: F64, device: OpenDevice) -> tuple[Moved, float]:
    device.queue.finish()
    begin = time.perf_counter()
    moved = texture.move(position)
    device.queue.finish()
    return moved, time.perf_counter() - begin


def _fixed(flight: Flight, world: World, texture: StreamedTexture, fixed: Reader, viewer: F64, moved: Moved) -> None:
    """The fixed points in this frame: changes, wrong reads, falls to the parent, what differs without a reason."""
    plain, blended = fixed.streamed(texture, 0.0), fixed.streamed(texture, BLEND)
    whole, whole_blend = fixed.whole(world, viewer, 0.0), fixed.whole(world, viewer, BLEND)
    pairs = (("streamed", plain), ("streamed_blend", blended), ("whole", whole), ("whole_blend", whole_blend))
    for name, read in pairs:
        flight.stills[name].frame(read.irradiance)
    if flight.lag is not None:
        flight.lag.frame(plain.irradiance, whole.irradiance)
    fell, unexplained = unlike(plain, whole, flight.scale, moved.missing)
    unexplained += unlike(blended, whole_blend, flight.scale, moved.missing)[1]
    flight.samples += 2 * fixed.count
    flight.note(wrong_reads=plain.wrong + blended.wrong, fell=fell, unexplained=unexplained)
    for level in np.unique(whole.level).tolist():
        mine = whole.level == level
        flight.last.setdefault(level, np.full_like(plain.irradiance, np.nan))[mine] = plain.irradiance[mine]


def _seen(
    flight: Flight, world: World, texture: StreamedTexture, seen: Reader, before: list[Read] | None, viewer: F64
) -> None:
    """The viewer's picture in this frame: pops seen, wrong reads, what levels of detail and streaming cost, time of a sample."""
    after = [seen.streamed(texture, b) for b in (0.0, BLEND)]
    reads = [*after, *(before or [])]
    flight.samples += seen.count * len(reads)
    flight.frames["wrong_reads"][-1] += sum(r.wrong for r in reads)
    whole, finest = seen.whole(world, viewer, 0.0), seen.whole(world, None, 0.0)
    fell, unexplained = unlike(after[0], whole, flight.scale, int(flight.frames["missing"][-1]))
    flight.frames["unexplained"][-1] += unexplained
    pops = [jumps(b.irradiance, a.irradiance, flight.scale) for b, a in zip(before or after, after, strict=True)]
    flight.note(
        seen=seen.count, seen_fell=fell, seen_pop=float(pops[0].max(initial=0.0)),
        seen_pop_blend=float(pops[1].max(initial=0.0)), sample_ns=1e9 * after[0].seconds / max(seen.count, 1),
    )  # fmt: skip
    _add(flight, "streaming", after[0].irradiance, whole)
    _add(flight, "lod", whole.irradiance, finest)
    _add(flight, "both", after[0].irradiance, finest)
    flight.squares["light"] = flight.squares.get("light", 0.0) + float(finest.irradiance.sum(dtype=np.float64))
    flight.terms += 3 * seen.count


def _add(flight: Flight, name: str, ours: F32, theirs: Samples) -> None:
    error = ours.astype(np.float64) - theirs.irradiance
    flight.squares[name] = flight.squares.get(name, 0.0) + float((error**2).sum())
