"""Which tiles of a world are to be in the cache around a viewer. Nothing here knows of a device.

A tile of level l answers where LOD l or a finer one is asked for, which is up to 2^(L - l) d₀ from the viewer. In tiles of its own edge
that is d₀ / 2h for every level, so one number says how urgent a tile is:

    urgency = distance of its box in its own edges / (d₀ / 2h)         wanted: ≤ 1, and half a tile more, to be there in time

A voxel's size in the picture falls as that number grows: the tile whose absence shows most comes first, coarse before fine where
they are equal. A parent is never less urgent than its child, so the first B tiles in that order always hold their parents,
whatever the budget B; a cache too small for all that is wanted acts as a smaller d₀. A tile that is wanted and resident ranks as
if it were at KEEP times its distance: without that, tiles at the edge of the budget change places with every step. What is no
longer wanted stays until its slot is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F64, I32, I64
from ..reference.errors import InputError
from ..reference.texture_types import MAX_OFFSET, TileTable
from .windows import in_voxels

AHEAD = 0.5  # tiles beyond a LOD's radius that are wanted already
KEEP = 0.9  # a resident tile gives way to one that is a tenth more urgent


def wanted_tiles(table: TileTable, viewer: F64, reach: float) -> tuple[I64, F64]:
    """Tiles (W,) i64, coarse levels first, wanted by a viewer at `viewer` (3,) finest voxels, and how urgent they are (W,).

    reach: d₀ in finest voxels. Descends from the root, which always is, into wanted tiles only: costs as much as it finds.
    """
    root: I64 = np.zeros(1, dtype=np.int64)
    found: list[I64] = [root]
    ranks = [urgency(table, root, viewer, reach)]
    most = (0.5 * reach + AHEAD) / (0.5 * reach)
    while len(found[-1]):
        children = table.children[found[-1]].ravel()
        below = children[children >= 0].astype(np.int64)
        rank = urgency(table, below, viewer, reach)
        near = rank <= most
        found.append(below[near])
        ranks.append(rank[near])
    return np.concatenate(found), np.concatenate(ranks)


def urgency(table: TileTable, tiles: I64, viewer: F64, reach: float) -> F64:
    """Distance (n,) from a viewer at `viewer` to the boxes of `tiles` (n,), in units of the radius up to which their level is
    asked for."""
    smaller = np.exp2(table.tile_level[tiles] - (table.level + 1.0))  # 1 / edge
    below = table.cell[tiles] - viewer * smaller[:, None]
    away = np.maximum(np.maximum(below, -1.0 - below), 0.0)
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", away, away)) / (0.5 * reach))


@dataclass(frozen=True, eq=False)
class Plan:
    """What one move changes. out, out_slots: tiles that go and where they are; into, into_slots: tiles that come, coarse levels
    first, and where to. wanted: tiles wanted; hits: of those, resident before the move; missing: of those, absent after it."""

    out: I64
    out_slots: I32
    into: I64
    into_slots: I32
    wanted: int
    hits: int
    missing: int


class Residency:
    """Who is in which of `budget` slots. `plan` decides, `leave` and `arrive` put on record what was done."""

    def __init__(
        self, table: TileTable, budget: int, reach: float, per_move: int | None = None, keep: float = KEEP
    ) -> None:
        """reach: d₀ in finest voxels; per_move: most tiles that come in one move; keep: see KEEP, 1 for none.

        Raises ValueError for a budget or per_move under 1, a reach not above 0, or a keep outside 0 … 1.
        """
        if budget < 1 or (per_move is not None and per_move < 1) or not reach > 0.0 or not 0.0 < keep <= 1.0:
            raise ValueError(
                f"expected budget ≥ 1, per_move ≥ 1, reach > 0 and keep in 0 … 1, got {budget}, {per_move}, {reach}, {keep}"
            )
        self._table, self._reach, self._per_move, self._keep = table, reach, per_move, keep
        self.slot_of: I32 = np.full(table.tiles, -1, dtype=np.int32)
        self.tile_in: I64 = np.full(budget, -1, dtype=np.int64)

    @property
    def budget(self) -> int:
        """Number of slots."""
        return len(self.tile_in)

    def resident(self) -> tuple[I64, I32]:
        """Tiles (n,) that are in the cache and their slots (n,), by slot."""
        slots = np.flatnonzero(self.tile_in >= 0)
        return self.tile_in[slots], slots.astype(np.int32)

    def plan(self, viewer: F64) -> Plan:
        """What is to change for a viewer at `viewer` (3,) finest voxels."""
        wanted, rank = wanted_tiles(self._table, viewer, self._reach)
        absent = self.slot_of[wanted] < 0
        hits = len(wanted) - int(absent.sum())
        free = np.flatnonzero(self.tile_in < 0).astype(np.int32)
        into, out, others = wanted[absent], np.zeros(0, dtype=np.int64), 0
        if len(into) <= len(free):
            into = into[np.lexsort((into, rank[absent]))]
        else:
            out = self._idle(viewer, wanted[~absent], len(into) - len(free))
            others = len(out)
            if len(into) > len(free) + others:
                into, given = self._exchanged(wanted, rank, absent)
                out = np.concatenate([out, given])
        into = into if self._per_move is None else into[: self._per_move]
        out = out[: max(0, len(into) - len(free))]
        into = np.sort(into)  # tiles are numbered coarse levels first
        slots = np.concatenate([self.slot_of[out], free])[: len(into)]
        lost = max(0, len(out) - others)
        return Plan(out, self.slot_of[out], into, slots, len(wanted), hits, len(wanted) - hits + lost - len(into))

    def _idle(self, viewer: F64, used: I64, count: int) -> I64:
        """Up to `count` resident tiles that are not among the resident ones `used`, least urgent first: children before their
        parents."""
        idle = self.tile_in >= 0
        idle[self.slot_of[used]] = False
        tiles = self.tile_in[idle]
        rank = urgency(self._table, tiles, viewer, self._reach)
        if count < len(tiles):
            last = np.argpartition(rank, len(rank) - count)[len(rank) - count :]
            tiles, rank = tiles[last], rank[last]
        return tiles[np.lexsort((tiles, rank))[::-1]]

    def _exchanged(self, wanted: I64, rank: F64, absent: npt.NDArray[np.bool_]) -> tuple[I64, I64]:
        """Where not all `wanted` have room: those that come, most urgent first, and resident ones that go for them, least urgent
        first."""
        order = np.lexsort((wanted, np.where(absent, rank, self._keep * rank)))
        kept, rest = order[: self.budget], order[self.budget :]
        return wanted[kept[absent[kept]]], wanted[rest[~absent[rest]]][::-1]

    def leave(self, tiles: I64) -> None:
        """These tiles are no longer in the cache."""
        self.tile_in[self.slot_of[tiles]] = -1
        self.slot_of[tiles] = -1

    def arrive(self, tiles: I64, slots: I32) -> None:
        """These tiles are in the cache now, in these slots."""
        self.tile_in[slots] = tiles
        self.slot_of[tiles] = slots


def coarsest_need(table: TileTable, lod_distance: float) -> int:
    """Tiles that every viewer in the world wants, wherever he is: all of the levels up to the coarsest that is asked for, that of the
    world's far corner."""
    across = float(np.linalg.norm(table.extent)) * table.finest
    rings = max(0, math.ceil(math.log2(max(across / lod_distance, 1.0))))
    return int((table.tile_level <= max(1, table.level - rings)).sum())


def check_budget(table: TileTable, budget: int, lod_distance: float, per_move: int | None) -> None:
    """Raises InputError for a budget that cannot work, naming one that does."""
    if not lod_distance > 0.0:
        raise InputError(f"lod_distance must be above 0 m, got {lod_distance}")
    least = coarsest_need(table, lod_distance)
    if budget < least:
        raise InputError(
            f"tile budget {budget}: the coarsest level of detail in use alone needs {least} tiles; give at least that many, or make "
            f"sampling.lod_distance ({lod_distance:g} m) shorter"
        )
    if min(budget, table.tiles) > MAX_OFFSET**3:
        raise InputError(
            f"tile budget {budget}: an indirection texel addresses {MAX_OFFSET**3} tiles; use at most that many"
        )
    if per_move is not None and per_move < 1:
        raise InputError(f"tiles per move: expected at least 1, got {per_move}")


def working_set(table: TileTable, viewer: F64, lod_distance: float) -> int:
    """Tiles that a viewer at `viewer` (3,) m wants: a budget of that many misses nothing there."""
    at = in_voxels(viewer, table.origin, table.finest)
    return len(wanted_tiles(table, at, lod_distance / table.finest)[0])
