"""Adaptive octree (talk, "Adaptive subdivision", "Placing fewer probes", "Voxel bitmaps").

A voxel exists if its parent does, it is close to surfaces (harmonic mean distance at a corner under the threshold) and
the bitmap holds it. Probes stand at the corners of existing voxels only: a subdivided voxel places none for children
that are far from everything. The root always exists.
"""

from __future__ import annotations

import numpy as np

from ..config_placement import PlacementSettings
from ..datatypes import F64, I32, I64
from ..errors import InputError
from ..lattice import OCTANTS, Grid, Octree, cells, index_of, keys, unique_cells
from ..visibility import Geometry
from .distance import harmonic_mean
from .voxel_bitmap import VoxelBitmap


def build_octree(g: Geometry, grid: Grid, bitmap: VoxelBitmap, s: PlacementSettings, seed: int) -> Octree:
    """Subdivide from the root.

    Raises InputError if more than `s.max_probes` corners would be placed.
    """
    voxels = [np.zeros((1, 3), dtype=np.int64)]
    known = np.zeros(0, dtype=np.int64)
    distance = np.zeros(0)
    for level in range(1, grid.level + 1):
        children = (2 * voxels[-1][:, None, :] + OCTANTS[None]).reshape(-1, 3)
        children = children[bitmap.holds(level, children)]
        scale = 1 << (grid.level - level)
        corner_keys = keys(((children[:, None, :] + OCTANTS[None]) * scale).reshape(-1, 3))
        fresh = np.setdiff1d(corner_keys, known)
        _refuse_too_many(len(known) + len(fresh), s, grid, level)
        found = harmonic_mean(g, grid.corner_positions(cells(fresh)), s.rays, seed + level)
        known, distance = _insert(known, distance, fresh, found)
        near = distance[index_of(known, corner_keys)].reshape(-1, 8).min(axis=1) < s.threshold * grid.size(level)
        voxels.append(unique_cells(children[near]))
    corners, level_of = _corners(grid, voxels)
    return Octree(grid, tuple(voxels), corners, level_of, len(known))


def uniform_octree(grid: Grid) -> Octree:
    """The uniform grid as the same type: every voxel within the grid's extent, probes at the finest level's corners."""
    voxels = []
    for level in range(grid.level + 1):
        limit = (grid.extent - 1) >> (grid.level - level)
        axes = [np.arange(n + 1) for n in limit]
        voxels.append(unique_cells(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)))
    corners = unique_cells((voxels[-1][:, None, :] + OCTANTS[None]).reshape(-1, 3))
    return Octree(grid, tuple(voxels), corners, np.full(len(corners), grid.level, dtype=np.int32), 0)


def _refuse_too_many(count: int, s: PlacementSettings, grid: Grid, level: int) -> None:
    if count > s.max_probes:
        raise InputError(
            f"placement: level {level} (voxels of {grid.size(level):g} m) needs {count} probes or more, placement.max_probes "
            f"is {s.max_probes}; raise placement.min_voxel ({grid.finest:g} m) or a mesh's probe_size, or max_probes"
        )


def _insert(known: I64, distance: F64, fresh: I64, found: F64) -> tuple[I64, F64]:
    merged = np.concatenate([known, fresh])
    order = np.argsort(merged)
    return merged[order], np.concatenate([distance, found])[order]


def _corners(grid: Grid, voxels: list[I64]) -> tuple[I64, I32]:
    """Distinct corners of all levels on the finest lattice, and the coarsest level of each."""
    every, level_of = [], []
    for level, v in enumerate(voxels):
        scale = 1 << (grid.level - level)
        k = np.unique(keys(((v[:, None, :] + OCTANTS[None]) * scale).reshape(-1, 3)))
        every.append(k)
        level_of.append(np.full(len(k), level, dtype=np.int32))
    unique, first = np.unique(np.concatenate(every), return_index=True)
    return cells(unique), np.concatenate(level_of)[first]
