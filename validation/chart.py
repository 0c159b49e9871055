"""Speed against accuracy: many placements of one scene on the same surfaces, lighting and ground truth.

Adaptive octrees at several thresholds and depths, uniform grids, and one sample per mesh (what the talk starts from);
each with its error, probes, bytes and update time, and whether it is on the Pareto front.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..fastpath.device import OpenDevice, open_device
from ..reference import pipeline
from ..reference.datatypes import F64, Scene
from ..reference.errors import InputError
from ..reference.lattice import Octree
from ..reference.progress import silent
from ..reference.truth.points import Points
from ..reference.variant import ensure_variant
from . import cache
from .bake import Baked, bake, sample_points
from .ground_truth import GroundTruth, ground_truth
from .metrics.error import measure_error
from .progress_bar import ProgressBar
from .provenance import provenance
from .report.chart import pareto_front
from .report.page import write_report
from .run import load_all, result_key

THRESHOLDS = (1.0, 1.5, 2.0, 3.0)
COARSER = (1, 2, 4)  # finest voxel, in multiples of the scene's
UNIFORM = (3, 5, 9, 13, 17)
COSTS = ("probes", "bytes", "update_ms")


@dataclass(frozen=True, eq=False)
class Setting:
    """One placement to measure. scene: with the setting's own controls."""

    method: str
    name: str
    scene: Scene
    octree: Octree


def chart_scenes(
    sources: Sequence[Path], overrides: Mapping[str, Any], seed: int, out: Path, quiet: bool, command: str
) -> dict[str, Any]:
    """Chart every scene into `out`; returns the results object, whose "charts" hold the rows.

    Raises InputError and EnvironmentLacks as `run_scenes` does.
    """
    ensure_variant()
    device = open_device()
    scenes = load_all(sources, overrides)
    charts = []
    for scene in scenes:
        with ProgressBar(scene.name, quiet) as progress:
            charts.append(chart(scene, device, seed, progress))
    results = {
        "schema": 1,
        "provenance": provenance(device, overrides, seed, command),
        "scenes": [],
        "charts": charts,
    }
    write_report(out, results, [])
    return results


def chart(scene: Scene, device: OpenDevice, seed: int, progress: ProgressBar) -> dict[str, Any]:
    """The chart of one scene (results.json, one of "charts"), from the cache if nothing changed."""
    name = result_key(scene, seed)
    kept = cache.load("chart", name)
    if kept is not None:
        value: dict[str, Any] = cache.unpack_json(kept["chart"])
        return value
    truth = ground_truth(scene, seed, progress)
    points, estimate = _points(scene, truth)
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    rows = []
    chosen = list(settings(scene, surfaces, seed))
    for done, s in enumerate(chosen):
        progress("chart", done, len(chosen))
        baked = bake(s.scene, device, (surfaces, light), s.octree, seed, silent)
        rows.append(_row(s, baked, sample_points(baked, points).irradiance.astype(np.float64), estimate.irradiance))
        if s.method == "adaptive" and s.name == _own_name(scene, s.octree):
            per_mesh = one_sample_per_mesh(scene, baked, points)
            rows.append(_row(Setting("per_mesh", "one sample per mesh", s.scene, s.octree), baked, per_mesh,
                             estimate.irradiance))  # fmt: skip
    progress("chart", len(chosen), len(chosen))
    _mark_fronts(rows)
    assert estimate.l1 is not None
    floor = measure_error(estimate.l1, estimate.irradiance)["relrmse"]
    value = {
        "scene": scene.name,
        "rows": rows,
        "floor": {"value": floor.value, "se": floor.se, "n": floor.n},
        "noise": {"value": estimate.noise, "n": len(points.positions)},
    }
    cache.store("chart", name, {"chart": cache.pack_json(value)})
    return value


def _points(scene: Scene, truth: GroundTruth) -> tuple[Points, Any]:
    """The set to chart: the cameras', else the surfaces'."""
    for name in ("camera", "surface"):
        if name in truth.points and truth.estimates[name].irradiance.mean() > 0:
            return truth.points[name], truth.estimates[name]
    raise InputError(f"scene '{scene.name}': nothing to chart, no lit point is seen by a camera or lit by probes")


def settings(scene: Scene, surfaces: pipeline.Surfaces, seed: int) -> Iterator[Setting]:
    """Adaptive placements (threshold × depth), then uniform grids of 3³ to 17³ (nodes along the longest side)."""
    own = pipeline.place(scene, surfaces, seed)
    for factor in COARSER:
        for threshold in sorted({*THRESHOLDS, scene.settings.placement.threshold}):
            changed = with_placement(scene, min_voxel=own.grid.finest * factor, threshold=threshold)
            octree = pipeline.place(changed, surfaces, seed)
            yield Setting("adaptive", _name(threshold, octree), changed, octree)
    lower, upper = pipeline.probe_bounds(scene, surfaces.geometry)
    for nodes in UNIFORM:
        octree = pipeline.place_uniform(scene, surfaces, uniform_voxel(float((upper - lower).max()), nodes))
        yield Setting("uniform", f"{nodes}³ grid, {octree.grid.finest:.3g} m", scene, octree)


def uniform_voxel(extent: float, nodes: int) -> float:
    """Voxel size, m, that puts `nodes` probes along `extent`, m, the outer ones beyond the bounds (see lattice.SHIFT)."""
    from ..reference.lattice import SHIFT

    return extent / (nodes - 1 - 2 * SHIFT - 1e-6)


def _name(threshold: float, octree: Octree) -> str:
    return f"threshold {threshold:g}, {octree.grid.finest:.3g} m"


def _own_name(scene: Scene, octree: Octree) -> str:
    """Name of the placement that the scene itself asks for, if `octree` has its finest voxel."""
    s = scene.settings.placement
    return _name(s.threshold, octree) if s.min_voxel in (None, octree.grid.finest) else ""


def with_placement(scene: Scene, **values: Any) -> Scene:
    """The scene with other placement settings."""
    import dataclasses

    placement = scene.settings.placement.model_copy(update=values)
    return dataclasses.replace(scene, settings=scene.settings.model_copy(update={"placement": placement}))


def one_sample_per_mesh(scene: Scene, baked: Baked, points: Points) -> F64:
    """Irradiance (N, 3) as engines do it for small meshes: probes sampled once, at the middle of the mesh's bounds, and
    its radiance SH evaluated at each point's own normal."""
    middles = np.stack([0.5 * (m.vertices.min(axis=0) + m.vertices.max(axis=0)) for m in scene.meshes])
    mesh = points.mesh
    return baked.sampler(middles[mesh], points.normals).irradiance.astype(np.float64)


def _row(s: Setting, baked: Baked, ours: F64, batches: F64) -> dict[str, Any]:
    """One row of the chart; bytes are those of probe form factors and texture, what placement decides."""
    m = measure_error(ours, batches)["relrmse"]
    probes = int(baked.cost["real_probes"])
    return {
        "method": s.method,
        "setting": s.name,
        "probes": probes,
        "valid_probes": int(baked.cost["valid_probes"]),
        "bytes": int(baked.cost["probe_bytes"] + baked.cost["texture_bytes"]),
        "update_ms": baked.cost["probe_update_ms"],
        "relrmse": {"value": m.value, "se": m.se, "n": m.n},
    }


def _mark_fronts(rows: list[dict[str, Any]]) -> None:
    error = [r["relrmse"]["value"] for r in rows]
    fronts = {c: pareto_front([r[c] for r in rows], error) for c in COSTS}
    for i, row in enumerate(rows):
        row["pareto"] = {c: bool(front[i]) for c, front in fronts.items()}
