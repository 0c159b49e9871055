"""Voxels that surfaces lit by probes touch: the second criterion of subdivision (`placement.touching`).

The harmonic mean is blind to what is thin, or stands in the middle of a voxel between its corners: beside a pole of 0.1 m at 2 m, with
walls at 100 m, it reads 62 m, and nothing is subdivided (failure-catalogue C6). A voxel with a surface in it must be close to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..datatypes import I64, Scene
from ..lattice import OCTANTS, Grid, distinct, index_of, keys
from .sampled_side import sampled_side
from .tri_box import CubeTest

# Voxels of this many levels above the coarsest size that any mesh asks for, and coarser ones, only lead down to those: they are
# subdivided wherever a surface touches them. Their corners may all stand outside the scene, and see it from too far.
LEADING_LEVELS = 3


def leading_level(scene: Scene, grid: Grid) -> int:
    """The finest level whose voxels only lead to those that meshes ask for; under 0 where there is none."""
    asked = [m.probe_size or grid.wanted for m in scene.meshes if m.lit_by_probes]
    return grid.level_for(max(asked)) - LEADING_LEVELS if asked else -1


def touched_voxels(scene: Scene, grid: Grid, occupied: Sequence[I64], margin: float, finest: int) -> tuple[I64, ...]:
    """Per level 0 … L the sorted keys of the occupied voxels that a triangle lit by probes touches; none under level `finest`.

    occupied: per level the sorted keys of the bitmap. margin, m: how far off their surface meshes are sampled; the voxels within
    that reach count, as they do in the bitmap. A descent that stays within the bitmap: a triangle costs what is marked along it.
    """
    sides = [sampled_side(scene, m, margin) for m in scene.meshes if m.lit_by_probes]
    nothing = np.zeros(0, dtype=np.int64)
    if not sides or finest < 0:
        return (nothing,) * (grid.level + 1)
    corners = np.concatenate([c for c, _ in sides]) - grid.origin
    test = CubeTest(corners, np.concatenate([reach for _, reach in sides]))
    triangle, cell = np.arange(len(corners)), np.zeros((len(corners), 3), dtype=np.int64)
    found = [distinct(keys(cell))]
    for level in range(1, finest + 1):
        pair, octant = np.nonzero(test(triangle, 2 * cell, grid.size(level)))
        cell, triangle = 2 * cell[pair] + OCTANTS[octant], triangle[pair]
        key = keys(cell)
        marked = index_of(occupied[level], key) >= 0
        cell, triangle = cell[marked], triangle[marked]
        found.append(distinct(key[marked]))
    return (*found, *(nothing,) * (grid.level - finest))
