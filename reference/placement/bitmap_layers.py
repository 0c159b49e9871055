"""Layers of a bitmap file on the octree's lattice.

"add": a cell marks every voxel of the level nearest to its size that it overlaps, so exactly one where the lattices agree.
"place": the same, and these voxels are placed even where no surface is near.
"remove": a marked or placed voxel of that level or finer that the layer's cells cover wholly is so no more; coarser marks stay. On a
lattice that is not deep enough for them, small cells mark voxels of the finest size, and remove nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..datatypes import F64, I64, BitmapLayer, Bool
from ..lattice import Grid, cells, distinct, index_of, keys
from .marking import TOO_FINE, Marked, missed, too_fine
from .shape_voxels import refuse_many

# Share of a voxel by which a cell's border may be off a voxel's and still counts as on it.
HAIR = 1e-6


def apply_layers(marked: Marked, layers: Sequence[BitmapLayer], name: str) -> None:
    """Lay the layers of the file `name` over the marks, first to last. Raises InputError for too many voxels."""
    grid = marked.grid
    fine: list[tuple[str, float]] = []
    for i, layer in enumerate(layers):
        where = f"placement.bitmap {name}: layers[{i}]"
        level = grid.level_for(layer.size)
        if layer.size < TOO_FINE * grid.finest:
            fine.append((f"layers[{i}]", layer.size))
        found = cell_voxels(layer, grid, level, where)
        if len(found) == 0:
            marked.notes.append(f"{where}: {missed(grid) if len(layer.cells) else 'has no cells'}")
        elif layer.mode in ("add", "place"):
            marked.add(level, found, where)
            if layer.mode == "place":
                marked.placed[level] = distinct(np.concatenate([marked.placed.get(level, found[:0]), found]))
        elif layer.size >= TOO_FINE * grid.finest:
            _remove(marked, layer, level)
    marked.notes += too_fine(grid, fine, f"placement.bitmap {name}: the cell size")


def cell_voxels(layer: BitmapLayer, grid: Grid, level: int, where: str) -> I64:
    """Sorted keys (N,) of the voxels of `level` that the layer's cells overlap, within the grid."""
    size, last = grid.size(level), grid.last(level)
    lower = (layer.origin - grid.origin) + layer.cells * layer.size
    begin = np.floor(lower / size + HAIR)
    end = np.maximum(np.ceil((lower + layer.size) / size - HAIR) - 1.0, begin)
    first = np.clip(begin, 0, last + 1).astype(np.int64)
    after = np.clip(end, -1, last).astype(np.int64)
    reach = (after - first).max(axis=0, initial=0)
    found = [np.zeros(0, dtype=np.int64)]
    for offset in np.ndindex(*(reach + 1)):
        cell = first + np.array(offset)
        found.append(distinct(keys(cell[(cell <= after).all(axis=1)])))
        refuse_many(sum(map(len, found)), where, size)
    return distinct(np.concatenate(found))


def _remove(marked: Marked, layer: BitmapLayer, level: int) -> None:
    for depth in range(level, marked.grid.level + 1):
        key = marked.levels[depth]
        marked.levels[depth] = key[~covered(layer, marked.grid, depth, key)]
        placed = marked.placed.get(depth)
        if placed is not None:
            marked.placed[depth] = placed[~covered(layer, marked.grid, depth, placed)]


def covered(layer: BitmapLayer, grid: Grid, level: int, key: I64) -> Bool:
    """Which voxels of `level`, by key (N,), the layer's cells cover wholly. The voxels are at most √2 times as large."""
    size = grid.size(level)
    # Cells are counted from the one at the grid's corner: those that can matter then have small indices.
    corner: F64 = np.floor((grid.origin - layer.origin) / layer.size)
    reach = np.ceil(grid.extent * grid.finest / layer.size) + 2.0
    near = layer.cells - corner
    held = distinct(keys(near[((near >= 0) & (near <= reach)).all(axis=1)].astype(np.int64)))
    lower = (grid.origin - layer.origin) / layer.size - corner + cells(key) * (size / layer.size)
    first = np.floor(lower + HAIR).astype(np.int64)
    after = np.ceil(lower + size / layer.size - HAIR).astype(np.int64) - 1
    whole = np.ones(len(key), dtype=np.bool_)
    for offset in np.ndindex(*((after - first).max(axis=0, initial=0) + 1)):
        cell = first + np.array(offset)
        asked = (cell <= after).all(axis=1)
        whole[asked] &= index_of(held, keys(cell[asked])) >= 0
    return whole
