"""The world a flight goes through: a scene baked and lit, its tiles as a table, the same texture whole, and points to watch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastpath.device import OpenDevice
from ...fastpath.layout import Layout
from ...fastpath.sampler import Sampler
from ...reference import pipeline
from ...reference.config import CameraSettings
from ...reference.datatypes import F32, F64, Scene
from ...reference.errors import InputError
from ...reference.progress import Progress
from ...reference.texture_types import Storage, TileTable, VirtualTexture
from ...reference.truth.points import Points, PointSet, camera_directions, choose_points
from ...reference.visibility import Geometry, cast, points_on_triangles, to_box, vectors
from ...reference.volume.table import tile_table
from ...reference.volume.tiles import fill_tiles, probe_texels, with_copies
from ..formats import sampling_format
from ..ground_truth import ground_truth
from .paths import Places

SURFACE_POINTS = 2000  # that paths follow
WIDTH, HEIGHT, FOV_DEG = 160, 90, 70.0  # of the viewer's picture
# What the finest level is taken to serve where a scene does not say: its diagonal over RINGS, but so many finest voxels.
RINGS, LEAST_VOXELS = 8.0, 8.0


@dataclass(frozen=True, eq=False)
class Watched:
    """Where light is sampled: positions (N, 3) f64 m, off their surfaces, and unit normals (N, 3) f64. batches: what truth says there,
    (B, N, 3) f64 W·m⁻², None where nobody asked it."""

    positions: F64
    normals: F64
    batches: F64 | None = None


@dataclass(frozen=True, eq=False)
class World:
    """table, light (R, 4 or 9, 3) f32: what is streamed. texture, whole: the same, all of it resident, in the storage of the cache.
    lod_distance, m; notes: where it comes from. watched: fixed points. places: for the paths."""

    scene: Scene
    geometry: Geometry
    table: TileTable
    light: F32
    texture: VirtualTexture
    whole: Sampler
    lod_distance: float
    watched: Watched
    places: Places
    notes: tuple[str, ...]
    storage: Storage = "half"
    layout: Layout = "packed"

    def picture(self, position: F64, target: F64) -> Watched:
        """What a viewer at `position` (3,) m sees of probe-lit surfaces when it looks at `target`: one point a pixel, maybe none."""
        camera = CameraSettings(
            origin=tuple(position.tolist()), target=tuple(target.tolist()), fov_deg=FOV_DEG, width=WIDTH, height=HEIGHT
        )
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
        xy = np.stack([(columns.ravel() + 0.5) / WIDTH, (rows.ravel() + 0.5) / HEIGHT], axis=1)
        g, d = self.geometry, camera_directions(camera, xy)
        hits = cast(g, to_box(g, np.repeat(position[None], len(d), axis=0)), vectors(d))
        triangle, front = np.array(hits.triangle).astype(np.int64), np.array(hits.front)
        lit = np.array([m.lit_by_probes for m in self.scene.meshes])
        seen = np.array(hits.hit) & (front | g.two_sided[triangle]) & lit[g.mesh[triangle]]
        triangle, front = triangle[seen], front[seen]
        uv = np.stack([np.array(hits.u)[seen], np.array(hits.v)[seen]], axis=1).astype(np.float64)
        normals = np.where(front[:, None], 1.0, -1.0) * g.normals[triangle]
        points = Points(points_on_triangles(g, triangle, uv), normals, g.mesh[triangle])
        return Watched(pipeline.lifted(self.scene, self.texture, points), normals)


def world(scene: Scene, device: OpenDevice, seed: int, progress: Progress) -> World:
    """Bake and light the scene, as `run` does, and recall or trace its truth.

    Raises InputError if the scene has no probes, or no point to watch.
    """
    truth = ground_truth(scene, seed, progress)
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    probes = pipeline.bake_probes(scene, surfaces, pipeline.place(scene, surfaces, seed), seed, progress)
    coefficients = pipeline.probe_light(scene, surfaces, probes, light)
    used = probe_texels(*with_copies(coefficients, probes.light_from))
    way = scene.settings.sampling.reconstruction
    storage, layout = sampling_format(device.info, way)
    texture = pipeline.virtual_texture(probes, fill_tiles(probes.layout, used, storage))
    whole = Sampler(device, texture, storage, layout, way)
    on_surfaces: list[PointSet] = [n for n in truth.points if n != "volume"]
    names = on_surfaces or list(truth.points)
    if not names:
        raise InputError(f"scene '{scene.name}': nothing to watch on a flight: no mesh is lit by probes and no volume")
    parts = [truth.points[n] for n in names]
    watched = Watched(
        np.concatenate([pipeline.lifted(scene, texture, p) for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([truth.estimates[n].irradiance for n in names], axis=1),
    )
    distance, notes = lod_distance(scene, texture)
    table = tile_table(probes.layout, probes.light_from)
    geometry = truth.geometry
    places = _places(scene, geometry, watched, seed)
    return World(
        scene, geometry, table, coefficients, texture, whole, distance, watched, places, notes, storage, layout
    )  # fmt: skip


def lod_distance(scene: Scene, texture: VirtualTexture) -> tuple[float, tuple[str, ...]]:
    """How far the finest level of detail serves, m, and a note where the scene does not say."""
    asked = scene.settings.sampling.lod_distance
    if asked is not None:
        return float(asked), ()
    diagonal = float(np.linalg.norm(texture.extent)) * texture.finest
    derived = max(diagonal / RINGS, LEAST_VOXELS * texture.finest)
    said = (
        f"the scene has no sampling.lod_distance: for the flight the finest level serves up to {derived:.3g} m, the scene's diagonal "
        f"over {RINGS:g} or {LEAST_VOXELS:g} finest voxels"
    )
    return derived, (said,)


def _places(scene: Scene, g: Geometry, watched: Watched, seed: int) -> Places:
    surface = choose_points(scene, g, 2 * SURFACE_POINTS, seed).get("surface")
    stops = np.array([c.origin for c in scene.settings.cameras.values()], dtype=np.float64).reshape(-1, 3)
    return Places(watched.positions if surface is None else surface.positions, stops)
