"""Whether the virtual texture can address what the voxel bitmap asks for, said before any ray is traced.

The octree lies within the bitmap, so the bitmap's own tiles are the most there can be. The voxel size at which they fit follows
from the same count: the bitmap of a coarser octree is its coarser levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from ..datatypes import I64
from ..errors import InputError
from ..lattice import Grid, distinct, parent_keys
from ..tiling import MAX_INDIRECTION_TEXELS, MAX_TILES, indirection_dims, tile_parents
from .subdivision import all_children

WITHIN_REACH, AROUND_EIGHT = 8, 27  # tiles that one voxel needs at most, and that eight voxels of one parent need


def refuse_unaddressable(grid: Grid, occupied: Sequence[I64], plain: bool) -> None:
    """Raises InputError where there may be more tiles or indirection texels than can be addressed.

    occupied: per level 0 … L the sorted keys of occupied voxels; plain: whether all eight children of a subdivided voxel exist.
    """
    _refuse(grid, indirection_dims(grid).prod(axis=1).tolist(), MAX_INDIRECTION_TEXELS, "texels of indirection")
    if sum(len(k) for k in occupied) * (AROUND_EIGHT if plain else WITHIN_REACH) > MAX_TILES:
        _refuse(grid, tiles_by_level(grid, occupied, plain), MAX_TILES, "tiles")


def tiles_by_level(grid: Grid, occupied: Sequence[I64], plain: bool) -> list[int]:
    """Tiles of levels 1 … L if every occupied voxel were close to surfaces: the most there can be."""
    found = []
    for level in range(1, grid.level + 1):
        voxels = occupied[level]
        if plain:
            voxels = all_children(grid, level, distinct(parent_keys(voxels)))
        found.append(len(tile_parents(grid, level, voxels)))
    return found


def _refuse(grid: Grid, by_level: Sequence[int], most: int, what: str) -> None:
    """Raises InputError if `by_level`, for levels 1 … L, adds up to more than `most`; level 1 alone always fits."""
    totals = list(accumulate(by_level))
    if totals[-1] <= most:
        return
    level, fitting = [(level, total) for level, total in enumerate(totals, start=1) if total <= most][-1]
    if grid.extra and level < grid.level:
        raise InputError(
            f"placement: the bitmap file's smallest cells make voxels of {grid.finest:g} m, which may need {totals[-1]} {what}; "
            f"the virtual texture addresses {most}: cells of {grid.size(level):g} m or more bring that to about {fitting}"
        )
    raise InputError(
        f"placement: voxels of {grid.finest:g} m may need {totals[-1]} {what}, the virtual texture addresses {most}; "
        f"placement.min_voxel = {grid.size(level):g}, and no probe_size under it, brings that to about {fitting}"
    )
