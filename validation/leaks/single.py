"""The edit of one place: the one cell that stops the leak there, the largest that does.

What holds a place alone decides what light it gets. So a single cell is enough, if any is, and as cells are tried from large to small,
none larger does: the edit is the smallest one that there is, in cells and in probes. All places' cells of all sizes are baked together,
once; each is judged by its own eight probes.

In the tip of a room's edge that lies askew to the lattice no voxel may do: one that holds the place has no corner in the room, whatever
its size (`tips`). Then it is said how much space the smallest voxel tried leaves so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64, BitmapLayer
from ...reference.errors import InputError
from ...reference.lattice import unique_cells
from .attribution import Leaks
from .field import LightField, Places, cells_at, part, places
from .search import Search, layers_of
from .served import KEEPS, verdicts
from .walls import in_the_open

DEEPER = 4  # levels below placement.min_voxel that are tried
PER_AXIS = 8  # places in the smallest voxel by which the space that it leaves lit is measured


@dataclass(frozen=True, eq=False)
class Single:
    """layer: the cell, None where no voxel stops the leak. tried_m: the smallest voxel that was tried. lit_m3: without a cell, the
    space in that voxel that leaks still, m³, and lit_share of the voxel's open space."""

    layer: BitmapLayer | None
    tried_m: float
    lit_m3: float = 0.0
    lit_share: float = 0.0


def single_edits(search: Search, at: Places, leaks: Leaks, chosen: I64) -> list[Single]:
    """The edit of each of the `chosen` (K,) places. One bake, with all voxels that might serve.

    Fewer levels are tried where the octree does not bear them; with none at all the list is empty.
    """
    grid = search.field.octree.grid
    here = part(at, chosen)
    first = np.minimum(leaks.answers, leaks.holds)[chosen] + 1
    for deepest in range(grid.wanted_level + DEEPER, int(first.min(initial=0)) - 1, -1):
        cells = {level: own_cells(search.field, here, level) for level in range(int(first.min()), deepest + 1)}
        try:
            field = search.rebake(layers_of(grid, {n: unique_cells(c) for n, c in cells.items()}))
        except InputError:  # too deep, or too many probes
            continue
        return _largest(search, field, here, first, cells)
    return []


def own_cells(field: LightField, at: Places, level: int) -> I64:
    """The cells (K, 3) of `level`, which may be finer than the octree is, that hold places."""
    grid = field.octree.grid
    if level <= grid.level:
        return cells_at(field.octree, level, at.positions)
    return np.floor((at.positions - grid.origin) / grid.size(level)).astype(np.int64)


def _largest(search: Search, field: LightField, at: Places, first: I64, cells: dict[int, I64]) -> list[Single]:
    """Of each place's cells, from level `first` (K,) on, the largest that keeps it dark."""
    keeps = {level: verdicts(search, field, at, level)[0] == KEEPS for level in cells}
    grid, deepest = search.field.octree.grid, max(cells)
    found = []
    for i in range(at.count):
        level = next((n for n in sorted(cells) if n >= first[i] and keeps[n][i]), None)
        if level is None:
            found.append(Single(None, grid.size(deepest), *_left(search, field, cells[deepest][i], deepest)))
        else:
            layer = layers_of(grid, {level: cells[level][i : i + 1]})[0]
            found.append(Single(layer, grid.size(deepest)))
    return found


def _left(search: Search, field: LightField, cell: I64, level: int) -> tuple[float, float]:
    """Space in a voxel that it does not keep dark, m³, and as a share of the space in it that it should."""
    grid = field.octree.grid
    strata = np.stack(np.meshgrid(*[(np.arange(PER_AXIS) + 0.5) / PER_AXIS] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    inside: F64 = grid.origin + (cell + strata) * grid.size(level)
    inside = inside[search.wanted(inside)]
    inside = inside[in_the_open(field.geometry, inside)]
    if len(inside) == 0:
        return 0.0, 1.0
    lit = verdicts(search, field, places(inside, None, "between"), level)[0] != KEEPS
    return float(lit.sum() / len(strata) * grid.size(level) ** 3), float(lit.mean())
