"""What of a scene marks which voxels: meshes that probes light, volumes, and geometry that only marks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..datatypes import I64, Mark, Scene
from ..lattice import Grid, distinct
from ..turned import turned_boxes
from .mesh_voxels import closed_voxels, mesh_voxels
from .sampled_side import sampled_side
from .shape_voxels import point_voxels, refuse_many, turned_box_voxels

SHOWN = 5
# A size nearer to half the finest voxel than to the finest voxel itself is one that the octree cannot give.
TOO_FINE = 2.0**-0.5


@dataclass
class Marked:
    """Marks while they are collected: per level 0 … L the sorted keys (N,) i64 of voxels marked at that very level. notes:
    doubts about what asks for them, one sentence each. placed: by level the sorted keys of those to be placed even where no
    surface is near."""

    grid: Grid
    levels: list[I64]
    notes: list[str] = field(default_factory=list)
    placed: dict[int, I64] = field(default_factory=dict)

    @classmethod
    def none(cls, grid: Grid) -> Marked:
        """No marks."""
        return cls(grid, [np.zeros(0, dtype=np.int64) for _ in range(grid.level + 1)])

    @property
    def count(self) -> int:
        """Marks of all levels."""
        return sum(map(len, self.levels))

    def add(self, level: int, found: I64, where: str) -> None:
        """Mark voxels of `level` by key. Raises InputError naming `where` if there are too many in all."""
        self.levels[level] = distinct(np.concatenate([self.levels[level], found]))
        refuse_many(self.count, f"{where} and what is marked before it", self.grid.size(level))


def mark_scene(scene: Scene, grid: Grid, margin: float) -> Marked:
    """Marks of meshes, volumes and marks, each at the level nearest to its probe_size, else the finest.

    margin, m: how far off their surface meshes are sampled; voxels up to there are marked too (`sampled_side`). Raises InputError
    if something asks for more voxels than a bitmap may hold.
    """
    marked = Marked.none(grid)
    asked: list[tuple[str, float]] = []

    def put(where: str, size: float | None, found: Callable[[int], I64]) -> int:
        if size is not None and size < TOO_FINE * grid.wanted:
            asked.append((where, size))
        level = grid.wanted_level if size is None else min(grid.level_for(size), grid.wanted_level)
        keys = found(level)
        marked.add(level, keys, f"{where}.probe_size")
        return len(keys)

    for mesh in scene.meshes:
        if mesh.lit_by_probes:
            at = f"meshes.{mesh.name}"
            corners, reach = sampled_side(scene, mesh, margin)
            put(at, mesh.probe_size, partial(mesh_voxels, corners, grid, reach=reach, where=at))
    volumes = scene.settings.volumes
    boxes = turned_boxes(volumes.values(), scene.settings.scene.rotation)
    for (name, volume), box in zip(volumes.items(), boxes, strict=True):
        at = f"volumes.{name}"
        put(at, volume.probe_size, partial(turned_box_voxels, box, grid, where=at))
    for mark in scene.marks:
        at = f"marks.{mark.name}"
        if put(at, mark.probe_size, partial(mark_voxels, mark, grid, where=at)) == 0:
            marked.notes.append(f"{at}: {missed(grid)}")
    marked.notes += too_fine(grid, asked, "probe_size")
    return marked


def mark_voxels(mark: Mark, grid: Grid, level: int, where: str) -> I64:
    """Sorted keys (N,) of the voxels of `level` that a mark asks for. Raises InputError naming `where` for too many."""
    if mark.kind == "points":
        return point_voxels(mark.vertices, grid, level)
    if mark.kind == "closed":
        return closed_voxels(mark.vertices, mark.faces, grid, level, where)
    return mesh_voxels(mark.vertices[mark.faces], grid, level, None, where)


def missed(grid: Grid) -> str:
    """The end of a sentence about something that marks no voxel."""
    upper = grid.origin + grid.extent * grid.finest
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in (grid.origin, upper))
    return f"marks no voxel, it lies outside of the octree ({low} to {high} m); move it, or check its unit and origin"


def too_fine(grid: Grid, asked: Sequence[tuple[str, float]], what: str) -> list[str]:
    """One note for all (name, size m) in `asked` that are finer than the finest voxel; none where there are none."""
    if not asked:
        return []
    named = ", ".join(f"{where} ({size:g} m)" for where, size in asked[:SHOWN])
    more = f" and {len(asked) - SHOWN} more" if len(asked) > SHOWN else ""
    return [
        f"{what} is finer than the octree's finest voxel in {named}{more}: voxels of {grid.wanted:g} m there; to have them, "
        f"set placement.min_voxel to {min(size for _, size in asked):g}"
    ]
