"""The ground truth of a scene: estimates at the three point sets and one picture per camera, kept between runs.

Each set of points and each picture is kept as soon as it is traced: a run that was stopped goes on at the one that it was at.

The key holds what light sees (geometry, materials, lights), where it is asked (cameras, volumes, counts, seed) and the
code; placement and radiosity settings do not matter, so tuning them never traces a path again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F64, Scene
from ..reference.progress import Progress
from ..reference.transport.direct import arriving, punctual_irradiance, punctual_lights, visible
from ..reference.truth.mitsuba_scene import TruthScene, build_truth_scene
from ..reference.truth.path_traced import Estimate, estimate, path_depth, picture
from ..reference.truth.points import CameraView, Points, PointSet, choose_points, pixel_view
from ..reference.visibility import Geometry, build_geometry
from . import cache

# Only the camera's points get the noise asked for; the other sets are half as many and carry this much more.
OTHER_SETS_NOISE = 2.0
# Light without what engine lights emit is a difference, and leaves rounding where it is dark: under this share of the scene's mean
# irradiance it is 0.
DUST = 1e-9
LIGHT = ("irradiance", "l1")  # arrays of a part that hold W·m⁻²
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
    """points and estimates by set; views and pictures by camera; seconds the tracing took, now or when its parts were kept."""

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
    parts = _Parts(scene, g, seed)
    kept = _trace(parts, points, views, depth, progress)
    seconds = sum(float(part["seconds"]) for part in kept.values())
    kept = _without_dust(kept)
    estimates = {s: _estimate(kept[s], depth) for s in points}
    pictures = {v: _estimate(kept[f"picture.{v}"], depth) for v in views}
    return GroundTruth(points, estimates, views, pictures, depth, seconds, g)


def _without_dust(kept: dict[str, cache.Arrays]) -> dict[str, cache.Arrays]:
    """Of each part what is under DUST of the brightest part's mean is 0."""
    light = [part[name] for part in kept.values() for name in LIGHT if name in part]
    least = DUST * max((float(np.abs(a).mean()) for a in light if a.size), default=0.0)

    def cleaned(name: str, a: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.where(np.abs(a) < least, np.float32(0.0), a) if name in LIGHT else a

    return {part: {name: cleaned(name, a) for name, a in arrays.items()} for part, arrays in kept.items()}


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


class _Parts:
    """What is kept of a truth: for each set of points and each picture `irradiance`, `l1` where there is one, `spp` and `seconds`."""

    def __init__(self, scene: Scene, g: Geometry, seed: int) -> None:
        self.scene, self.seed, self._geometry = scene, seed, g
        self._key = (truth_hash(scene), seed, cache.code_hash(*TRUTH_CODE))

    @cached_property
    def _traced_scene(self) -> TruthScene:
        """Built for the first part that is not kept."""
        return build_truth_scene(self.scene)

    def part(self, name: str, points: Points, trace: Callable[[TruthScene], Estimate]) -> cache.Arrays:
        """The part `name` as it is kept, traced by `trace` where it is not, with punctual lights tagged `input` at `points`."""
        key = cache.key("truth", name, *self._key)
        kept = cache.load("truth", key)
        if kept is not None:
            return kept
        begin = time.perf_counter()
        e = trace(self._traced_scene)
        extra, extra_l1 = _punctual_input(self.scene, self._geometry, points)
        kept = {"irradiance": (e.irradiance + extra).astype(np.float32), "spp": np.array(e.spp)}
        if e.l1 is not None:
            kept["l1"] = (e.l1 + extra_l1).astype(np.float32)
        kept["seconds"] = np.array(time.perf_counter() - begin)
        cache.store("truth", key, kept)
        return kept


def _trace(
    parts: _Parts, points: dict[PointSet, Points], views: dict[str, CameraView], depth: int, progress: Progress
) -> dict[str, cache.Arrays]:
    """All parts by name: sets of points by theirs, pictures as `picture.CAMERA`."""
    s, out = parts.scene.settings.truth, dict[str, cache.Arrays]()
    for i, (name, p) in enumerate(points.items()):
        wanted = s if name == "camera" else s.model_copy(update={"noise": OTHER_SETS_NOISE * s.noise})
        told = named(progress, f"{name} points")
        out[name] = parts.part(
            name, p, partial(estimate, points=p, s=wanted, depth=depth, seed=parts.seed + i, progress=told)
        )
    for i, (camera, view) in enumerate(views.items()):
        trace = partial(
            picture,
            points=view.points,
            spp=s.picture_spp,
            depth=depth,
            seed=parts.seed + 10 + i,
            progress=named(progress, camera),
        )
        out[f"picture.{camera}"] = parts.part(f"picture.{camera}", view.points, trace)
    return out


def named(progress: Progress, what: str) -> Progress:
    """The same with each stage's name followed by `what`: work on different points gets a bar, and an honest time left, of its own."""

    def told(stage: str, done: int, total: int) -> None:
        progress(f"{stage}, {what}", done, total)

    return told


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


def _estimate(kept: cache.Arrays, depth: int) -> Estimate:
    l1 = kept.get("l1")
    return Estimate(
        kept["irradiance"].astype(np.float64), None if l1 is None else l1.astype(np.float64), int(kept["spp"]), depth
    )
