"""The ground truth of a scene: estimates at the three point sets and one picture per camera, kept between runs.

The key holds what light sees (geometry, materials, lights), where it is asked (cameras, volumes, counts, seed) and the
code; placement and radiosity settings do not matter, so tuning them never traces a path again.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F64, Scene
from ..reference.progress import Progress
from ..reference.transport.direct import arriving, punctual_irradiance, punctual_lights, visible
from ..reference.truth.mitsuba_scene import build_truth_scene
from ..reference.truth.path_traced import Estimate, estimate, path_depth, picture
from ..reference.truth.points import CameraView, Points, PointSet, choose_points, pixel_view
from ..reference.visibility import Geometry, build_geometry
from . import cache

# Only the camera's points get the noise asked for; the other sets are half as many and carry this much more.
OTHER_SETS_NOISE = 2.0
# Light without what engine lights emit is a difference, and leaves rounding where it is dark: under this share of the scene's mean
# irradiance it is 0.
DUST = 1e-9
# What the numbers come from, file by file where the rest of a folder has no part: editing placement, form factors, radiosity or volume
# traces no path again. A test holds it against what is imported.
TRUTH_CODE = (
    "validation/ground_truth.py", "reference/scene", "reference/truth", "reference/transport/direct.py",
    *(f"reference/{name}.py" for name in (
        "bitmap_file", "config", "config_base", "config_placement", "datatypes", "device_arrays", "directions", "errors", "progress",
        "sky", "turned", "variant", "visibility", "whole_file",
    )),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """points and estimates by set; views and pictures by camera; seconds the tracing took, now or when it was kept."""

    points: dict[PointSet, Points]
    estimates: dict[PointSet, Estimate]
    views: dict[str, CameraView]
    pictures: dict[str, Estimate]
    depth: int
    seconds: float
    geometry: Geometry


def ground_truth(scene: Scene, seed: int, progress: Progress, gated: bool = False) -> GroundTruth:
    """Choose the points, then trace or recall. gated: no pictures, and of the points only the cameras', which gates ask about.

    Raises InputError if a camera stands in a wall or sees nothing.
    """
    g = build_geometry(scene, moving=True)
    views = {} if gated else {name: pixel_view(scene, g, name, seed) for name in scene.settings.cameras}
    points = choose_points(scene, g, scene.settings.truth.points, seed)
    if gated:
        points = {name: p for name, p in points.items() if name == "camera"}
    depth = path_depth(scene, scene.settings.truth.tolerance)
    kind = ("truth", "gated") if gated else ("truth",)
    name = cache.key(*kind, truth_hash(scene), seed, cache.code_hash(*TRUTH_CODE))
    begin = time.perf_counter()
    kept = cache.load("truth", name)
    if kept is None:
        kept = _trace(scene, g, points, views, depth, seed, progress)
        kept["seconds"] = np.array(time.perf_counter() - begin)
        cache.store("truth", name, kept)
    kept = _without_dust(kept)
    estimates = {s: _estimate(kept, s, depth) for s in points}
    pictures = {v: _estimate(kept, f"picture.{v}", depth) for v in views}
    return GroundTruth(points, estimates, views, pictures, depth, float(kept["seconds"]), g)


def _without_dust(kept: cache.Arrays) -> cache.Arrays:
    light = {name: a for name, a in kept.items() if name.endswith((".irradiance", ".l1"))}
    least = DUST * max((float(np.abs(a).mean()) for a in light.values() if a.size), default=0.0)
    return {**kept, **{name: np.where(np.abs(a) < least, np.float32(0.0), a) for name, a in light.items()}}


def truth_hash(scene: Scene) -> str:
    """Hash of what the ground truth depends on."""
    settings = scene.settings
    chosen = {n: getattr(settings, n) for n in ("lights", "cameras", "volumes", "truth")}
    text = {n: str(v) for n, v in chosen.items()}
    return cache.key(text, cache.array_hash(_arrays(scene)), [str(m.truth_bsdf) for m in scene.materials])


def _arrays(scene: Scene) -> Iterator[npt.NDArray[Any] | None]:
    for m in scene.meshes:
        flags = [m.material, m.static, m.lit_by_probes, m.engine_lit, m.closed]
        yield from (m.vertices, m.faces, m.uvs, m.emission, np.array(flags, dtype=np.int64))
    for material in scene.materials:
        flags = [material.two_sided, material.passes_light]
        yield from (material.albedo, material.texture, material.opacity, np.array(flags))
    if scene.sky is not None:
        yield from (scene.sky.image, np.array([scene.sky.rotation_deg, scene.sky.engine_lit]))


def _trace(
    scene: Scene, g: Geometry, points: dict[PointSet, Points], views: dict[str, CameraView], depth: int, seed: int,
    progress: Progress,
) -> cache.Arrays:  # fmt: skip
    t = build_truth_scene(scene)
    s = scene.settings.truth
    out: cache.Arrays = {}
    for i, (name, p) in enumerate(points.items()):
        wanted = s if name == "camera" else s.model_copy(update={"noise": OTHER_SETS_NOISE * s.noise})
        e = estimate(t, p, wanted, depth, seed + i, progress)
        _put(out, name, e, _punctual_input(scene, g, p))
    for i, (camera, view) in enumerate(views.items()):
        e = picture(t, view.points, s.picture_spp, depth, seed + 10 + i, progress)
        _put(out, f"picture.{camera}", e, _punctual_input(scene, g, view.points))
    return out


def _put(out: cache.Arrays, name: str, e: Estimate, extra: tuple[F64, F64]) -> None:
    out[f"{name}.irradiance"] = (e.irradiance + extra[0]).astype(np.float32)
    out[f"{name}.spp"] = np.array(e.spp)
    if e.l1 is not None:
        out[f"{name}.l1"] = (e.l1 + extra[1]).astype(np.float32)


def _punctual_input(scene: Scene, g: Geometry, p: Points) -> tuple[F64, F64]:
    """Direct light (N, 3) of punctual lights tagged `input`, and the same by exact L1 SH at the point: no ray can meet
    them, so both are added exactly."""
    total, l1 = np.zeros_like(p.positions), np.zeros_like(p.positions)
    for light in punctual_lights(scene, "input"):
        total += punctual_irradiance(g, light, p.positions, p.normals)
        towards, distance, facing = arriving(light, p.positions)
        seen = visible(g, p.positions, p.normals, towards, distance)
        l1 += facing * (seen * (0.25 + 0.5 * np.einsum("ni,ni->n", towards, p.normals)))[:, None]
    return total, l1


def _estimate(kept: cache.Arrays, name: str, depth: int) -> Estimate:
    l1 = kept.get(f"{name}.l1")
    return Estimate(
        kept[f"{name}.irradiance"].astype(np.float64),
        None if l1 is None else l1.astype(np.float64),
        int(kept[f"{name}.spp"]),
        depth,
    )
