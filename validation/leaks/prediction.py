"""Which walls will leak, before any light is computed: every wall's thickness against the voxels that stand at it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64, Scene
from ...reference.directions import sobol
from ...reference.lattice import Octree
from ...reference.texture_types import VirtualTexture
from ...reference.visibility import LIFT, Geometry, points_on_triangles
from ...reference.volume.sampler import lattice_position, resolve
from .field import holding_level
from .walls import in_the_open, spread, walls_behind

POINTS = 8192
LEAST_POINTS = 64  # of every mesh
THICKEST = 8.0  # voxels: what is thicker is no wall but a solid
ROUNDING = 1e-5  # relative: thicknesses are measured with float32 rays


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points on the walls of a scene. positions, normals (N, 3) m, into the open; area (N,) m² that each stands for; mesh,
    behind (N,) meshes of the near and the far face; thickness, need (N,) m; voxel (N,) m: the voxel that serves receivers
    there; own_voxel (N,) m: the finest real one there, smaller than `voxel` where all its probes are invalid."""

    positions: F64
    normals: F64
    area: F64
    mesh: I64
    behind: I64
    thickness: F64
    need: F64
    voxel: F64
    own_voxel: F64

    @property
    def leaks(self) -> np.ndarray:
        """Whether light is predicted to come through, (N,) bool: the voxel is larger than the wall needs."""
        return np.asarray(self.voxel > self.need * (1.0 + ROUNDING))


@dataclass(frozen=True)
class WallReport:
    """The walls of one mesh, by their worst place. area_m2: of walls on this mesh; leak_share: of it, predicted to leak.
    dead_share: of it, predicted to leak only because no probe of its own voxel is valid and a coarser one serves."""

    mesh: str
    behind: str
    area_m2: float
    leak_share: float
    dead_share: float
    position: tuple[float, float, float]
    normal: tuple[float, float, float]
    thickness_m: float
    needed_voxel_m: float
    needed_voxel_lifted_m: float
    voxel_m: float
    sheet: bool


def wall_points(
    scene: Scene, g: Geometry, octree: Octree, texture: VirtualTexture, lift: float, seed: int
) -> WallPoints:
    """Points all over the static surfaces behind which there are walls.

    lift, m: how far off surfaces receivers are sampled; there it is asked which voxel serves them.
    """
    triangle, uv, area = _spread_points(g, len(scene.meshes), seed)
    positions, normals = points_on_triangles(g, triangle, uv), g.normals[triangle]
    shown = in_the_open(g, positions + 2.0 * LIFT * g.scale * normals)
    triangle, positions, normals, area = triangle[shown], positions[shown], normals[shown], area[shown]
    found = walls_behind(g, positions, normals, triangle)
    own = holding_level(octree, positions + 2.0 * LIFT * g.scale * normals)
    q = lattice_position(texture, positions + lift * normals)
    answers = resolve(texture, q, q, texture.level)[2].astype(np.int64)
    lifted = holding_level(octree, positions + lift * normals)
    serving = np.where(answers < lifted, np.minimum(own, answers), own)
    size: F64 = octree.grid.finest * np.exp2(octree.grid.level - np.arange(octree.grid.level + 1, dtype=np.float64))
    wall = found.thickness <= THICKEST * size[own]
    return WallPoints(
        positions[wall], normals[wall], area[wall], g.mesh[triangle[wall]].astype(np.int64),
        found.behind[wall].astype(np.int64), found.thickness[wall], found.need[wall], size[serving[wall]], size[own[wall]],
    )  # fmt: skip


def _spread_points(g: Geometry, meshes: int, seed: int) -> tuple[I64, F64, F64]:
    """Triangle (N,), barycentric place (N, 2) and area (N,) m² of points spread evenly over each mesh."""
    total = g.areas.sum()
    triangles, places, areas = [], [], []
    for number in range(meshes):
        mine = np.flatnonzero(g.mesh == number)
        upto = np.cumsum(g.areas[mine])
        if len(mine) == 0 or upto[-1] <= 0.0:
            continue
        count = max(LEAST_POINTS, round(POINTS * float(upto[-1] / total)))
        xi = sobol(count, 3, seed + 500 + number).astype(np.float64)
        triangles.append(mine[np.searchsorted(upto[:-1], xi[:, 0] * upto[-1], side="right")])
        fold = xi[:, 1:].sum(axis=1, keepdims=True) > 1.0
        places.append(np.where(fold, 1.0 - xi[:, 1:], xi[:, 1:]))
        areas.append(np.full(count, upto[-1] / count))
    return np.concatenate(triangles), np.concatenate(places), np.concatenate(areas)


def wall_reports(scene: Scene, walls: WallPoints, lift: float) -> list[WallReport]:
    """One report per mesh that has walls, the most endangered first: largest voxel against the voxel that the wall needs."""
    ratio = np.divide(walls.voxel, walls.need, out=np.full(len(walls.need), np.inf), where=walls.need > 0.0)
    names = [m.name for m in scene.meshes]
    rows = []
    for number in np.unique(walls.mesh):
        mine = np.flatnonzero(walls.mesh == number)
        worst = mine[np.argmax(ratio[mine])]
        area, leaks = walls.area[mine], walls.leaks[mine]
        dead = leaks & (walls.own_voxel[mine] <= walls.need[mine] * (1.0 + ROUNDING))
        lifted = (walls.thickness[worst] + lift) / spread(walls.normals[worst : worst + 1])[0]
        row = WallReport(
            names[number], names[walls.behind[worst]], float(area.sum()), float(area @ leaks / area.sum()),
            float(area @ dead / area.sum()), triple(walls.positions[worst]), triple(walls.normals[worst]),
            float(walls.thickness[worst]), float(walls.need[worst]), float(lifted), float(walls.voxel[worst]),
            bool(walls.thickness[worst] == 0.0),
        )  # fmt: skip
        rows.append((float(ratio[worst]), row))
    return [row for _, row in sorted(rows, key=lambda pair: -pair[0])]


def triple(v: F64) -> tuple[float, float, float]:
    """Three plain numbers of (3,)."""
    x, y, z = (float(c) for c in v)
    return x, y, z
