"""Adaptive octree (talk, "Adaptive subdivision", "Placing fewer probes", "Voxel bitmaps").

A voxel is close to surfaces if its parent is, the bitmap holds it, and the harmonic mean distance at one of its corners is
under the threshold, which is relative to the voxel's size. The root is always close. With `placement.touching` a voxel that a
surface lit by probes touches is close whatever its corners see (failure-catalogue C6). Which voxels then exist, and so
where probes stand, is `placement.subdivision` (see subdivision.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..config_placement import PlacementSettings
from ..datatypes import I64, Bool
from ..errors import InputError
from ..lattice import (
    OCTANTS,
    Grid,
    Octree,
    cells,
    child_keys,
    distinct,
    finer_keys,
    index_of,
    keys,
    parent_keys,
    unique_cells,
)
from ..visibility import Geometry
from .addressable import refuse_unaddressable
from .close_voxels import Ask, close_voxels
from .distance import nearer_than
from .subdivision import NOTHING, all_children, corner_keys
from .voxel_bitmap import VoxelBitmap


def build_octree(
    g: Geometry, grid: Grid, bitmap: VoxelBitmap, s: PlacementSettings, seed: int, touched: Sequence[I64] = ()
) -> Octree:
    """Subdivide from the root. touched: per level 0 … L the sorted keys of voxels that are close whatever their corners see.

    Raises InputError if the virtual texture may not address the probes, before any ray is traced, and if more than
    `s.max_probes` would be placed.
    """
    plain = s.subdivision == "plain"
    refuse_unaddressable(grid, bitmap.occupied, plain)
    close = keys(np.zeros((1, 3), dtype=np.int64))
    voxels, far, tested = [close], np.zeros(0, dtype=np.int64), 0
    few = eightfold = NOTHING.plus(corner_keys(grid, 0, close))  # probes of the two schemes
    for level in range(1, grid.level + 1):
        limit = _Limit(grid, s, level, len((eightfold if plain else few).every))
        children = _common(np.sort(child_keys(close)), bitmap.occupied[level])
        eight = all_children(grid, level, distinct(parent_keys(children)))
        eightfold = eightfold.plus(corner_keys(grid, level, eight))
        if plain:
            limit(len(eightfold.every))
            children = _common(children, _holding_finer(bitmap, level))
        asked = close_voxels(children, _given(touched, level, children), far, _ask(g, grid, level, s, seed), limit)
        close, far, tested = children[asked.near], asked.far, tested + asked.corners
        voxels.append(eight if plain else close)
        if not plain:
            few = few.plus(corner_keys(grid, level, close))
            limit(len(few.every))
    corners, level_of = (eightfold if plain else few).corners()
    return Octree(grid, tuple(map(cells, voxels)), corners, level_of, tested, len(eightfold.every))


def uniform_octree(grid: Grid) -> Octree:
    """The uniform grid as the same type: every voxel within the grid's extent, probes at the finest level's corners."""
    voxels = []
    for level in range(grid.level + 1):
        axes = [np.arange(n + 1) for n in grid.last(level)]
        voxels.append(unique_cells(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)))
    corners = unique_cells((voxels[-1][:, None, :] + OCTANTS[None]).reshape(-1, 3))
    levels = np.full(len(corners), grid.level, dtype=np.int32)
    return Octree(grid, tuple(voxels), corners, levels, 0, len(corners))


@dataclass(frozen=True, eq=False)
class _Limit:
    """Refuses more probes than `placement.max_probes`. before: how many there are down to the level above."""

    grid: Grid
    settings: PlacementSettings
    level: int
    before: int

    def __call__(self, count: int) -> None:
        """Raises InputError if `count` probes, or voxels, which never have fewer corners, are too many."""
        if count <= self.settings.max_probes:
            return
        size, above = self.grid.size(self.level), self.grid.size(self.level - 1)
        raise InputError(
            f"placement: voxels of {size:g} m need {count} probes or more, placement.max_probes is {self.settings.max_probes}; "
            f"placement.min_voxel = {above:g}, and no probe_size under it, needs about {self.before}; or raise max_probes"
        )


def _ask(g: Geometry, grid: Grid, level: int, s: PlacementSettings, seed: int) -> Ask:
    """The test of a level's corners."""

    def ask(corners: I64) -> Bool:
        finest = finer_keys(corners, grid.level - level)
        # Rays go by the lattice of placement.min_voxel: levels that a bitmap file adds change no other level's.
        own = finer_keys(corners, max(grid.wanted_level - level, 0))
        limit = s.threshold * grid.size(level)
        return nearer_than(g, grid.corner_positions(cells(finest)), own, limit, s.rays, seed)

    return ask


def _given(touched: Sequence[I64], level: int, voxels: I64) -> Bool:
    """Which voxels, keys (N,) of `level`, are close without a test."""
    return index_of(touched[level], voxels) >= 0 if touched else np.zeros(len(voxels), dtype=np.bool_)


def _holding_finer(bitmap: VoxelBitmap, level: int) -> I64:
    """Sorted keys of the voxels of `level` that can be subdivided: under plain subdivision only they need be known to be close."""
    finer = bitmap.occupied[level + 1] if level + 1 < len(bitmap.occupied) else np.zeros(0, dtype=np.int64)
    return distinct(parent_keys(finer))


def _common(a: I64, b: I64) -> I64:
    """Keys in both of two sorted, distinct sets."""
    return a[index_of(b, a) >= 0]
