"""The pictures of a measured scene: truth, ours, albedo and depth per camera, and the probes to draw over them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..reference.datatypes import F32, Scene
from ..reference.pipeline import Probes
from ..reference.transport.textures import nearest_texel
from ..reference.truth.points import CameraView, Points
from ..reference.volume.layout import TEXEL_OFFSETS
from .ground_truth import GroundTruth
from .report.pictures import INVALID, REAL, VIRTUAL, CameraPictures, CameraPose, ProbeDots, SceneView


def scene_views(scene: Scene, probes: Probes, truth: GroundTruth, ours: Callable[[Points], F32]) -> list[SceneView]:
    """One view per camera. `ours` gives irradiance (N, 3) at receivers."""
    dots = probe_dots(probes)
    views = []
    for name, view in truth.views.items():
        estimate = truth.pictures[name]
        shape = (view.camera.height, view.camera.width)
        pictures = CameraPictures(
            scene=scene.name,
            camera=name,
            truth=_image(view, estimate.mean.astype(np.float32)),
            ours=_image(view, ours(view.points)),
            hit=view.hit.reshape(shape),
            albedo=_image(view, view_albedo(scene, truth, view)),
            truth_noise=estimate.noise,
            depth=np.where(view.hit, view.depth, 0.0).reshape(shape).astype(np.float32),
        )
        c = view.camera
        views.append(SceneView(pictures, CameraPose(c.origin, c.target, c.up, c.fov_deg, c.width, c.height), dots))
    return views


def _image(view: CameraView, values: F32) -> F32:
    out = np.zeros((len(view.hit), 3), dtype=np.float32)
    out[view.hit] = values
    return out.reshape(view.camera.height, view.camera.width, 3)


def view_albedo(scene: Scene, truth: GroundTruth, view: CameraView) -> F32:
    """Diffuse albedo (N, 3) at the hit pixels, textures looked up."""
    g = truth.geometry
    albedo = np.stack([scene.materials[m.material].albedo for m in scene.meshes])[view.points.mesh].astype(np.float32)
    for number, mesh in enumerate(scene.meshes):
        texture = scene.materials[mesh.material].texture
        mine = np.flatnonzero(view.points.mesh == number)
        if texture is None or mesh.uvs is None or len(mine) == 0:
            continue
        first = int(np.argmax(g.mesh == number))
        corner = mesh.uvs[mesh.faces[view.triangle[mine] - first]]
        w = np.column_stack([1.0 - view.uv[mine].sum(axis=1), view.uv[mine]])
        uv = np.einsum("ni,nic->nc", w, corner)
        albedo[mine] = nearest_texel(texture, uv)
    return albedo


def probe_dots(probes: Probes) -> ProbeDots:
    """Real probes by validity, and virtual ones, at the level where each first appears."""
    octree, layout = probes.octree, probes.layout
    positions = [octree.positions]
    levels = [octree.corner_level]
    kinds = [np.where(probes.valid, REAL, INVALID).astype(np.uint8)]
    for i, parents in enumerate(layout.parents):
        corner = (2 * parents[:, None, :] + TEXEL_OFFSETS[None])[layout.probe[i] < 0]
        corner = np.unique(corner, axis=0) << (octree.grid.level - i - 1)
        positions.append(octree.grid.corner_positions(corner))
        levels.append(np.full(len(corner), i + 1, dtype=np.int32))
        kinds.append(np.full(len(corner), VIRTUAL, dtype=np.uint8))
    return ProbeDots(
        np.concatenate(positions).astype(np.float32), np.concatenate(levels).astype(np.int32), np.concatenate(kinds)
    )
