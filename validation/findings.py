"""What is found out about a baked scene: errors by set of points, seams, twins, expectations, worst places."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..fastpath.device import OpenDevice
from ..fastpath.layout import Layout
from ..fastpath.sampler import Sampler
from ..reference import pipeline
from ..reference.datatypes import F32, Scene
from ..reference.texture_types import Samples
from ..reference.transport.direct import punctual_lights
from ..reference.truth.analytic import closed_sphere_radiosity
from ..reference.truth.path_traced import largest_albedo
from ..reference.truth.points import PointSet
from ..reference.volume.sampler import sample
from ..reference.volume.tiles import fill_tiles, probe_texels, with_copies
from .bake import Baked, lifted
from .culling.realised import culled_metrics
from .ground_truth import GroundTruth
from .leaks.measured import leak_metrics
from .metrics.dead_voxels import Kernel, measure_dead_voxels
from .metrics.error import Measured, measure_error, reference_noise, worst_points
from .metrics.exact import exact_biases
from .record import metric
from .seam_findings import seam_findings
from .spots import Spot, receiver_spots
from .structure_findings import structure

ABSENT: dict[PointSet, str] = {
    "camera": "no camera",
    "surface": "no mesh is lit by probes",
    "volume": "no probe volume",
}

GATHER_RAYS = 4096  # at most for patches alone: in `sphere` they leave 0.16 % of noise at a point, where truth has 4 %


@dataclass(frozen=True)
class Findings:
    """metrics by name, as results.json holds them; notes: why a metric is absent; spots: where metrics are worst."""

    metrics: dict[str, Any]
    notes: list[str]
    spots: list[Spot]


def find(
    baked: Baked, device: OpenDevice, truth: GroundTruth, sampled: Mapping[PointSet, Samples], seed: int, gated: bool = False
) -> Findings:  # fmt: skip
    """All metrics of a scene. sampled: kernel samples by set of points. gated: of the seams only what gates ask about."""
    metrics: dict[str, Any] = {}
    notes: list[str] = []
    _add(metrics, structure(baked, seed))
    _errors(metrics, notes, truth, sampled)
    notes += _doubts(baked.scene, truth)
    _camera_errors(metrics, baked, truth, sampled)
    _patch_errors(metrics, baked, truth, seed)
    seams = seam_findings(baked, truth, seed, gated)
    _add(metrics, seams.measured)
    notes += seams.notes
    if seams.measured:
        metrics["seam_sup"]["across_levels"] = seams.across_levels
    _twins(metrics, notes, baked, device, truth, sampled, seed)
    _expectations(metrics, notes, baked, truth, sampled)
    raised, said = culled_metrics(baked, truth, sampled)
    _add(metrics, raised)
    notes += said
    return Findings(metrics, notes, seams.spots + receiver_spots(baked, truth, sampled))


def _add(metrics: dict[str, Any], values: dict[str, Measured], suffix: str = "") -> None:
    for name, m in values.items():
        entry = metric(m.value, m.se, m.n, **extras(m))
        if entry is not None:
            metrics[name + suffix] = entry


def extras(m: Measured) -> dict[str, Any]:
    """What a metric of the record holds besides value, standard error and number."""
    found = {
        "below_noise": m.below_noise or None,
        "noise": m.noise,
        "interval": None if m.interval is None else list(m.interval),
    }
    return {name: value for name, value in found.items() if value is not None}


def _suffix(name: str) -> str:
    return "" if name == "camera" else f"_{name}"


def _errors(metrics: dict[str, Any], notes: list[str], truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> None:
    """relrmse, bias, p99, floor_l1, their ratio and the reference's noise, per set of points."""
    for name, why in ABSENT.items():
        if name not in truth.points:
            notes.append(f"no {name} metrics: the scene has no points there ({why})")
            continue
        e, s = truth.estimates[name], _suffix(name)
        if e.irradiance.mean() <= 0.0:
            notes.append(f"no {name} metrics: the reference is dark everywhere")
            continue
        ours = sampled[name].irradiance.astype(np.float64)
        found = measure_error(ours, e.irradiance)
        _add(metrics, found, s)
        assert e.l1 is not None
        floor = measure_error(e.l1, e.irradiance)["relrmse"]
        _add(metrics, {"floor_l1": floor}, s)
        if not (floor.below_noise or found["relrmse"].below_noise):
            _add(metrics, {"relrmse_over_floor": _ratio(found["relrmse"], floor)}, s)
        _add(metrics, {"reference_noise": reference_noise(e.irradiance)}, s)
        n, lost = e.irradiance.shape[1], float((sampled[name].level == 0).mean())
        _add(metrics, {"unlit_share": Measured(lost, np.sqrt(lost * (1 - lost) / n), n)}, s)


def _doubts(scene: Scene, truth: GroundTruth) -> list[str]:
    """What makes the reference itself doubtful for this scene."""
    notes = []
    lost = largest_albedo(scene) ** truth.depth
    if lost > scene.settings.truth.tolerance:
        notes.append(f"the truth's paths end after {truth.depth} bounces: up to {lost:.1%} of the light may be missing")
    through = [m.name for m in scene.materials if m.passes_light or m.opacity is not None]
    engine = any(m.engine_lit for m in scene.meshes) or (scene.sky is not None and scene.sky.engine_lit)
    if through and (engine or punctual_lights(scene, "engine")):
        notes.append(
            f"light tagged `engine` that passes {', '.join(through)} counts as indirect in the truth (or is not found by "
            "it, for punctual lights), but not in the bake"
        )
    return notes


def _camera_errors(
    metrics: dict[str, Any], baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples]
) -> None:
    """relrmse and bias of each camera's own points, relative to its own mean: one number hides the room."""
    cameras = list(baked.scene.settings.cameras)
    if len(cameras) < 2 or "camera" not in truth.points:
        return
    batches, ours = truth.estimates["camera"].irradiance, sampled["camera"].irradiance.astype(np.float64)
    for number, name in enumerate(cameras):
        mine = np.asarray(truth.points["camera"].camera == number)
        if mine.any() and batches[:, mine].mean() > 0.0:
            found = measure_error(ours[mine], batches[:, mine])
            _add(metrics, {k: found[k] for k in ("relrmse", "bias")}, f"_camera_{name}")


def _patch_errors(metrics: dict[str, Any], baked: Baked, truth: GroundTruth, seed: int) -> None:
    """patch_relrmse, patch_bias: the error of light gathered by rays straight from the patches, without probes. What is
    wrong already there, no placement can mend."""
    rays = min(baked.scene.settings.radiosity.rays, GATHER_RAYS)
    for name, points in truth.points.items():
        batches = truth.estimates[name].irradiance
        if batches.mean() <= 0.0:
            continue
        ours = pipeline.gather_at_points(
            baked.scene, baked.surfaces, baked.light, points.positions, points.normals, seed, rays
        )
        found = measure_error(ours, batches)
        _add(metrics, {"patch_relrmse": found["relrmse"], "patch_bias": found["bias"]}, _suffix(name))


def _ratio(a: Measured, b: Measured) -> Measured:
    value = a.value / b.value
    return Measured(value, value * float(np.hypot(a.se / a.value, b.se / b.value)), a.n)


def _twins(
    metrics: dict[str, Any], notes: list[str], baked: Baked, device: OpenDevice, truth: GroundTruth,
    sampled: Mapping[PointSet, Samples], seed: int,
) -> None:  # fmt: skip
    """Kernel against the NumPy specification, where cameras look and where no probe is valid, and the image path of the kernel against
    the buffer path."""
    name = next(iter(truth.points), None)
    if name is None:
        return
    points = truth.points[name]
    where = lifted(baked.scene, baked.texture, points)
    light = probe_texels(*with_copies(baked.coefficients, baked.probes.light_from))
    held = fill_tiles(baked.probes.layout, light, baked.storage)
    texture, way = dataclasses.replace(baked.texture, texels=held), baked.scene.settings.sampling.reconstruction
    plain = sample(texture, where, points.normals, reconstruction=way).irradiance
    scale = max(float(np.abs(plain).mean()), 1e-30)
    got = sampled[name].irradiance
    n = len(plain)
    found = {"kernel_deviation": Measured(float(np.abs(got - plain).max()) / scale, 0.0, n)}
    kernel: Kernel = baked.sampler
    if way != "l2" and min(device.info.image3d) > 0:  # images do not hold order 2
        other: Layout = "split" if baked.layout == "images" else "images"
        beside_sampler = Sampler(device, texture, baked.storage, other, way)
        beside = beside_sampler(where, points.normals).irradiance
        if other == "split":  # what texture units round is no fault of the kernel's
            kernel = beside_sampler
            found["kernel_deviation"] = Measured(float(np.abs(beside - plain).max()) / scale, 0.0, n)
        found["image_filter_deviation"] = Measured(float(np.abs(beside - got).max()) / scale, 0.0, n)
    dead = measure_dead_voxels(texture, baked.probes.layout, kernel, way, scale, seed)
    notes += [] if dead else ["no dead_voxel metrics: around every voxel some probe is valid"]
    _add(metrics, found | dead)


def _expectations(
    metrics: dict[str, Any], notes: list[str], baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples]
) -> None:
    """What the scene says of its right answer: dark boxes, closed forms, energy."""
    expect, patches = baked.scene.settings.expect, baked.surfaces.patches
    radiosity = baked.light.radiosity
    laws = baked.surfaces.laws
    defects = {
        "energy_residual": radiosity.energy_residual,
        "reciprocity_raw": laws.raw_reciprocity,
        "reciprocity": laws.reciprocity,
        "closure_averaged": laws.symmetric_closure,
        "closure": laws.closure,
    }
    _add(metrics, {name: Measured(value, 0.0, patches.count) for name, value in defects.items()})
    if expect.closed_sphere:
        exact = closed_sphere_radiosity(patches.area, patches.albedo, patches.exitance)
        error = float((np.abs(radiosity.radiosity - exact) / exact).max())
        _add(metrics, {"radiosity_error": Measured(error, 0.0, patches.count)})
        _add(metrics, exact_biases(baked.scene, truth, sampled))
    if expect.dark:
        try:
            _add(metrics, leak_metrics(baked, truth, sampled))
        except ValueError as error:
            notes.append(f"no leak metric: {error}")


def worst(truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> list[dict[str, Any]]:
    """The worst places of every set, beyond what noise explains."""
    rows = []
    for name, e in truth.estimates.items():
        ours = sampled[name].irradiance.astype(np.float64)
        mean, scale = e.mean, max(float(e.mean.mean()), 1e-30)
        for i in worst_points(ours, e.irradiance):
            rows.append(
                {
                    "set": name,
                    "position": _triple(truth.points[name].positions[i]),
                    "ours": _triple(ours[i]),
                    "truth": _triple(mean[i]),
                    "relative": float((ours[i] - mean[i]).mean() / scale),
                }
            )
    return rows


def _triple(v: npt.NDArray[np.floating] | F32) -> list[float]:
    return [float(x) for x in v]
