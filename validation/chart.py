"""Speed against accuracy: many placements of one scene on the same surfaces, lighting and ground truth.

Adaptive octrees at several thresholds and depths, uniform grids, and, at each depth, the same probes read in other ways
(`chart_ways`); each with its error, probes, bytes, update time and sample cost, and whether it is on the Pareto front.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..fastpath.device import OpenDevice, open_device
from ..reference import pipeline
from ..reference.datatypes import F32, F64, I32, Scene
from ..reference.errors import InputError
from ..reference.lattice import SHIFT, Octree
from ..reference.progress import silent
from ..reference.truth.points import Points
from ..reference.variant import ensure_variant
from ..reference.visibility import build_geometry
from . import cache
from .bake import Baked, bake
from .chart_rows import Target, Way, find_shade, measured_row
from .chart_ways import way_rows
from .ground_truth import GroundTruth, ground_truth
from .metrics.error import measure_error
from .progress_bar import ProgressBar
from .provenance import provenance
from .report.chart import costs, pareto_front
from .report.page import write_report
from .run import load_all, result_key

THRESHOLDS = (0.5, 1.0, 2.0, 3.0)
COARSER = (1, 2, 4)  # finest voxel, in multiples of the scene's
UNIFORM = (3, 5, 9, 13, 17)
COSTS = ("probes", "bytes", "update_ms", "sample_ns")


@dataclass(frozen=True, eq=False)
class Setting:
    """One placement to measure. scene: with the setting's own controls. ways: its probes are read in other ways, too."""

    method: str
    name: str
    scene: Scene
    octree: Octree
    ways: bool = False


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
    return write_report(out, results, [])


def chart(scene: Scene, device: OpenDevice, seed: int, progress: ProgressBar) -> dict[str, Any]:
    """The chart of one scene (results.json, one of "charts"), from the cache if nothing changed."""
    name = result_key(scene, seed, device)
    kept = cache.load("chart", name)
    if kept is not None:
        value: dict[str, Any] = cache.unpack_json(kept["chart"])
        return value
    pipeline.check_placement(scene, build_geometry(scene))
    truth = ground_truth(scene, seed, progress)
    points, estimate = _points(scene, truth)
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    pixels = max((v.points for v in truth.views.values()), key=lambda p: len(p.positions), default=points)
    target = Target(points, estimate.irradiance, pixels, find_shade(scene, truth))
    rows = []
    chosen = list(settings(scene, surfaces, seed))
    for done, s in enumerate(chosen):
        progress("chart", done, len(chosen))
        baked = bake(s.scene, device, (surfaces, light), s.octree, seed, silent)
        rows.append(_row(s, baked, target))
        if s.ways:
            rows += way_rows(baked, s.name, device, target)
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
    own, asked = pipeline.place(scene, surfaces, seed), scene.settings.placement.threshold
    seen: set[bytes] = set()
    for factor in COARSER:
        for threshold in sorted({*THRESHOLDS, asked}, key=lambda t: (t != asked, t)):
            changed = with_placement(scene, min_voxel=own.grid.finest * factor, threshold=threshold)
            octree = pipeline.place(changed, surfaces, seed)
            key = octree.corners.tobytes()
            if key not in seen:  # thresholds may agree
                seen.add(key)
                yield Setting("adaptive", _name(threshold, octree), changed, octree, threshold == asked)
                if threshold == asked and scene.settings.sampling.reconstruction != "l2":
                    yield Setting("l2", _name(threshold, octree), with_order_2(changed), octree)
    lower, upper = pipeline.probe_bounds(scene, surfaces.geometry)
    for nodes in UNIFORM:
        octree = pipeline.place_uniform(scene, surfaces, uniform_voxel(float((upper - lower).max()), nodes))
        plain = with_placement(scene, cull_error=None)
        yield Setting("uniform", f"{nodes}³ grid, {octree.grid.finest:.3g} m", plain, octree)


def uniform_voxel(extent: float, nodes: int) -> float:
    """Voxel size, m, that puts `nodes` probes along `extent`, m, the outer ones beyond the bounds (see lattice.SHIFT)."""
    return extent / (nodes - 1 - 2 * SHIFT - 1e-6)


def _name(threshold: float, octree: Octree) -> str:
    return f"threshold {threshold:g}, {octree.grid.finest:.3g} m"


def with_placement(scene: Scene, **values: Any) -> Scene:
    """The scene with other placement settings."""
    placement = scene.settings.placement.model_copy(update=values)
    return dataclasses.replace(scene, settings=scene.settings.model_copy(update={"placement": placement}))


def with_order_2(scene: Scene) -> Scene:
    """The scene with light of order 2 in its probes."""
    sampling = scene.settings.sampling.model_copy(update={"reconstruction": "l2"})
    return dataclasses.replace(scene, settings=scene.settings.model_copy(update={"sampling": sampling}))


def _row(s: Setting, baked: Baked, target: Target) -> dict[str, Any]:
    """The virtual texture's own row; bytes are those of probe form factors and texture, what placement decides."""
    size = int(baked.cost["probe_bytes"] + baked.cost["texture_bytes"])

    def sampled(positions: F64, normals: F64, _: I32) -> F32:
        return np.asarray(baked.sampler(positions, normals).irradiance, dtype=np.float32)

    way = Way(s.method, s.name, size, baked.cost["probe_update_ms"], baked.sampler, sampled)
    return measured_row(baked, target, way)


def _mark_fronts(rows: list[dict[str, Any]]) -> None:
    error = [r["relrmse"]["value"] for r in rows]
    fronts = {c: pareto_front(costs(rows, c), error) for c in COSTS}
    for i, row in enumerate(rows):
        row["pareto"] = {c: bool(front[i]) for c, front in fronts.items()}
