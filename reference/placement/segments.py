"""What a straight segment meets: nothing, a surface to enter by, a surface to leave by (failure-catalogue D6).

Every surface on the way counts, not the nearest alone: a front face is entered, the back of a one-sided or closed surface
is left, a two-sided sheet is passed. Origins stand in the open, so what has been entered once more than left holds the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, I64, Bool
from ..device_arrays import drop_device_cache
from ..visibility import LIFT, Geometry, cast, occluded, to_box, vectors

MAX_CROSSINGS = 16  # a segment that meets more is taken to come out on the other side
SEGMENTS_PER_BATCH = 1 << 19


@dataclass(frozen=True, eq=False)
class Crossings:
    """entered, left (N,) i64: surfaces met from the front and from behind; passed (N,) i64: sheets without an inside."""

    entered: I64
    left: I64
    passed: I64

    @property
    def clear(self) -> Bool:
        """Nothing lies between: (N,)."""
        return np.asarray(self.entered + self.left + self.passed == 0)

    @property
    def through(self) -> Bool:
        """Something is left or passed on the way, so the far side of it is seen by light that cannot be there: (N,)."""
        return np.asarray(self.left + self.passed > 0)

    @property
    def inside(self) -> Bool:
        """The end lies within something, if the origin does not: (N,)."""
        return np.asarray(self.entered > self.left)


def crossings(g: Geometry, origins: F64, ends: F64) -> Crossings:
    """All surfaces between `origins` (N, 3) and `ends` (N, 3), m."""
    counts = np.zeros((3, len(origins)), dtype=np.int64)
    for begin in range(0, len(origins), SEGMENTS_PER_BATCH):
        part = slice(begin, begin + SEGMENTS_PER_BATCH)
        counts[:, part] = _count(g, origins[part], ends[part])
    drop_device_cache()
    return Crossings(*counts)


def seen(g: Geometry, origins: F64, ends: F64) -> Bool:
    """Whether nothing lies between `origins` (N, 3) and `ends` (N, 3), m: `crossings(...).clear` at the price of one ray."""
    import mitsuba as mi

    result = np.ones(len(origins), dtype=np.bool_)
    for begin in range(0, len(origins), SEGMENTS_PER_BATCH):
        part = _at_least_two(np.arange(begin, min(begin + SEGMENTS_PER_BATCH, len(origins))))
        way = (ends[part] - origins[part]) / g.scale
        # Directions as long as the way: the reach is then 1 for all.
        result[part] = ~np.array(occluded(g, to_box(g, origins[part]), vectors(way), mi.Float(1.0)))
    return result


def _at_least_two(rows: I64) -> I64:
    """A single lane would be compiled as a constant, in a kernel of its own."""
    return np.repeat(rows, 2) if len(rows) == 1 else rows


def _count(g: Geometry, origins: F64, ends: F64) -> I64:
    """(3, N) i64: entered, left, passed."""
    counts = np.zeros((3, len(origins)), dtype=np.int64)
    way = ends - origins
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
    start, active = np.zeros(len(origins)), np.flatnonzero(length > 0)
    for _ in range(MAX_CROSSINGS):
        if not len(active):
            return counts
        t, triangle, front = _nearest(g, origins[active] + start[active, None] * direction[active], direction[active])
        met = start[active] + t < length[active]
        active, t, triangle, front = active[met], t[met], triangle[met], front[met]
        sheet = ~g.counts_as_back[triangle]
        for row, kind in enumerate((front & ~sheet, ~front & ~sheet, sheet)):
            counts[row, active[kind]] += 1
        start[active] += t + 4.0 * LIFT * g.scale
    counts[1, active] += 1
    return counts


def _nearest(g: Geometry, origins: F64, directions: F64) -> tuple[F64, I64, Bool]:
    """Distance (N,) m, infinite where nothing is met, triangle (N,) and whether its front is met (N,)."""
    n, rows = len(origins), _at_least_two(np.arange(len(origins)))
    hits = cast(g, to_box(g, origins[rows]), vectors(directions[rows]))
    t, triangle = np.array(hits.t, dtype=np.float64), np.array(hits.triangle).astype(np.int64)
    return np.abs(t[:n]), triangle[:n], np.array(hits.front)[:n]
