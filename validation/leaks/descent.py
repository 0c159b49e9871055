"""Which parts of a voxel must be finer so that no light comes through: a descent by geometry alone, before anything is baked.

A voxel lets light in if a probe at one of its corners would see the light on the far side of the wall while some place in
the voxel does not see that corner. Such a voxel is cut in eight; of the eight those matter that hold places to be kept
dark, and of these each is judged in the same way. As voxels of h ≤ t / (|nx| + |ny| + |nz|) do not reach through a wall, the
descent ends there at the latest, and where the lattice happens to lie well it ends earlier.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64, Bool
from ...reference.lattice import OCTANTS, Grid, keys, unique_cells
from ...reference.visibility import Geometry, cast, to_box, vectors
from .attribution import NEARLY

# Where in a voxel places are tried, (64, 3): its corners, for what is furthest behind a wall lies there, and between.
ALONG = np.array([1e-3, 1.0 / 3.0, 2.0 / 3.0, 1.0 - 1e-3])
TRIED = np.stack(np.meshgrid(ALONG, ALONG, ALONG, indexing="ij"), axis=-1).reshape(-1, 3)
MOST_HIDDEN = 8  # places of a voxel that its corners are held against

Wanted = Callable[[F64], Bool]  # which positions (N, 3) m are to be kept dark


@dataclass(frozen=True, eq=False)
class Offenders:
    """Voxels of one level through which light leaks. cells (N, 3); lit (N, K, 3) m: probes that the light of each comes from.
    leaking (N', 3) m: places found to leak in them. deepest (N,): the finest level that may be asked for. dead: they leak since
    none of their own probes is valid, so that a larger voxel answers; then their parts are needed whatever their corners see."""

    level: int
    cells: I64
    lit: F64
    leaking: F64
    deepest: I64
    dead: bool


def finer_cells(g: Geometry, grid: Grid, offenders: Offenders, wanted: Wanted) -> dict[int, I64]:
    """Cells (N, 3) by level that must become voxels to stop what leaks."""
    found: dict[int, I64] = {}
    level = offenders.level
    may = offenders.deepest > level
    leaking, lit, deepest = offenders.cells[may], offenders.lit[may], offenders.deepest[may]
    while len(leaking):
        level += 1
        size = grid.finest * 2.0 ** (grid.level - level)  # finer than the grid's own finest, perhaps
        children = (2 * leaking[:, None, :] + OCTANTS).reshape(-1, 3)
        lit, deepest = np.repeat(lit, len(OCTANTS), axis=0), np.repeat(deepest, len(OCTANTS))
        tried = grid.origin + (children[:, None, :] + TRIED) * size
        hidden = _hidden(g, tried, lit, wanted)
        at_leak = keys(np.floor((offenders.leaking - grid.origin) / size).astype(np.int64))
        needed = hidden.any(axis=1) | np.isin(keys(children), at_leak)
        children, lit, deepest = children[needed], lit[needed], deepest[needed]
        if len(children) == 0:
            break
        found[level] = unique_cells(children)
        if offenders.dead:
            break
        corners = grid.origin + (children[:, None, :] + OCTANTS) * size
        again = _reached(g, corners, tried[needed], hidden[needed], lit) & (deepest > level)
        leaking, lit, deepest = children[again], lit[again], deepest[again]
    return found


def _hidden(g: Geometry, tried: F64, lit: F64, wanted: Wanted) -> Bool:
    """Which places (N, T, 3) m are in the open, to be kept dark, and hidden from one of their probes `lit` (N, K, 3): (N, T)."""
    flat = tried.reshape(-1, 3)
    chosen = np.flatnonzero(wanted(flat))
    hidden = np.zeros(len(flat), dtype=np.bool_)
    for probe in np.moveaxis(lit, 1, 0):
        _, in_open, blocked = sight(g, flat[chosen], np.repeat(probe, tried.shape[1], axis=0)[chosen])
        hidden[chosen] |= in_open & blocked
    return hidden.reshape(tried.shape[:2])


def _reached(g: Geometry, corners: F64, tried: F64, hidden: Bool, lit: F64) -> Bool:
    """Which voxels have a corner (N, 8, 3) that sees one of its probes `lit` and is not seen by a hidden place: (N,)."""
    flat = corners.reshape(-1, 3)
    sees = np.zeros(len(flat), dtype=np.bool_)
    for probe in np.moveaxis(lit, 1, 0):
        seen, _, _ = sight(g, flat, np.repeat(probe, len(OCTANTS), axis=0))
        sees |= seen
    rank = np.cumsum(hidden, axis=1)
    some = hidden & (rank % (1 + rank[:, -1:] // MOST_HIDDEN) == 0)  # spread over them
    voxel, corner, place = np.nonzero(sees.reshape(-1, len(OCTANTS))[:, :, None] & some[:, None, :])
    _, _, blocked = sight(g, tried[voxel, place], corners[voxel, corner])
    return np.bincount(voxel, blocked, len(corners)) > 0


def sight(g: Geometry, start: F64, end: F64) -> tuple[Bool, Bool, Bool]:
    """Three answers for segments (M, 3) to (M, 3) m: nothing lies between and the start is in the open; the start is in the
    open; something lies between."""
    if len(start) == 0:
        none = np.zeros(0, dtype=np.bool_)
        return none, none, none
    if len(start) == 1:  # a single lane would be compiled as a constant, in a kernel of its own
        seen, in_open, blocked = sight(g, np.repeat(start, 2, axis=0), np.repeat(end, 2, axis=0))
        return seen[:1], in_open[:1], blocked[:1]
    way = end - start
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
    hits = cast(g, to_box(g, start), vectors(direction))
    hit, face = np.array(hits.hit), np.array(hits.triangle).astype(np.int64)
    from_inside = hit & ~np.array(hits.front) & g.counts_as_back[face]
    blocked = hit & (np.array(hits.t, dtype=np.float64) < NEARLY * length)
    return ~blocked & ~from_inside, ~from_inside, blocked
