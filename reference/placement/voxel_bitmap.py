"""Voxel bitmap: where probes are wanted, and how finely (talk, "Voxel bitmaps").

Every mesh that probes light marks the voxels it touches, every volume the voxels it overlaps, each at the level of
the resolution it asks for. A voxel of any level is occupied if it holds a marked voxel of its own or a finer level;
so coarse and fine marks are aligned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, I64, Mesh, Scene
from ..lattice import NEIGHBOURS, OCTANTS, Grid, keys, unique_cells


@dataclass(frozen=True, eq=False)
class VoxelBitmap:
    """occupied: per level 0 … L the sorted keys (N,) i64 of occupied voxels."""

    occupied: tuple[I64, ...]

    def holds(self, level: int, voxels: I64) -> np.ndarray:
        """Whether each voxel (N, 3) of `level` is occupied."""
        return np.isin(keys(voxels), self.occupied[level])


def build_bitmap(scene: Scene, grid: Grid, margin: float) -> VoxelBitmap:
    """Mark meshes lit by probes and volumes. `margin`, m: how far off their surface meshes are sampled; the voxels
    within that reach are marked too."""
    marks: list[list[I64]] = [[] for _ in range(grid.level + 1)]
    for mesh in scene.meshes:
        if mesh.lit_by_probes:
            level = grid.level_for(mesh.probe_size or grid.finest)
            marks[level].append(mesh_voxels(mesh, grid, level, margin))
    for volume in scene.settings.volumes.values():
        level = grid.level_for(volume.probe_size or grid.finest)
        marks[level].append(box_voxels(np.asarray(volume.min), np.asarray(volume.max), grid, level))
    occupied: list[I64] = []
    inherited = np.zeros((0, 3), dtype=np.int64)
    for level in range(grid.level, -1, -1):
        inherited = unique_cells(np.concatenate([inherited >> 1, *marks[level]]))
        limit = (grid.extent - 1) >> (grid.level - level)
        inherited = inherited[((inherited >= 0) & (inherited <= limit)).all(axis=1)]
        occupied.append(keys(inherited))
    return VoxelBitmap(tuple(reversed(occupied)))


def box_voxels(lower: F64, upper: F64, grid: Grid, level: int) -> I64:
    """Voxels (N, 3) of `level` that overlap a box (3,), (3,) m, clipped to the grid."""
    size = grid.size(level)
    limit = (grid.extent - 1) >> (grid.level - level)
    first = np.clip(np.floor((lower - grid.origin) / size), 0, limit + 1).astype(np.int64)
    last = np.clip(np.floor((upper - grid.origin) / size), -1, limit).astype(np.int64)
    axes = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int64)


def mesh_voxels(mesh: Mesh, grid: Grid, level: int, margin: float) -> I64:
    """Voxels (N, 3) of `level` within `margin`, m (per axis), of the mesh's triangles.

    Octree descent from level 0 with the exact triangle-box test (Akenine-Möller 2001), so the cost follows the surface.
    """
    corners = (mesh.vertices - grid.origin)[mesh.faces]
    pairs_cell = np.zeros((len(corners), 3), dtype=np.int64)
    pairs_triangle = np.arange(len(corners))
    for depth in range(1, level + 1):
        size = grid.size(depth)
        pairs_cell = (2 * pairs_cell[:, None, :] + OCTANTS[None]).reshape(-1, 3)
        pairs_triangle = np.repeat(pairs_triangle, 8)
        hit = np.zeros(len(pairs_cell), dtype=np.bool_)
        for begin in range(0, len(hit), 1 << 19):
            part = slice(begin, begin + (1 << 19))
            centre = (pairs_cell[part] + 0.5) * size
            hit[part] = triangles_touch_boxes(corners[pairs_triangle[part]] - centre[:, None, :], 0.5 * size + margin)
        pairs_cell, pairs_triangle = pairs_cell[hit], pairs_triangle[hit]
    return unique_cells(pairs_cell)


def triangles_touch_boxes(corners: F64, half: float) -> np.ndarray:
    """Whether triangles (N, 3, 3), relative to the centre of cubes of half edge `half`, touch them (closed): (N,) bool.

    Separating axes: 3 box normals, the triangle's normal, 9 edge cross products. A hair of tolerance keeps touching
    faces in.
    """
    h = half * (1.0 + 1e-9)
    touch = ((corners.min(axis=1) <= h) & (corners.max(axis=1) >= -h)).all(axis=1)
    rows = np.flatnonzero(touch)
    c = corners[rows]
    edges = np.roll(c, -1, axis=1) - c
    normal = np.cross(edges[:, 0], edges[:, 1])
    ok = np.abs(np.einsum("ni,ni->n", normal, c[:, 0])) <= h * np.abs(normal).sum(axis=1) * (1 + 1e-9)
    for axis in np.eye(3):
        for e in range(3):
            a = np.cross(edges[:, e], axis)
            projected = np.einsum("nvi,ni->nv", c, a)
            reach = h * np.abs(a).sum(axis=1) + 1e-12 * half * np.abs(edges).max(initial=0.0)
            ok &= (projected.min(axis=1) <= reach) & (projected.max(axis=1) >= -reach)
    touch[rows] = ok
    return touch


def dilate(voxels: I64, limit: I64) -> I64:
    """The voxels (N, 3) and all their 26 neighbours within 0 … `limit` (3,)."""
    grown = unique_cells((voxels[:, None, :] + NEIGHBOURS[None]).reshape(-1, 3))
    return grown[((grown >= 0) & (grown <= limit)).all(axis=1)]
