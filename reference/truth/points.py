"""Where the ground truth is asked: points seen by each camera, uniform over probe-lit surfaces, and random positions and
normals inside the probe volumes (what a moving mesh or fog would get)."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..config import CameraSettings
from ..datatypes import F64, I32, Bool, Scene
from ..directions import fibonacci_sphere, sobol, sphere
from ..errors import InputError
from ..turned import turned, turned_boxes
from ..visibility import Geometry, cast, points_on_triangles, to_box, vectors

PointSet = Literal["camera", "surface", "volume"]
INSIDE_RAYS = 64
INSIDE_SHARE = 0.25  # share of rays that meet the inside of something above which a point is inside it


@dataclass(frozen=True, eq=False)
class Points:
    """Receivers: positions (N, 3) m, normals (N, 3) unit, mesh (N,) i32 (-1: none); camera (N,) i32: number of the camera
    that sees each, None for points that no camera chose."""

    positions: F64
    normals: F64
    mesh: I32
    camera: I32 | None = None

    def part(self, chosen: slice | npt.NDArray[np.integer]) -> Points:
        """Some of the points, in the order of `chosen`."""
        camera = None if self.camera is None else self.camera[chosen]
        return Points(self.positions[chosen], self.normals[chosen], self.mesh[chosen], camera)


@dataclass(frozen=True, eq=False)
class CameraView:
    """One receiver per pixel of a camera, row by row. hit (H·W,) bool; points: receivers of the hit pixels, in order, with the
    camera's number; depth (H·W,) f64 m, infinite where nothing is hit."""

    camera: CameraSettings
    hit: Bool
    points: Points
    depth: F64
    triangle: I32
    uv: F64


def camera_directions(camera: CameraSettings, xy: npt.NDArray[np.floating]) -> F64:
    """Unit directions (N, 3) through image positions `xy` (N, 2) in 0..1, x to the right, y down."""
    forward = np.subtract(camera.target, camera.origin)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right = right / np.linalg.norm(right)
    up = np.cross(right, forward)
    half = math.tan(math.radians(camera.fov_deg) / 2)
    x = (2 * xy[:, :1] - 1) * half
    y = (1 - 2 * xy[:, 1:]) * half * camera.height / camera.width
    d = forward + x * right + y * up
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def view(scene: Scene, g: Geometry, name: str, xy: npt.NDArray[np.floating]) -> CameraView:
    """What camera `name` sees at image positions `xy` (N, 2).

    Raises InputError if the camera stands inside a mesh or sees no surface at all.
    """
    camera = scene.settings.cameras[name]
    origin = np.asarray(camera.origin, dtype=np.float64)[None]
    if inside_share(g, origin, None)[0] > 0.5:
        raise InputError(
            f"scene '{scene.name}', cameras.{name}: origin {camera.origin} is inside a wall (most directions meet back "
            "faces); move cameras." + name + ".origin"
        )
    d = camera_directions(camera, xy)
    hits = cast(g, to_box(g, np.repeat(origin, len(d), axis=0)), vectors(d))
    found = np.array(hits.hit)
    triangle, front = np.array(hits.triangle).astype(np.int64), np.array(hits.front)
    found &= front | g.two_sided[triangle]
    if not found.any():
        raise InputError(
            f"scene '{scene.name}', cameras.{name}: sees no surface; aim cameras.{name}.target at the scene"
        )
    uv = np.stack([np.array(hits.u)[found], np.array(hits.v)[found]], axis=1).astype(np.float64)
    seen = _on_triangles(g, triangle[found], uv, front[found])
    number = list(scene.settings.cameras).index(name)
    points = dataclasses.replace(seen, camera=np.full(len(uv), number, dtype=np.int32))
    return CameraView(camera, found, points, np.array(hits.t, dtype=np.float64), triangle[found].astype(np.int32), uv)


def _on_triangles(g: Geometry, triangle: npt.NDArray[np.integer], uv: F64, front: Bool) -> Points:
    normals = np.where(front[:, None], 1.0, -1.0) * g.normals[triangle]
    return Points(points_on_triangles(g, triangle, uv), normals, g.mesh[triangle])


def pixel_view(scene: Scene, g: Geometry, name: str, seed: int) -> CameraView:
    """One jittered position in every pixel of a camera (a regular grid that meets edges biases their share)."""
    c = scene.settings.cameras[name]
    jitter = np.random.default_rng([seed, 17]).random((c.height, c.width, 2))
    rows, columns = np.mgrid[0 : c.height, 0 : c.width]
    xy = np.stack([(columns + jitter[..., 0]) / c.width, (rows + jitter[..., 1]) / c.height], axis=-1)
    return view(scene, g, name, xy.reshape(-1, 2))


def choose_points(scene: Scene, g: Geometry, count: int, seed: int) -> dict[PointSet, Points]:
    """The three sets: `count` points for the cameras, half as many for each of the others; a set that has nowhere to be is
    absent."""
    sets: dict[PointSet, Points | None] = {
        "camera": _camera_points(scene, g, count, seed),
        "surface": _surface_points(scene, g, count // 2, seed),
        "volume": _volume_points(scene, g, count // 2, seed),
    }
    return {name: p for name, p in sets.items() if p is not None and len(p.positions)}


def _camera_points(scene: Scene, g: Geometry, count: int, seed: int) -> Points | None:
    probe_lit = np.array([m.lit_by_probes for m in scene.meshes])
    parts = []
    each = max(1, count // max(1, len(scene.settings.cameras)))
    for i, name in enumerate(scene.settings.cameras):
        points = view(scene, g, name, sobol(4 * each, 2, seed + 100 + i)).points
        keep = np.flatnonzero(probe_lit[points.mesh])[:each]
        parts.append(points.part(keep))
    return _join(parts)


def _surface_points(scene: Scene, g: Geometry, count: int, seed: int) -> Points | None:
    probe_lit = np.array([m.lit_by_probes for m in scene.meshes])[g.mesh]
    area = np.cumsum(np.where(probe_lit, g.areas, 0.0))
    if area[-1] <= 0:
        return None
    xi = sobol(4 * count, 4, seed + 200).astype(np.float64)
    triangle = np.searchsorted(area[:-1], xi[:, 0] * area[-1], side="right")
    fold = xi[:, 1:3].sum(axis=1, keepdims=True) > 1.0
    uv = np.where(fold, 1.0 - xi[:, 1:3], xi[:, 1:3])
    front = ~(g.two_sided[triangle] & (xi[:, 3] < 0.5))
    points = _on_triangles(g, triangle, uv, front)
    return _outside(g, points, points.normals, count)


def _volume_points(scene: Scene, g: Geometry, count: int, seed: int) -> Points | None:
    volumes = turned_boxes(scene.settings.volumes.values(), scene.settings.scene.rotation)
    if not volumes:
        return None
    lower, upper = np.array([v.lower for v in volumes]), np.array([v.upper for v in volumes])
    share = np.cumsum(np.prod(upper - lower, axis=1))
    xi = sobol(8 * count, 6, seed + 300).astype(np.float64)
    pick = np.searchsorted(share[:-1], xi[:, 0] * share[-1], side="right")
    positions = turned(lower[pick] + (upper - lower)[pick] * xi[:, 1:4], volumes[0].matrix)
    normals = turned(sphere(xi[:, 4:]), volumes[0].matrix)
    points = Points(positions, normals, np.full(len(xi), -1, dtype=np.int32))
    return _outside(g, points, None, count)


def inside_share(g: Geometry, positions: F64, normals: F64 | None) -> F64:
    """Share (N,) of directions, on the side of `normals` if given, that meet the inside of something."""
    d = fibonacci_sphere(INSIDE_RAYS)
    n = len(positions)
    directions = np.tile(d, (n, 1))
    origins = np.repeat(positions, INSIDE_RAYS, axis=0)
    lift = None
    upper = np.ones(len(origins), dtype=np.bool_)
    if normals is not None:
        lift = np.repeat(normals, INSIDE_RAYS, axis=0)
        upper = np.einsum("ni,ni->n", directions, lift) > 0.0
    hits = cast(g, to_box(g, origins, lift), vectors(directions))
    triangle = np.array(hits.triangle).astype(np.int64)
    back = np.array(hits.hit) & ~np.array(hits.front) & g.counts_as_back[triangle] & upper
    return np.asarray(back.reshape(n, -1).sum(axis=1) / np.maximum(upper.reshape(n, -1).sum(axis=1), 1))


def _outside(g: Geometry, points: Points, normals: F64 | None, count: int) -> Points:
    """The first `count` points that are not inside anything."""
    keep = np.flatnonzero(inside_share(g, points.positions, normals) <= INSIDE_SHARE)[:count]
    return points.part(keep)


def _join(parts: list[Points]) -> Points | None:
    if not parts:
        return None
    return Points(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.mesh for p in parts]),
        np.concatenate([p.camera for p in parts if p.camera is not None]),
    )
