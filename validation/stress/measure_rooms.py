"""Cases B4, B5, B6: what patches cannot hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...reference.datatypes import F32, F64, I64, Scene
from ...reference.pipeline.surfaces import PatchLight, Surfaces, bake_surfaces, gather_at_points, light_patches
from ...reference.progress import silent
from ...reference.transport.patches import Patches, build_patches, surface_samples
from ...reference.truth.mitsuba_scene import build_truth_scene
from ...reference.truth.path_traced import picture
from ...reference.truth.points import Points
from ...reference.visibility import Geometry, build_geometry
from ..metrics.error import Measured, measure_error
from .case import Reading
from .cases_radiosity import GLOSS, TEXTURE
from .scenes import box, box_faces, grey, mesh, owners, plate, quads_mesh, scene_of
from .until_decided import mean_of, until_decided

# B4 ------------------------------------------------------------------------------------------------------------------

WALL, MIDDLE, LENGTH, WIDTH = 0.1, 0.6, 1.3, 0.5
PLACES = (0.0, 0.27, 0.55, 0.81)  # of a patch: where the wall stands in the grid of patches
PATCH_ERROR = 0.3
SAMPLES = 16  # points per patch at which the light is looked at


def wall_over_patches(size: float, seed: int) -> Mapping[str, Reading]:
    """Two rooms with a wall 0.1 m thick between, a lamp in one, patches of `size` wall thicknesses. Radiosity in the dark room, of
    that in the lit one, the worst of PLACES of the wall; the same with patches cut where the light varies; and light missing on the
    lit side within a patch's width of the wall, of what there should be."""
    h = size * WALL
    plain = [_two_rooms(h, MIDDLE + h * shift, None, seed) for shift in PLACES]
    found = {
        "leak": Reading(max(r.leak for r in plain), 0.0, len(plain) * plain[0].points),
        "overdark": Reading(_overdark(plain[0], h, seed), 0.0, plain[0].points),
    }
    if size > 1.0:  # finer ones do not leak, and would be cut for nothing
        cut = _two_rooms(h, MIDDLE, PATCH_ERROR, seed)
        found["leak, patches cut, one place"] = Reading(cut.leak, 0.0, cut.points)
    return found


class _Rooms(NamedTuple):
    """leak; scene and its light; points (N, 3) m and normals on all patches, their irradiance (N,), and the wall's lit side, m."""

    leak: float
    scene: Scene
    surfaces: Surfaces
    light: PatchLight
    at: F64
    normals: F64
    incident: F64
    x: float

    @property
    def points(self) -> int:
        return len(self.at)


def _two_rooms(h: float, x: float, patch_error: float | None, seed: int) -> _Rooms:
    room = box((0, 0, 0), (LENGTH, WIDTH, WIDTH))
    wall = box((x, 0, 0), (x + WALL, WIDTH, WIDTH), inward=False)
    lamp = quads_mesh([plate((0.1, 0.3), (0.1, 0.4), 0.45, up=False)], exitance=1.0)
    s = scene_of([room, wall, lamp], radiosity={"patch_size": h, "patch_error": patch_error, "rays": 256})
    surfaces = bake_surfaces(s, seed)
    light = light_patches(s, surfaces, seed)
    g, p, sent = surfaces.geometry, surfaces.patches, light.radiosity
    uvw = np.random.default_rng([seed, 8]).random((p.count, SAMPLES, 3))
    points, normals = surface_samples(g, p, np.arange(p.count), uvw)
    dark = points[..., 0] >= x + WALL - 1e-9
    lit = points[..., 0] <= x + 1e-9
    area = np.repeat(p.area[:, None] / SAMPLES, SAMPLES, axis=1)
    b = np.repeat(sent.radiosity[:, :1], SAMPLES, axis=1)
    leak = (area * b)[dark].sum() / area[dark].sum() / ((area * b)[lit].sum() / area[lit].sum())
    incident = np.repeat(sent.irradiance[:, :1], SAMPLES, axis=1)
    return _Rooms(float(leak), s, surfaces, light, points.reshape(-1, 3), normals.reshape(-1, 3), incident.ravel(), x)


@lru_cache
def _fine_rooms(seed: int) -> _Rooms:
    return _two_rooms(0.5 * WALL, MIDDLE, None, seed)


def _overdark(coarse: _Rooms, h: float, seed: int) -> float:
    """Mean of max(R - E, 0) over mean R at points of the lit side near the wall; R is gathered there from fine patches."""
    fine = _fine_rooms(seed)
    band = np.flatnonzero((coarse.at[:, 0] < coarse.x - 1e-9) & (coarse.at[:, 0] > coarse.x - h))
    band = band[np.random.default_rng([seed, 9]).permutation(len(band))[:BAND]]
    wanted = gather_at_points(fine.scene, fine.surfaces, fine.light, coarse.at[band], coarse.normals[band], seed)[:, 0]
    return float(np.maximum(wanted - coarse.incident[band], 0.0).mean() / wanted.mean())


BAND = 256

# B5, B6 --------------------------------------------------------------------------------------------------------------

REFLECTANCE, GLOSS_PATCH, POINTS = 0.6, 0.25, 192
LOOKS, LEAST_LOOKS, GLOSS_LOOKS = 8, 2, 12  # bakes with random numbers of their own, each with points of its own


def gloss(weight: float, seed: int) -> Mapping[str, Reading]:
    """A room whose floor is a blend of diffuse paint and rough metal, `weight` of it metal, both of reflectance 0.6: irradiance that
    walls and ceiling gather from the patches, against paths. Relative root mean square error and signed mean."""
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.1,
             "specular_reflectance": {"type": "rgb", "value": [REFLECTANCE] * 3}}  # fmt: skip
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [REFLECTANCE] * 3}}
    blend = {"type": "blendbsdf", "weight": float(weight), "bsdf_0": paint, "bsdf_1": metal}
    floor = dataclasses.replace(grey(REFLECTANCE), truth_bsdf=blend)
    faces = box_faces((0, 0, 0), (2, 1, 2))
    meshes = [*(quads_mesh(f) for i, f in enumerate(faces) if i != 2), quads_mesh(faces[2], material=1)]
    lamp = mesh(
        [[2, 0.2, 0.7], [2, 0.2, 1.3], [2, 0.8, 1.3], [2, 0.8, 0.7]], [[0, 1, 2], [0, 2, 3]], 0, 5.0, engine=True
    )
    lamp = dataclasses.replace(lamp, vertices=lamp.vertices - (1e-3, 0, 0))
    s = scene_of([*meshes, lamp], [grey(0.4), floor], radiosity={"patch_size": GLOSS_PATCH})
    # As many bakes at every share: bands so wide are told by few, the limit that the bisection looks for is not.
    return until_decided(GLOSS, weight, _Against(s, (2.0, 1.0, 2.0), 0.5 * GLOSS_PATCH, seed), GLOSS_LOOKS, GLOSS_LOOKS)


class _Against:
    """Irradiance that walls and ceiling of a room gather, against paths; each look is one more bake, with points of its own. `edge`:
    how far these lie off the room's edges, m; half a patch off, a patch is no longer seen from within its own width."""

    def __init__(self, s: Scene, size: tuple[float, float, float], edge: float, seed: int) -> None:
        self._scene, self._size, self._edge, self._seed = s, size, edge, seed
        self._truth = build_truth_scene(s)
        self._found: list[dict[str, Measured]] = []

    def __call__(self, k: int) -> Mapping[str, Reading]:
        self._found.append(self._one(100 * self._seed + k))
        return {
            shown: dataclasses.replace(
                mean_of([f[name].value for f in self._found], [f[name].se for f in self._found]), n=k * POINTS
            )
            for shown, name in (("relRMSE", "relrmse"), ("signed mean", "bias"))
        }

    def _one(self, seed: int) -> dict[str, Measured]:
        points, s = _wall_points(self._size, self._edge, seed), self._scene
        surfaces = bake_surfaces(s, seed)
        light = light_patches(s, surfaces, seed)
        ours = gather_at_points(s, surfaces, light, points.positions, points.normals, seed)
        runs = [
            picture(self._truth, points, 2 * PATHS // BATCHES, PATH_DEPTH, BATCHES * seed + b, silent)
            for b in range(BATCHES // 2)
        ]
        return measure_error(ours, np.concatenate([run.irradiance for run in runs]))


def _wall_points(size: tuple[float, float, float], edge: float, seed: int) -> Points:
    """Random points on the wall x = 0 and the ceiling of a box."""
    u = np.random.default_rng([seed, 10]).uniform(edge, np.array(size) - edge, (POINTS, 3))
    half = POINTS // 2
    u[:half, 0], u[half:, 1] = 0.0, size[1]
    normals = np.zeros((POINTS, 3))
    normals[:half, 0], normals[half:, 1] = 1.0, -1.0
    return Points(u, normals, np.zeros(POINTS, np.int32))


PATH_DEPTH = 24  # 0.6^24 = 5e-6
PATHS, BATCHES = 1024, 8
FLOOR = 4  # m
TEXELS = 8  # per half cycle: bilinear truth is then nearly as sharp as the nearest texel of the bake
BOARD_PATCH, BRIGHT, DIM = 1.0, 0.8, 0.2


def checkerboard(cycles: float, seed: int) -> Mapping[str, Reading]:
    """A floor with a checkerboard of `cycles` per patch under a lamp. Albedo of its patches against the mean of the picture over each,
    root mean square, of their mean: as the product has it, and by four looks at the picture a patch; and irradiance that walls and
    ceiling gather, against paths."""
    board = _board(cycles)
    corners = plate((0, FLOOR), (0, FLOOR), 0.0, up=True)
    uvs = (np.column_stack([corners[:, 0], corners[:, 2]]) / FLOOR).astype(np.float32)
    floor = mesh(corners, [[0, 1, 2], [0, 2, 3]], material=1, uvs=uvs)
    walls = [quads_mesh(f) for i, f in enumerate(box_faces((0, 0, 0), (FLOOR, 2, FLOOR))) if i != 2]
    lamp = mesh(plate((0, FLOOR), (0, FLOOR), 1.99, up=False), [[0, 1, 2], [0, 2, 3]], 0, 1.0, engine=True)
    materials = [grey(0.3), grey(float(board.mean()), texture=board)]
    s = scene_of([floor, *walls, lamp], materials, radiosity={"patch_size": BOARD_PATCH})
    g = build_geometry(s)
    p = build_patches(s, g, BOARD_PATCH)
    mine = np.flatnonzero(owners(g, p) == 0)
    exact = _means(g, p, mine, board, TEXTURE_POINTS, seed)
    few = _means(g, p, mine, board, FEW_POINTS, seed)
    own = {
        "albedo of patches": _off(p.albedo[mine, 0], exact),
        "albedo of patches, four looks": _off(few, exact),
    }
    light = _Against(s, (FLOOR, 2.0, FLOOR), 0.5 * BOARD_PATCH, seed)
    return until_decided(TEXTURE, cycles, lambda k: {**own, **light(k)}, LOOKS, LEAST_LOOKS)


def _off(found: F64, exact: F64) -> Reading:
    """Root mean square of found - exact, of the mean."""
    return Reading(float(np.sqrt(((found - exact) ** 2).mean()) / exact.mean()), 0.0, len(exact))


def _board(cycles: float) -> F32:
    """Checkerboard over the whole floor, row 0 at v = 1."""
    halves = round(2 * cycles * FLOOR)
    at = np.arange(halves * TEXELS) // TEXELS
    squares = np.where((at[:, None] + at[None, ::-1]) % 2 == 0, BRIGHT, DIM)
    return np.repeat(squares[..., None], 3, axis=2).astype(np.float32)


def _means(g: Geometry, p: Patches, mine: I64, picture: F32, points: int, seed: int) -> F64:
    """Mean of the picture over each of the floor's patches `mine`, from random points."""
    uvw = np.random.default_rng([seed, 12]).random((len(mine), points, 3))
    at = surface_samples(g, p, mine, uvw)[0] / FLOOR
    row, column = ((1.0 - at[..., 2]) * len(picture)).astype(int), (at[..., 0] * len(picture)).astype(int)
    return np.asarray(picture[row % len(picture), column % len(picture), 0].mean(axis=1), dtype=np.float64)


TEXTURE_POINTS, FEW_POINTS = 1 << 14, 4
