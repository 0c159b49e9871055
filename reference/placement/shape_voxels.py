"""Voxels of boxes and of points, and how many voxels may be marked at all."""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I64
from ..errors import InputError
from ..lattice import OCTANTS, Grid, cells, distinct, keys
from ..turned import TurnedBox

MAX_VOXELS = 1 << 24
EDGE = 1e-9  # share of a voxel within which a point lies on a border, and so in the voxels on both sides


def refuse_many(count: int, where: str, size: float, what: str = "voxels") -> None:
    """Raises InputError if `count` voxels of `size`, m, are more than a bitmap may hold; `where` asks for them."""
    if count > MAX_VOXELS:
        raise InputError(
            f"{where}: asks for {count} {what} of {size:g} m, at most {MAX_VOXELS} can be marked; raise its probe_size "
            "(or placement.min_voxel, where it has none)"
        )


def clipped_block(lower: F64, upper: F64, grid: Grid, level: int, widen: float) -> tuple[I64, I64]:
    """First and last voxel (N, 3) of `level` that bounds (N, 3), m from the grid's origin, touch, within the grid.

    widen: share of a voxel by which the bounds are widened. Where they miss the grid, first exceeds last.
    """
    size, last = grid.size(level), grid.last(level)
    begin = np.clip(np.floor(lower / size - widen), 0, last + 1).astype(np.int64)
    end = np.clip(np.floor(upper / size + widen), -1, last).astype(np.int64)
    return begin, end


def box_voxels(lower: F64, upper: F64, grid: Grid, level: int, where: str = "box") -> I64:
    """Sorted keys (N,) of the voxels of `level` that touch a box (3,), (3,) m, within the grid.

    Raises InputError naming `where` if they are more than MAX_VOXELS.
    """
    begin, end = clipped_block((lower - grid.origin)[None], (upper - grid.origin)[None], grid, level, 0.0)
    counts = np.maximum(end - begin + 1, 0)[0]
    refuse_many(int(np.prod(counts.astype(object))), where, grid.size(level))
    axes = [np.arange(a, a + n) for a, n in zip(begin[0], counts, strict=True)]
    return keys(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))


def turned_box_voxels(box: TurnedBox, grid: Grid, level: int, where: str = "box") -> I64:
    """As `box_voxels`, for a box that `scene.rotation` may have turned."""
    found = box_voxels(*box.bounds, grid, level, where)
    if not box.turns:
        return found
    size = grid.size(level)
    return found[box.touches_cubes(grid.origin + (cells(found) + 0.5) * size, 0.5 * size)]


def point_voxels(points: F64, grid: Grid, level: int) -> I64:
    """Sorted keys (N,) of the voxels of `level` that hold a point (P, 3) m; on a border, those on both sides."""
    relative = points - grid.origin
    begin, end = clipped_block(relative, relative, grid, level, EDGE)
    found = []
    for octant in OCTANTS:
        cell = begin + octant
        found.append(distinct(keys(cell[(cell <= end).all(axis=1)])))
    return distinct(np.concatenate(found))
