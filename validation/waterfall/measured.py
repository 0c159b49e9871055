"""The waterfall of a scene measured: at the cameras' points, for each camera and each mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...reference.datatypes import F64
from ...reference.errors import InputError
from ...reference.progress import Progress
from ...reference.truth.points import Points
from ..ground_truth import named
from ..metrics.error import cross_half_mse
from .chain import gathered_stages, in_parts
from .kept import Parts
from .reference import REMAINDER, Reference, finer, geometry_of, kept_paths, paths, paths_needed, relative_noise
from .statistics import Waterfall, waterfall
from .world import World, as_baked

RAYS = 8192  # of a point, twice
AT_ONCE = 8192  # points
DIFFUSE_NOISE = (
    0.3  # of the error: a tenth of its square, over a thousand points 0.3 % of it as a share's standard error
)
FEW = 20  # points of a mesh that a row of the table takes


@dataclass(frozen=True, eq=False)
class Measured:
    """sets: the waterfall by name, the scene's ("camera") first, then each camera's where there are more; meshes: by name of the mesh,
    relative to the scene's mean light, most points first. reference, diffuse: the stages by paths, the latter None where the bake sees
    all; notes: what a reader should know."""

    sets: dict[str, Waterfall]
    meshes: dict[str, Waterfall]
    reference: Reference
    diffuse: Reference | None
    notes: tuple[str, ...]


def measured(w: World, progress: Progress, parts: Parts | None = None) -> Measured:
    """Stages at the cameras' points, and their statistics. parts: keeps what takes long.

    Raises InputError for a scene whose cameras see no probe-lit surface, or only dark ones.
    """
    points = w.truth.points.get("camera")
    if points is None or w.truth.estimates["camera"].mean.mean() <= 0.0:
        raise InputError(
            f"scene '{w.scene.name}': no waterfall: its cameras see {'no probe-lit surface' if points is None else 'no light'}; "
            "add a camera that does"
        )
    parts = parts or Parts()
    stages = _gathered(w, points, parts, progress)
    estimate = w.truth.estimates["camera"]
    first = Reference(estimate.irradiance, estimate.spp)
    told = named(progress, "more paths for the waterfall")
    reference = finer(w.scene, w.truth.geometry, points, first, stages[-1][0], w.seed, told, parts)
    noise = enough_noise(reference, stages[-1][0])
    told = named(progress, "all surfaces diffuse")
    diffuse = diffuse_stage(w, points, reference, noise, told, parts)
    stages, other = [reference.irradiance, diffuse.irradiance, *stages], diffuse is not reference
    cameras = list(w.scene.settings.cameras)
    sets = {"camera": waterfall(stages)}
    for number, name in enumerate(cameras):
        mine = np.asarray(points.camera == number)
        if len(cameras) > 1 and mine.sum() >= FEW and stages[0][:, mine].mean() > 0.0:
            sets[f"camera {name}"] = waterfall([s[:, mine] for s in stages])
    short = max(paths_needed(reference.spp, 1.0 - one.explained) for one in sets.values())
    reference = replace(reference, needed=max(reference.needed, short))
    notes = _notes(w, reference, sets["camera"], other)
    return Measured(sets, _meshes(w, points, stages), reference, diffuse if other else None, notes)


def _gathered(w: World, points: Points, parts: Parts, progress: Progress) -> list[F64]:
    """Stages 2 to 10, AT_ONCE points at a time."""
    n, done = len(points.positions), 0

    def work(part: Points) -> list[F64]:
        nonlocal done
        progress("stages of the waterfall", done, n)
        done += len(part.positions)
        return gathered_stages(w, part, RAYS)

    kept = parts.arrays("stages", lambda: {str(i): s for i, s in enumerate(in_parts(points, AT_ONCE, work))})
    progress("stages of the waterfall", n, n)
    return [kept[str(i)] for i in range(len(kept))]


def enough_noise(reference: Reference, ours: F64) -> float:
    """Relative noise that stage 1 may have, given what is sampled at the reference's points (N, 3).

    Noise of a stage between the ends cancels from every figure and only widens its interval: DIFFUSE_NOISE of the error is enough,
    where the reference takes more paths for its own end of the chain, whose noise no link explains.
    """
    error = math.sqrt(max(cross_half_mse(ours, reference.irradiance), 0.0)) / float(reference.irradiance.mean())
    return max(relative_noise(reference.irradiance), DIFFUSE_NOISE * error)


def diffuse_stage(
    w: World, points: Points, reference: Reference, noise: float, progress: Progress, parts: Parts | None = None
) -> Reference:
    """The points' light with what the bake sees (stage 1), until its relative `noise` or the reference's paths: the reference itself
    where the bake sees all. parts: keeps it."""
    baked = as_baked(w.scene)
    if baked is None:
        return reference
    g = geometry_of(baked)
    return kept_paths(
        parts or Parts(), "diffuse", lambda: paths(baked, g, points, noise, reference.spp, w.seed + 1, progress)
    )


def _meshes(w: World, points: Points, stages: list[F64]) -> dict[str, Waterfall]:
    scale = float(stages[0].mean())
    numbers, counts = np.unique(points.mesh, return_counts=True)
    rows = {}
    for number in numbers[np.argsort(-counts, kind="stable")]:
        mine = points.mesh == number
        if mine.sum() >= FEW:
            rows[w.scene.meshes[number].name] = waterfall([s[:, mine] for s in stages], scale)
    return rows


def _notes(w: World, reference: Reference, whole: Waterfall, other: bool) -> tuple[str, ...]:
    notes = []
    if not other:
        notes.append("every surface is diffuse, opaque and at rest: the first link is 0")
    if w.scene.settings.sampling.lod_distance is None:
        notes.append(
            "sampling.lod_distance is not set: all levels serve everywhere, and the last link is the device's arithmetic alone"
        )
    if w.scene.settings.sampling.normal_offset == 0.0:
        notes.append("sampling.normal_offset is 0: the sample offset is 0")
    if w.culled is w.uncut:
        notes.append("no probe was culled: that link is 0")
    if w.surfaces.method != "rays":
        notes.append(
            "the bake uses closed forms, its better counterpart rays: the link of form-factor noise holds both"
        )
    if w.scene.settings.sampling.reconstruction not in ("linear", "l2"):
        way = w.scene.settings.sampling.reconstruction
        notes.append(
            f"reconstruction '{way}' is not linear in the light: the SH order's link is what it makes of exact SH"
        )
    if reference.needed:
        notes.append(
            f"the noise of the reference, of {reference.spp:,} paths a point, is {100.0 * (1.0 - whole.explained):.1f} % of the "
            f"squared error over all cameras; for {100.0 * REMAINDER:.0f} % at most of each it would take about {reference.needed:,}"
        )
    return tuple(notes)
