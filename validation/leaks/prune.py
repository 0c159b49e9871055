"""An edit without the cells that it does not need: taken out group by group, then one by one, as long as nothing leaks for it.

Cells are looked at with the larger voxels that hold them, fine to coarse. Whether a cell is needed is judged by what one bake of the
whole edit says of each voxel (`served`), which costs a millisecond; so all cells can be tried, and at last each of the rest once more:
an edit is *minimal* if every cell that it names, put down to the next larger voxel, lets a place leak that was dark with the whole
edit. Four of a voxel's eight parts can do for all, as they have all its probes; and what holds a finer cell need not be named.
The rest is baked and measured, at places that it was not chosen by too; see `smallest` for what happens where it
leaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import I64, Bool
from ...reference.lattice import NEIGHBOURS, cells, distinct, index_of, keys, parent_keys
from .field import LightField, Places, cells_at
from .served import Served

Cells = dict[int, I64]  # sorted keys by level


@dataclass(frozen=True, eq=False)
class Pruned:
    """cells (N, 3) by level: those to be named, that hold no finer one. minimal: none can be done without, by the model of `served`."""

    cells: Cells
    minimal: bool


def with_holders(by_level: Cells, old: tuple[I64, ...]) -> Cells:
    """Cells (N, 3) by level as keys, with the voxels that hold them, without those that are in the octree of voxels `old` anyway."""
    made: Cells = {}
    held = np.zeros(0, dtype=np.int64)
    for level in range(max(by_level), 0, -1):
        own = keys(by_level[level]) if level in by_level else held[:0]
        held = distinct(np.concatenate([held, own]))
        fresh = held[index_of(keys(old[level]), held) < 0] if level < len(old) else held
        if len(fresh):
            made[level] = fresh
        held = distinct(parent_keys(fresh))
    return made


def stands(table: Served, kept: Cells) -> I64:
    """How many of the cells `kept` have each probe as a corner, (R,); one more where it stands without them."""
    count = table.base.astype(np.int64)
    for level, key in kept.items():
        count += np.bincount(table.probes_of(level, key).ravel(), minlength=len(count))
    return count


def prune(table: Served, whole: Cells, spared: Bool, fixed: Cells) -> Pruned:
    """Take out of `whole`, closed under holders, what no place needs. spared (N,): kinds of places that must not leak; fixed: cells to
    keep."""
    kept, count = dict(whole), stands(table, whole)

    def without(level: int, group: I64) -> I64:
        return count - np.bincount(table.probes_of(level, group).ravel(), minlength=len(count))

    def needed(level: int, group: I64) -> bool:
        return bool((table.leaks(without(level, group) > 0) & spared).any())

    def take(level: int, group: I64) -> None:
        nonlocal count
        if len(group) == 0:
            return
        if not needed(level, group):
            kept[level], count = _without(kept[level], group), without(level, group)
        elif len(group) > 1:
            half = len(group) // 2
            take(level, group[:half])
            take(level, group[half:])

    for level in sorted(whole, reverse=True):
        able = _childless(kept, level)
        take(level, _without(able, fixed.get(level, able[:0])))
    named = {level: _childless(kept, level) for level in sorted(kept)}
    minimal = all(needed(level, key[i : i + 1]) for level, key in named.items() for i in range(len(key)))
    return Pruned({level: cells(key) for level, key in named.items() if len(key)}, minimal)


def around(field: LightField, at: Places, whole: Cells) -> Cells:
    """The cells of `whole` at and beside places: sorted keys by level."""
    found: Cells = {}
    for level, key in whole.items():
        cell = cells_at(field.octree, level, at.positions)
        beside = distinct(keys((cell[:, None, :] + NEIGHBOURS).reshape(-1, 3)))
        found[level] = key[index_of(beside, key) >= 0]
    return found


def joined_cells(a: Cells, b: Cells) -> Cells:
    """Keys by level of both."""
    none = np.zeros(0, dtype=np.int64)
    return {n: distinct(np.concatenate([a.get(n, none), b.get(n, none)])) for n in {*a, *b}}


def _childless(kept: Cells, level: int) -> I64:
    """Cells of `level` that hold no kept cell of the next."""
    return kept[level] if level + 1 not in kept else _without(kept[level], distinct(parent_keys(kept[level + 1])))


def _without(key: I64, gone: I64) -> I64:
    return key[index_of(gone, key) < 0]
