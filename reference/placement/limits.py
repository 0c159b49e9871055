"""Limits: boxes in which voxels are held between two sizes, whatever marks ask for there.

With `finest`: no occupied voxel smaller than it overlaps the box. Marks give way to their ancestors of the finest allowed size
where an ancestor half that large overlaps the box, so marks less than half that size outside of it may give way too. With
`coarsest`: every point of the box that lies in a marked voxel lies in a marked voxel of at most that size. Voxels that
cross the border are split, and only those of their parts that overlap the box are marked so finely. Both sizes are
strict: of the octree's sizes the nearest on the safe side is taken; if none lies between the two, `finest` holds.

Limits work on marks, one after another in the order of the scene file, before the bitmap file is laid over. An octree
subdivides where a voxel is marked *and* close to surfaces, so it may stay coarser than `coarsest` in the open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..config_base import Vec3
from ..config_placement import LimitSettings
from ..datatypes import I64, Bool
from ..lattice import Grid, cells, child_keys, distinct, parent_keys
from ..turned import TurnedBox, turned_boxes
from .marking import Marked
from .shape_voxels import refuse_many

HAIR = 1e-6  # in octaves for sizes, in voxels for borders: what rounding may do to a size or a border on the lattice


def apply_limits(marked: Marked, limits: Mapping[str, LimitSettings], rotation: float | Vec3) -> None:
    """Hold the marks between the sizes of each limit, in order; `scene.rotation` turns their boxes. Raises InputError for too
    many voxels."""
    for (name, limit), box in zip(limits.items(), turned_boxes(limits.values(), rotation), strict=True):
        where = f"limits.{name}"
        if not any(overlapping(marked.grid, n, k, box).any() for n, k in enumerate(marked.levels)):
            marked.notes.append(f"{where}: nothing is marked in it, so it changes nothing; move it or remove it")
            continue
        top, bottom = allowed_levels(marked, limit, where)
        if limit.finest is not None:
            _coarsen(marked, box, bottom, where)
        if limit.coarsest is not None:
            _refine(marked, box, top, where)


def allowed_levels(marked: Marked, limit: LimitSettings, where: str) -> tuple[int, int]:
    """The coarsest and the finest level that a limit allows, 0 … L; notes where the octree has no such size."""
    grid = marked.grid
    top, bottom = 0, grid.level
    if limit.finest is not None:
        bottom = min(max(math.floor(grid.level - math.log2(limit.finest / grid.finest) + HAIR), 0), grid.level)
    if limit.coarsest is not None:
        top = max(math.ceil(grid.level - math.log2(limit.coarsest / grid.finest) - HAIR), 0)
        if top > grid.wanted_level:
            marked.notes.append(
                f"{where}.coarsest: {limit.coarsest:g} m is finer than the octree's finest voxel: voxels of {grid.wanted:g} m "
                f"there; to have them, set placement.min_voxel to {limit.coarsest:g}"
            )
            top = grid.wanted_level
    if top > bottom:
        marked.notes.append(
            f"{where}: no voxel size of the octree lies between finest {limit.finest:g} and coarsest {limit.coarsest:g} m, so "
            f"voxels are {grid.size(bottom):g} m there; octree sizes are {grid.finest:g} m times powers of two"
        )
        top = bottom
    return top, bottom


def overlapping(grid: Grid, level: int, key: I64, box: TurnedBox) -> Bool:
    """Which voxels of `level`, by key (N,), share more than their border with a box."""
    size = grid.size(level)
    lower, upper = box.bounds
    begin = np.floor((lower - grid.origin) / size + HAIR)
    end = np.ceil((upper - grid.origin) / size - HAIR) - 1.0
    c = cells(key)
    # A box thinner than the hair still lies in the voxel that holds it.
    near: Bool = np.asarray(((c >= np.minimum(begin, end)) & (c <= np.maximum(begin, end))).all(axis=1))
    if box.turns:
        near[near] = box.touches_cubes(grid.origin + (c[near] + 0.5) * size, 0.5 * size * (1.0 - HAIR))
    return near


def _coarsen(marked: Marked, box: TurnedBox, bottom: int, where: str) -> None:
    for level in range(bottom + 1, marked.grid.level + 1):
        key = marked.levels[level]
        # A voxel one level too fine is occupied wherever something finer in it is marked, inside the box or not.
        hit = overlapping(marked.grid, bottom + 1, _ancestors(key, level - bottom - 1), box)
        marked.levels[level] = key[~hit]
        marked.add(bottom, _ancestors(key[hit], level - bottom), where)


def _refine(marked: Marked, box: TurnedBox, top: int, where: str) -> None:
    grid = marked.grid
    inside = np.zeros(0, dtype=np.int64)
    for level in range(top + 1):
        inside = distinct(np.concatenate([inside, marked.levels[level]]))
        inside = inside[overlapping(grid, level, inside, box)]
        if level < top:
            refuse_many(8 * len(inside), f"{where}.coarsest", grid.size(level + 1))
            child = child_keys(inside)
            inside = child[(cells(child) <= grid.last(level + 1)).all(axis=1)]
    marked.add(top, inside, f"{where}.coarsest")


def _ancestors(key: I64, levels: int) -> I64:
    """Keys of the voxels `levels` up that hold the voxels `key`; some may repeat."""
    for _ in range(levels):
        key = parent_keys(key)
    return key
