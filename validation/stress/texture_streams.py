"""What cases E6 … E8 measure: bits of the indirection texel, a cache that overflows on an orbit, windows that move."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from ...fastpath.clipmap import Clipmap, pointers
from ...fastpath.device import pyopencl_module
from ...fastpath.residency import Plan, working_set
from ...fastpath.streamed import StreamedTexture
from ...fastpath.windows import check_bits
from ...reference.datatypes import F32, F64, I32, Bool
from ...reference.errors import InputError
from ...reference.texture_types import Samples, Viewer, cache_shape
from ...reference.volume.clipmap import sample_resident, window_texels
from ...reference.volume.indirection import pack, slot_offset
from ...reference.volume.sampler import sample
from .case import Reading
from .texture_worlds import World, device, random_world, units
from .trees import random_tree

LEVELS, SHARE, INVALID = 6, 0.4, 0.33
REACH = 6.0  # m: the finest level serves up to there
MIDDLE = np.array([30.7, 33.1, 31.9])
ANCHOR = np.zeros(3)
FRAMES, RADIUS = 24, 3.0
POINTS = 2000
BLEND = 0.25
DIRECTIONS = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, 1.0, 1.0]])


def bit_budget(most: float, seed: int) -> Mapping[str, Reading]:
    """E6: an offset, a level, a cache and a clipmap that need numbers up to `most`; 1 where that is refused. And how far off the
    tile is that a texel packed without a check names."""
    number = round(most)
    beside = np.array([3, seed % 200, 7], dtype=np.int64)
    offsets = [np.where(np.arange(3) == axis, number, beside)[None] for axis in range(3)]
    shape = np.array([number + 1, 2, 2], dtype=np.int64)
    slot = np.array([number], dtype=np.int64)
    texel = int(pointers(slot, np.array([1]), shape)[0])
    kept = 0
    if number < 256:
        texels = pack(slot_offset(slot, shape), min(number, 255))
        kept = abs(int(texels[0] & 255) - number) + abs(int(texels[0] >> 24) - number)
        for offset in offsets:
            texel_of = int(pack(offset, 1)[0])
            kept += sum(abs((texel_of >> 8 * axis & 255) - int(offset[0, axis])) for axis in range(3))
    return {
        "offset": Reading(min(_refused(lambda o=o: pack(o, 1)).value for o in offsets)),  # type: ignore[misc]
        "level": _refused(lambda: pack(np.zeros((1, 3), np.int64), number)),
        "tiles": _refused(lambda: cache_shape((number + 1) ** 3)),
        "clipmap, tiles": _refused(lambda: check_bits(shape, 1)),
        "clipmap, levels": _refused(lambda: check_bits(np.ones(3, np.int64), number)),
        "read back": Reading(float(kept)),
        "without a check": Reading(float(abs((texel & 255) - number))),
    }


def _refused(act: Callable[[], object]) -> Reading:
    try:
        act()
    except (ValueError, InputError):
        return Reading(1.0)
    return Reading(0.0)


@cache
def _world(seed: int) -> World:
    return random_world(random_tree(LEVELS, SHARE, [seed, 1]), INVALID, seed)


class _Forgetful(StreamedTexture):
    """Without the fix: what points to tiles that leave stays as it is."""

    def _leave(self, plan: Plan) -> None:
        if len(plan.out):
            self._residency.leave(plan.out)
            self._in_slot.level[plan.out_slots] = 0


def _streamed(w: World, budget: int, kind: type[StreamedTexture] = StreamedTexture) -> StreamedTexture:
    made = kind(device(), w.table, budget, REACH, storage="float32", check_owners=True)
    made.relight(w.light)
    return made


def _points(seed: int) -> tuple[F64, F32]:
    """Half of them all over the world, half near its middle."""
    rng = np.random.default_rng([seed, 20])
    p = np.concatenate([rng.uniform(0.0, 64.0, (POINTS // 2, 3)), MIDDLE + rng.normal(size=(POINTS // 2, 3)) * REACH])
    return np.clip(p, 0.0, 64.0), units(POINTS, seed)


def _read(texture: StreamedTexture, p: F64, n: F32, blend: float = 0.0) -> Samples:
    """Positions count from one anchor whoever looks: from the viewer, single precision would round them anew at every step."""
    got = texture(p, n, anchor=ANCHOR, blend=blend)
    assert isinstance(got, Samples)
    return got


def overflow(ratio: float, seed: int) -> Mapping[str, Reading]:
    """E7: two rounds of an orbit with a cache that holds 1 / `ratio` of the tiles wanted at its middle; of the second: evictions per
    frame over the cache's tiles, and samples that a coarser tile answered. Wrong reads in both."""
    w = _world(seed)
    budget = max(1, round(working_set(w.table, MIDDLE, REACH) / ratio))
    texture, forgetful = _streamed(w, budget), _streamed(w, budget, _Forgetful)
    p, n = _points(seed)
    wrong = stale = evicted = fell = unlike = compared = 0
    for frame in range(2 * FRAMES):
        angle = 2.0 * math.pi * frame / FRAMES
        viewer = MIDDLE + RADIUS * np.array([math.cos(angle), 0.3 * math.sin(2.0 * angle), math.sin(angle)])
        moved = texture.move(viewer)
        forgetful.move(viewer)
        got = _read(texture, p, n)
        wrong += texture.wrong_reads
        _read(forgetful, p, n)
        stale += forgetful.wrong_reads
        if frame < FRAMES:
            continue
        evicted += moved.evicted
        fell += int((got.level < sample(w.texture, p, n, Viewer(viewer, REACH), ANCHOR).level).sum())
        if frame % 8 == 0:
            held = texture.resident_tiles().tolist()
            plain = sample_resident(w.texture, held, p, n, Viewer(viewer, REACH), ANCHOR)
            apart = np.abs(got.irradiance - plain.irradiance).max(axis=1) > 1e-5 * np.abs(plain.irradiance).max()
            unlike, compared = unlike + int((apart | (got.level != plain.level)).sum()), compared + POINTS
    reads = FRAMES * POINTS
    return {
        "wrong reads": Reading(float(wrong), 0.0, 2 * reads),
        "unlike the plain twin": Reading(unlike / compared, 0.0, compared),
        "evictions": Reading(evicted / FRAMES / budget, 0.0, FRAMES),
        "answered by a parent": Reading(fell / reads, 0.0, reads),
        "wrong reads, pointers kept": Reading(float(stale), 0.0, 2 * reads),
    }


def stale_texels(texture: StreamedTexture, w: World) -> int:
    """Texels of the windows that differ from a build from nothing."""
    clipmap, (tiles, slots) = texture._clipmap, texture._residency.resident()
    assert clipmap.first is not None
    held = np.empty((w.table.level, *[texture.window] * 3), dtype=np.uint32)
    pyopencl_module().enqueue_copy(device().queue, held, clipmap.texels)
    by_tile = dict(zip(tiles.tolist(), slots.tolist(), strict=True))
    first = clipmap.first.astype(np.int64)
    return int((held != window_texels(w.table, by_tile, texture.lattice.cache, first, texture.window)).sum())


class _Lazy(Clipmap):
    """Without the fix: windows move, and what enters them is not written."""

    def _slabs(self, old: I32, new: I32) -> tuple[I32, Bool]:
        boxes, whole = super()._slabs(old, new)
        return (boxes if (old == new - self.side).all() else boxes[:0]), whole


def shift(step: float, seed: int) -> Mapping[str, Reading]:
    """E8: the viewer steps `step` finest voxels, along an axis, back along another and along the diagonal, all tiles resident."""
    w = _world(seed)
    texture, lazy = _streamed(w, w.table.tiles), _streamed(w, w.table.tiles)
    lazy._clipmap.__class__ = _Lazy
    p, n = _points(seed)
    reach = _levels(w, seed)
    found: dict[str, list[float]] = {name: [] for name in ("stale", "lazy", "same", "pop", "blended")}
    for direction in DIRECTIONS:
        before: list[Samples] = []
        after: list[Samples] = []
        for viewer in (MIDDLE, MIDDLE + step * direction / np.linalg.norm(direction)):
            texture.move(viewer)
            lazy.move(viewer)
            before, after = after, [_read(texture, p, n), _read(texture, p, n, BLEND)]
        found["stale"].append(stale_texels(texture, w))
        found["lazy"].append(stale_texels(lazy, w))
        jump = [np.abs(b.irradiance - a.irradiance) for b, a in zip(before, after, strict=True)]
        stayed = before[0].level == after[0].level
        found["same"].append(float((jump[0][stayed] != 0.0).any(axis=1).mean()))
        found["pop"].append(float((jump[0] / reach).max()))
        found["blended"].append(float((jump[1] / reach).max()))
    worst = {name: Reading(max(values), 0.0, len(DIRECTIONS) * POINTS) for name, values in found.items()}
    names = (
        "stale texels",
        "stale texels, slabs not written",
        "changed without a change of level",
        "pop",
        "pop, blended",
    )
    return dict(zip(names, worst.values(), strict=True))


@cache
def _levels(w: World, seed: int) -> F64:
    """Spread (N, 3) of the irradiance at the points over all levels of detail, W·m⁻²."""
    p, n = _points(seed)
    each = np.stack([sample(w.texture, p, n, lod).irradiance for lod in range(1, w.table.level + 1)])
    return np.asarray((each.max(axis=0) - each.min(axis=0)).astype(np.float64) + 1e-6)
