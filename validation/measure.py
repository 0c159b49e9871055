"""One scene, measured: bake, update, sample on the device, compare with the ground truth, picture by picture."""

from __future__ import annotations

import dataclasses
import resource
import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..fastpath.device import OpenDevice
from ..fastpath.sampler import Sampler, Storage
from ..reference import pipeline
from ..reference.datatypes import F32, F64, Samples, Scene, VirtualTexture
from ..reference.progress import Progress
from ..reference.truth.analytic import closed_sphere_radiosity
from ..reference.truth.points import Points
from ..reference.volume.sampler import sample
from ..reference.volume.tiles import stored
from .ground_truth import GroundTruth, ground_truth
from .metrics.error import Measured, measure_error, worst_points
from .metrics.leaks import in_boxes, measure_leak
from .metrics.seams import measure_seams, seam_points
from .pictures import scene_views
from .record import metric
from .report.pictures import SceneView

STORAGE: Storage = "half16"
REPEATS = 5
SEAM_FORMATS: dict[Storage, str] = {"float32": "", "half16": "_half", "half8": "_half8"}


@dataclass(frozen=True, eq=False)
class Baked:
    """A scene through bake and update, and its texture on the device."""

    scene: Scene
    surfaces: pipeline.Surfaces
    probes: pipeline.Probes
    light: pipeline.PatchLight
    texture: VirtualTexture
    sampler: Sampler
    cost: dict[str, float]


def bake(
    scene: Scene, device: OpenDevice, surfaces: pipeline.Surfaces, light: pipeline.PatchLight,
    octree: pipeline.Octree, seed: int, progress: Progress,
) -> Baked:  # fmt: skip
    """Probes and texture over surfaces that are baked and lit; the update is timed warm."""
    probes = pipeline.bake_probes(scene, surfaces, octree, seed, progress)
    updates = [pipeline.update(scene, surfaces, probes, light) for _ in range(REPEATS)]
    texels = updates[0].texels
    texture = pipeline.virtual_texture(probes, texels)
    sampler = Sampler(device, texture, STORAGE)
    valid = int(probes.valid.sum())
    cost = {
        "real_probes": len(probes.valid),
        "valid_probes": valid,
        "invalid_probes": len(probes.valid) - valid,
        "virtual_probes": probes.layout.virtual_probes,
        "tiles": probes.layout.tiles,
        "probe_bytes": probes.rows.bytes,
        "texture_bytes": sampler.bytes,
        "probe_update_ms": 1e3 * statistics.median(sum(u.seconds.values()) for u in updates),
    }
    return Baked(scene, surfaces, probes, light, texture, sampler, cost)


def lifted(scene: Scene, texture: VirtualTexture, points: Points) -> F64:
    """Where a receiver is sampled: off its surface along the normal, in finest voxels; free points stay."""
    offset = scene.settings.sampling.normal_offset * texture.finest
    on_surface = points.mesh >= 0
    return points.positions + np.where(on_surface[:, None], offset, 0.0) * points.normals


def sample_points(baked: Baked, points: Points) -> Samples:
    """Kernel samples at receivers."""
    return baked.sampler(lifted(baked.scene, baked.texture, points), points.normals)


def measure_scene(
    scene: Scene, device: OpenDevice, seed: int, progress: Progress
) -> tuple[dict[str, Any], list[SceneView]]:
    """The record of a scene (results.json, one of "scenes") and its pictures."""
    clock = pipeline.Clock()
    truth = ground_truth(scene, seed, progress)
    clock.lap("truth")
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    octree = pipeline.place(scene, surfaces, seed)
    clock.lap("surfaces and octree")
    baked = bake(scene, device, surfaces, light, octree, seed, progress)
    clock.lap("probes")
    metrics: dict[str, Any] = {}
    notes = list(scene.notes)
    progress("metrics", 0, 1)
    sampled = {name: sample_points(baked, p) for name, p in truth.points.items()}
    _errors(metrics, notes, truth, sampled)
    _seams(metrics, baked, truth, seed)
    _twins(metrics, baked, device, truth, sampled)
    _expectations(metrics, notes, baked, truth, sampled)
    record = {
        "name": scene.name,
        "status": "ok",
        "metrics": metrics,
        "cost": _costs(baked, truth, clock.seconds),
        "counts_by_level": _levels(baked),
        "worst": _worst(truth, sampled),
        "verdicts": [],
        "files": {},
        "notes": notes,
    }
    views = scene_views(baked.scene, baked.probes, truth, lambda p: sample_points(baked, p).irradiance)
    progress("metrics", 1, 1)
    return record, views


def _add(metrics: dict[str, Any], values: dict[str, Measured], suffix: str = "") -> None:
    for name, m in values.items():
        extra = {"below_noise": True} if m.below_noise else {}
        entry = metric(m.value, m.se, m.n, **extra)
        if entry is not None:
            metrics[name + suffix] = entry


def _suffix(name: str) -> str:
    return "" if name == "camera" else f"_{name}"


def _errors(metrics: dict[str, Any], notes: list[str], truth: GroundTruth, sampled: dict[Any, Samples]) -> None:
    """relrmse, bias, p99, floor_l1, their ratio and the reference's noise, per set of points."""
    for name in ("camera", "surface", "volume"):
        if name not in truth.points:
            why = {"camera": "no camera", "surface": "no mesh is lit by probes", "volume": "no probe volume"}[name]
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
        n = e.irradiance.shape[1]
        _add(metrics, {"reference_noise": Measured(e.noise, e.noise / np.sqrt(2 * n * 3 * 7), n)}, s)
        lost = float((sampled[name].level == 0).mean())
        _add(metrics, {"unlit_share": Measured(lost, np.sqrt(lost * (1 - lost) / n), n)}, s)


def _ratio(a: Measured, b: Measured) -> Measured:
    value = a.value / b.value
    return Measured(value, value * float(np.hypot(a.se / a.value, b.se / b.value)), a.n)


def _seams(metrics: dict[str, Any], baked: Baked, truth: GroundTruth, seed: int) -> None:
    """Border jumps near surfaces and everywhere else, in each storage format."""
    texture = baked.texture
    near = np.concatenate([lifted(baked.scene, texture, p) for p in truth.points.values()])
    points = seam_points(texture, (near - texture.origin) / texture.finest, seed)
    for storage, suffix in SEAM_FORMATS.items():
        found = measure_seams(dataclasses.replace(texture, texels=stored(texture.texels, storage)), points, suffix)
        keep = found if storage == "float32" else {k: v for k, v in found.items() if k.startswith("seam_sup")}
        _add(metrics, keep)
    metrics["seam_sup"]["across_levels"] = points.across_levels


def _twins(
    metrics: dict[str, Any], baked: Baked, device: OpenDevice, truth: GroundTruth, sampled: dict[Any, Samples]
) -> None:
    """Kernel against the NumPy specification, and the image path of the kernel against the buffer path."""
    name = next(iter(truth.points))
    points = truth.points[name]
    where = lifted(baked.scene, baked.texture, points)
    stored_texture = dataclasses.replace(baked.texture, texels=stored(baked.texture.texels, STORAGE))
    plain = sample(stored_texture, where, points.normals).irradiance
    scale = max(float(np.abs(plain).mean()), 1e-30)
    got = sampled[name].irradiance
    images = Sampler(device, baked.texture, STORAGE, images=True)(where, points.normals).irradiance
    n = len(plain)
    _add(metrics, {"kernel_deviation": Measured(float(np.abs(got - plain).max()) / scale, 0.0, n)})
    _add(metrics, {"image_filter_deviation": Measured(float(np.abs(images - got).max()) / scale, 0.0, n)})


def _expectations(
    metrics: dict[str, Any], notes: list[str], baked: Baked, truth: GroundTruth, sampled: dict[Any, Samples]
) -> None:
    """What the scene says of its right answer: dark boxes, closed forms, energy."""
    expect, patches = baked.scene.settings.expect, baked.surfaces.patches
    radiosity = baked.light.radiosity
    _add(metrics, {"energy_residual": Measured(radiosity.energy_residual, 0.0, patches.count)})
    if expect.closed_sphere:
        exact = closed_sphere_radiosity(patches.area, patches.albedo, patches.exitance)
        error = float((np.abs(radiosity.radiosity - exact) / exact).max())
        _add(metrics, {"radiosity_error": Measured(error, 0.0, patches.count)})
    if expect.dark:
        boxes = [(np.asarray(b.min), np.asarray(b.max)) for b in expect.dark.values()]
        names = [n for n in ("surface", "volume", "camera") if n in truth.points]
        where = np.concatenate([truth.points[n].positions for n in names])
        ours = np.concatenate([sampled[n].irradiance.astype(np.float64) for n in names])
        reference = np.concatenate([truth.estimates[n].mean for n in names])
        try:
            _add(metrics, measure_leak(ours, reference, in_boxes(where, boxes)))
        except ValueError as error:
            notes.append(f"no leak metric: {error}")


def _costs(baked: Baked, truth: GroundTruth, seconds: dict[str, float]) -> dict[str, float]:
    """Counts, bytes and times; the sample cost is the kernel's device time over the camera's pixels, median of five."""
    surfaces, light = baked.surfaces, baked.light
    largest = max(truth.views.values(), key=lambda v: len(v.points.positions), default=None)
    cost = dict(baked.cost)
    if largest is not None:
        where, times = lifted(baked.scene, baked.texture, largest.points), []
        for _ in range(REPEATS):
            baked.sampler(where, largest.points.normals)
            times.append(baked.sampler.seconds)
        cost["sample_ns"] = 1e9 * statistics.median(times) / len(where)
    cost["patches"] = surfaces.patches.count
    cost["bake_bytes"] = surfaces.rows.bytes + baked.probes.rows.bytes
    cost["bake_s"] = seconds["surfaces and octree"] + seconds["probes"]
    cost["patch_update_ms"] = 1e3 * sum(light.seconds.values())
    cost["update_ms"] = cost["patch_update_ms"] + cost["probe_update_ms"]
    cost["radiosity_iterations"] = light.radiosity.iterations
    cost["truth_s"] = truth.seconds
    cost["truth_paths"] = sum(e.spp * e.irradiance.shape[1] for e in truth.estimates.values())
    cost["truth_depth"] = truth.depth
    cost["peak_rss_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return cost


def _levels(baked: Baked) -> list[dict[str, Any]]:
    """Counts by level of the octree."""
    octree, layout = baked.probes.octree, baked.probes.layout
    rows = []
    for level, voxels in enumerate(octree.voxels):
        mine = octree.corner_level == level
        rows.append(
            {
                "level": level,
                "voxel_m": octree.grid.size(level),
                "voxels": len(voxels),
                "real": int(mine.sum()),
                "invalid": int((mine & ~baked.probes.valid).sum()),
                "virtual": int(layout.virtual_by_level[level - 1]) if level else 0,
                "tiles": len(layout.parents[level - 1]) if level else 0,
            }
        )
    return rows


def _worst(truth: GroundTruth, sampled: dict[Any, Samples]) -> list[dict[str, Any]]:
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
