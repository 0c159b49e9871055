"""The waterfall of a scene measured: at the cameras' points, for each camera and each mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64
from ...reference.errors import InputError
from ...reference.progress import Progress
from ...reference.truth.points import Points
from ..metrics.error import cross_half_mse
from .chain import gathered_stages, in_parts
from .reference import Reference, finer, geometry_of, paths, relative_noise
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
    relative to the scene's mean light, most points first. reference: of the chain; notes: what a reader should know."""

    sets: dict[str, Waterfall]
    meshes: dict[str, Waterfall]
    reference: Reference
    noise: float
    notes: tuple[str, ...]


def measured(w: World, progress: Progress) -> Measured:
    """Stages at the cameras' points, and their statistics.

    Raises InputError for a scene whose cameras see no probe-lit surface, or only dark ones.
    """
    points = w.truth.points.get("camera")
    if points is None or w.truth.estimates["camera"].mean.mean() <= 0.0:
        raise InputError(
            f"scene '{w.scene.name}': no waterfall: its cameras see {'no probe-lit surface' if points is None else 'no light'}; "
            "add a camera that does"
        )
    progress("waterfall", 0, 2)
    stages = in_parts(points, AT_ONCE, lambda part: gathered_stages(w, part, RAYS))
    progress("waterfall", 1, 2)
    estimate = w.truth.estimates["camera"]
    reference = finer(
        w.scene, w.truth.geometry, points, Reference(estimate.irradiance, estimate.spp), stages[-1][0], w.seed, progress
    )
    diffuse = diffuse_stage(w, points, reference, enough_noise(reference, stages[-1][0]), progress)
    stages = [reference.irradiance, diffuse.irradiance, *stages]
    progress("waterfall", 2, 2)
    cameras = list(w.scene.settings.cameras)
    sets = {"camera": waterfall(stages)}
    for number, name in enumerate(cameras):
        mine = np.asarray(points.camera == number)
        if len(cameras) > 1 and mine.sum() >= FEW and stages[0][:, mine].mean() > 0.0:
            sets[f"camera {name}"] = waterfall([s[:, mine] for s in stages])
    noise = relative_noise(reference.irradiance)
    return Measured(sets, _meshes(w, points, stages), reference, noise, _notes(w, reference, diffuse is not reference))


def enough_noise(reference: Reference, ours: F64) -> float:
    """Relative noise that stage 1 may have, given what is sampled at the reference's points (N, 3).

    Noise of a stage between the ends cancels from every figure and only widens its interval: DIFFUSE_NOISE of the error is enough,
    where the reference takes more paths for its own end of the chain, whose noise no link explains.
    """
    error = math.sqrt(max(cross_half_mse(ours, reference.irradiance), 0.0)) / float(reference.irradiance.mean())
    return max(relative_noise(reference.irradiance), DIFFUSE_NOISE * error)


def diffuse_stage(w: World, points: Points, reference: Reference, noise: float, progress: Progress) -> Reference:
    """The points' light with what the bake sees (stage 1), until its relative `noise` or the reference's paths: the reference itself
    where the bake sees all."""
    baked = as_baked(w.scene)
    if baked is None:
        return reference
    return paths(baked, geometry_of(baked), points, noise, reference.spp, w.seed + 1, progress)


def _meshes(w: World, points: Points, stages: list[F64]) -> dict[str, Waterfall]:
    scale = float(stages[0].mean())
    numbers, counts = np.unique(points.mesh, return_counts=True)
    rows = {}
    for number in numbers[np.argsort(-counts, kind="stable")]:
        mine = points.mesh == number
        if mine.sum() >= FEW:
            rows[w.scene.meshes[number].name] = waterfall([s[:, mine] for s in stages], scale)
    return rows


def _notes(w: World, reference: Reference, other: bool) -> tuple[str, ...]:
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
            f"the reference has {reference.spp:,} paths a point; so that its noise is under 3 % of the squared error it would take "
            f"about {reference.needed:,}"
        )
    return tuple(notes)
