"""The indirection clipmap on a device: windows that follow a viewer, kept true while tiles come and go. Host side of clipmap.cl.

Three things happen to it, each a list of small boxes of texels, however large the world: a window moves (the slabs that enter are
written, toroidally), tiles leave (their pages are cleared), tiles arrive (their pages are set). After each, the texels that depend on
it are flattened anew: below a tile of level l those are its own texel, 8 of LOD l + 1, 64 of l + 2 … as far as windows reach.
All goes into one in-order queue.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F64, I32, I64, U32
from .device import OpenDevice, pyopencl_module
from .programs import program
from .windows import check_bits, first_cells, window_bytes, window_log2

_LANES = 64
_BOXES = 8192  # in one launch; with more, whole windows are written


@dataclass(frozen=True, eq=False)
class Entries:
    """Tiles as the clipmap knows them, n of them: level (n,) i32, cell (n, 3) i32 in tiles of their level, pointer (n,) u32: what
    a texel that points to them holds."""

    level: I32
    cell: I32
    pointer: U32

    def take(self, which: npt.NDArray[Any]) -> Entries:
        """Some of them."""
        return Entries(self.level[which], self.cell[which], self.pointer[which])


def pointers(slots: npt.NDArray[np.integer], levels: npt.NDArray[np.integer], shape: I64) -> U32:
    """Texels (n,) that point to slots (n,) of a cache of `shape` (3,) tiles with tiles of `levels` (n,): see
    reference/volume/indirection."""
    slot = slots.astype(np.int64)
    offset = slot % shape[0] | slot // shape[0] % shape[1] << 8 | slot // (shape[0] * shape[1]) << 16
    return np.asarray(offset | levels.astype(np.int64) << 24, dtype=np.uint32)


class Clipmap:
    """Windows of 2^`log2` texels per axis for each LOD. texels, lods: buffers for `launch.Source`. seconds, uploaded: device time
    and bytes to the device since they were last set to 0. first (L, 3) i32: where the windows are, None before the first move."""

    def __init__(
        self, device: OpenDevice, level: int, finest: float, extent: I64, lod_distance: float, shape: I64, slots: int
    ) -> None:
        """For a cache of `slots` tiles, `shape` (3,) of them per axis. Raises InputError as `window_log2` and `check_bits` do."""
        check_bits(shape, level)
        self.level, self.log2 = level, window_log2(lod_distance, finest, extent, device.info.memory, level)
        self._device, self._extent, cl = device, extent, pyopencl_module()
        self.seconds, self.uploaded = 0.0, 0
        self.first: I32 | None = None

        def room(size: int) -> Any:
            return cl.Buffer(device.context, cl.mem_flags.READ_WRITE, size)

        texels = window_bytes(self.log2, level) // 2
        self._pages, self.texels, self.lods = room(texels), room(texels), room(16 * level)
        self._boxes, self._entries = room(32 * _BOXES), room(8 * slots)
        self.bytes = 2 * texels + 16 * level + 32 * _BOXES + 8 * slots
        built = program(device, "clipmap.cl", [])
        self._clear, self._enter, self._flatten = (cl.Kernel(built, name) for name in ("clear", "enter", "flatten"))

    @property
    def side(self) -> int:
        """Texels per axis of each window."""
        return 1 << self.log2

    def move(self, viewer: F64, slots: Entries) -> int:
        """Put the windows around a viewer at `viewer` (3,) finest voxels. slots: what each slot of the cache holds, level 0 for
        nothing. Returns how many LODs moved."""
        new = first_cells(viewer, self._extent, self.level, self.log2)
        old = new - self.side if self.first is None else self.first
        moved = (new != old).any(axis=1)
        if moved.any():
            boxes, anew = self._slabs(old, new)
            resident = slots.take(np.flatnonzero(np.concatenate([[False], moved])[slots.level]))
            came = self._within(resident, new) & (anew[resident.level - 1] | ~self._within(resident, old))
            self.first = new
            self._write(resident.take(came), boxes, lods=np.pad(new, ((0, 0), (0, 1))))
        return int(moved.sum())

    def arrive(self, tiles: Entries) -> None:
        """These tiles are in the cache from now on."""
        self._change(tiles)

    def leave(self, tiles: Entries) -> None:
        """These tiles are no longer in the cache: nothing points to them when this returns."""
        self._change(Entries(tiles.level, tiles.cell, np.zeros_like(tiles.pointer)))

    def _change(self, tiles: Entries) -> None:
        if self.first is None or not len(tiles.level):
            return
        held = tiles.take(self._within(tiles, self.first))
        self._write(held, self._below(tiles))

    def _within(self, tiles: Entries, first: I32) -> npt.NDArray[np.bool_]:
        """Which tiles are in the window of their own level, (n,)."""
        inside = (tiles.cell - first[tiles.level - 1]).astype(np.uint32) < self.side  # what is negative becomes large
        return np.asarray(inside[:, 0] & inside[:, 1] & inside[:, 2])

    def _slabs(self, old: I32, new: I32) -> tuple[I32, npt.NDArray[np.bool_]]:
        """Boxes (b, 7), see `Box` in clipmap.cl, that enter windows which move from `old` (L, 3) to `new`; and which LODs (L,)
        are written whole: those that moved by half a window or more."""
        side, step = self.side, new - old
        whole = np.abs(step).sum(axis=1) * 2 >= side
        boxes = [_box(lod + 1, new[lod], np.full(3, side)) for lod in np.flatnonzero(whole).tolist()]
        for lod in np.flatnonzero(~whole).tolist():
            for axis in np.flatnonzero(step[lod]).tolist():
                first, size = new[lod].copy(), np.full(3, side)
                size[axis] = abs(step[lod, axis])
                if step[lod, axis] > 0:
                    first[axis] += side - size[axis]
                boxes.append(_box(lod + 1, first, size))
        return np.array(boxes, dtype=np.int32).reshape(-1, 7), whole

    def _below(self, tiles: Entries) -> I32:
        """Boxes (b, 7) of the texels that may point to `tiles`, or whole windows where these are more than half of one."""
        assert self.first is not None
        found = []
        for lod in range(int(tiles.level.min()), self.level + 1):
            above = tiles.level <= lod
            finer = (lod - tiles.level[above])[:, None]
            low = np.maximum(tiles.cell[above].astype(np.int64) << finer, self.first[lod - 1])
            high = np.minimum(tiles.cell[above].astype(np.int64) + 1 << finer, self.first[lod - 1] + self.side)
            size = high - low
            seen = (size > 0).all(axis=1)
            if size[seen].prod(axis=1).sum() * 2 >= self.side**3 or seen.sum() * 2 * self.level > _BOXES:
                found.append(self._window(lod))
            else:
                found.append(np.column_stack([np.full(seen.sum(), lod), low[seen], size[seen]]))
        return np.concatenate(found).astype(np.int32)

    def _window(self, lod: int) -> I32:
        assert self.first is not None
        return _box(lod, self.first[lod - 1], np.full(3, self.side))[None]

    def _write(self, entries: Entries, boxes: I32, lods: I32 | None = None) -> None:
        """Enter tiles in their pages and flatten the texels in `boxes` (b, 7); where `lods`, the windows, are new, all other
        pages in the boxes are cleared. Waits: host arrays must outlive the copies that read them."""
        events: list[Any] = []
        kept: list[npt.NDArray[Any]] = []

        def copied(to: Any, array: npt.NDArray[Any]) -> None:
            kept.append(np.ascontiguousarray(array))
            self.uploaded += array.nbytes
            events.append(cl.enqueue_copy(queue, to, kept[-1], is_blocking=False))

        def launched(kernel: Any, items: int, *arguments: Any) -> None:
            size = -(-items // _LANES) * _LANES
            events.append(kernel(queue, (size,), (_LANES,), *arguments))

        cl, queue = pyopencl_module(), self._device.queue
        listed, cells = _started(boxes)
        work = (self._boxes, np.int32(len(listed)), np.int32(cells), np.int32(self.log2), self._pages)
        if cells:
            copied(self._boxes, listed)
        if lods is not None:
            copied(self.lods, lods)
            launched(self._clear, cells, *work)
        if len(entries.level):
            copied(self._entries, np.column_stack([self._places(entries), entries.pointer]).astype(np.uint32))
            launched(self._enter, len(entries.level), self._entries, np.int32(len(entries.level)), self._pages)
        if cells:
            launched(self._flatten, cells, *work, self.texels)
        for event in events:
            event.wait()
        self.seconds += 1e-9 * sum(e.profile.end - e.profile.start for e in events)

    def _places(self, tiles: Entries) -> I64:
        """Where the pages of `tiles` are, (n,)."""
        at = tiles.cell.astype(np.int64) & (self.side - 1)
        return (
            (((tiles.level - 1).astype(np.int64) << self.log2 | at[:, 0]) << self.log2 | at[:, 1]) << self.log2
        ) | at[:, 2]


def _box(lod: int, first: I32, size: npt.NDArray[np.integer]) -> I32:
    return np.array([lod, *first, *size], dtype=np.int32)


def _started(boxes: I32) -> tuple[I32, int]:
    """Boxes (b, 8) with the number of cells before each, and of all."""
    size = boxes[:, 4:7].astype(np.int64).prod(axis=1)
    ends = np.cumsum(size)
    return np.column_stack([boxes, ends - size]).astype(np.int32), int(size.sum())
