"""Voxel bitmap: where probes are wanted, and how finely (talk, "Voxel bitmaps").

Every mesh that probes light marks the voxels it touches, every volume the voxels it overlaps, every mark the voxels of its
surface, its inside or its points, each at the level of the resolution it asks for. Limits then hold the marks between
sizes, and the layers of a bitmap file are laid over. A voxel of any level is occupied if it holds a marked voxel of its
own or a finer level; so coarse and fine marks are aligned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..datatypes import I64, Bool, Scene
from ..lattice import Grid, distinct, keys, parent_keys
from .bitmap_layers import apply_layers
from .limits import apply_limits
from .marking import mark_scene


@dataclass(frozen=True, eq=False)
class VoxelBitmap:
    """occupied: per level 0 … L the sorted keys (N,) i64 of occupied voxels. notes: doubts about what marked them, one sentence
    each: something misses the octree, or asks for more than it can give. placed: per level, none without levels, the sorted keys of
    voxels that a file wants placed even where no surface is near, and of those that hold them."""

    occupied: tuple[I64, ...]
    notes: tuple[str, ...] = ()
    placed: tuple[I64, ...] = ()

    def holds(self, level: int, voxels: I64) -> Bool:
        """Whether each voxel (N, 3) of `level` is occupied."""
        return np.isin(keys(voxels), self.occupied[level])


def build_bitmap(scene: Scene, grid: Grid, margin: float) -> VoxelBitmap:
    """Marks of the scene under its limits, its bitmap file laid over. `margin`, m: how far off their surface meshes are
    sampled; the voxels up to there, on the sampled side, are marked too.

    Raises InputError naming the mesh, volume, mark, limit or layer that asks for more voxels than can be marked.
    """
    marked = mark_scene(scene, grid, margin)
    apply_limits(marked, scene.settings.limits, scene.settings.scene.rotation)
    apply_layers(marked, scene.bitmap, scene.settings.placement.bitmap or "")
    occupied = _with_holders(marked.levels)
    none = np.zeros(0, dtype=np.int64)
    placed = _with_holders([marked.placed.get(level, none) for level in range(grid.level + 1)])
    notes = marked.notes
    if not any(map(len, occupied[1:])):
        notes = [*notes, "the voxel bitmap is empty: only the octree's eight outermost probes stand; mark something"]
    return VoxelBitmap(occupied, tuple(notes), placed if marked.placed else ())


def _with_holders(levels: Sequence[I64]) -> tuple[I64, ...]:
    """Per level the voxels given there and those that hold voxels given at finer levels."""
    made: list[I64] = []
    held = np.zeros(0, dtype=np.int64)
    for own in reversed(levels):
        held = distinct(np.concatenate([parent_keys(held), own]))
        made.append(held)
    return tuple(reversed(made))
