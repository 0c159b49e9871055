"""What gates ask about a scene, and nothing else: the main job without pictures, grids and sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...fastpath.device import OpenDevice
from ...reference import pipeline
from ...reference.datatypes import Scene
from ...reference.progress import silent
from ...reference.visibility import build_geometry
from .. import findings
from ..bake import bake, sample_points
from ..flight.plan import FlightPlan
from ..flight.record import flight_metrics
from ..flight.story import flown_through
from ..flight.world import world
from ..gates import Gates, Judgement, judge_scene
from ..ground_truth import ground_truth
from ..metrics.error import Measured
from ..metrics.pointers import measure_pointers
from ..metrics.validity import measure_validity
from ..placement_sweeps import as_metric

# Random grids beside the scene take minutes; no fault is caught by them alone.
NOT_MEASURED = ("eta",)
# Through `corridor`: once with room for all tiles that are wanted, once with too little. None may be read wrongly; what is missing in
# the second explains some differences, in the first nothing does.
FLIGHTS = (FlightPlan("orbit", frames=40, budget=500), FlightPlan("teleport", frames=12, budget=300))


def gate_metrics(scene: Scene, device: OpenDevice, seed: int, fly: bool = False) -> dict[str, Any]:
    """Metrics by name, as results.json holds them. fly: those of short flights too.

    Raises InputError as the main job does.
    """
    g = build_geometry(scene)
    pipeline.check_placement(scene, g)
    truth = ground_truth(scene, seed, silent, gated=True)
    surfaces = pipeline.bake_surfaces(scene, seed)
    light = pipeline.light_patches(scene, surfaces, seed)
    octree = pipeline.place(scene, surfaces, seed)
    baked = bake(scene, device, (surfaces, light), octree, seed, silent)
    pointers = measure_pointers(baked.texture, baked.probes.layout, seed)
    if pointers["wrong_pointers"].value > 0.0:  # who follows them may read past the cache: nothing is sampled
        return _entries(pointers)
    sampled = {name: sample_points(baked, points) for name, points in truth.points.items()}
    found = dict(findings.find(baked, device, truth, sampled, seed, gated=True).metrics)
    probes, tolerance = baked.probes, scene.settings.placement.backface_tolerance
    positions, voxel = probes.octree.positions, probes.octree.grid.wanted
    validity = measure_validity(g, positions, probes.rows.back_share, voxel, tolerance, seed)
    return found | _entries(validity.metrics) | (_flown(scene, device, seed) if fly else {})


def _entries(measured: Mapping[str, Measured]) -> dict[str, Any]:
    return {name: entry for name, m in measured.items() if (entry := as_metric(m)) is not None}


def _flown(scene: Scene, device: OpenDevice, seed: int) -> dict[str, Any]:
    """The worse of both flights, metric by metric."""
    through = world(scene, device, seed, silent)
    flights = [flight_metrics(flown_through(through, device, plan, silent)) for plan in FLIGHTS]
    return {name: max((f[name] for f in flights), key=lambda m: float(m["value"])) for name in flights[0]}


def flagged(name: str, metrics: dict[str, Any], gates: Gates, fly: bool = False) -> list[Judgement]:
    """The gates that scene `name` fails with these metrics."""
    limits = {
        metric: limit
        for metric, limit in gates.root[name].items()
        if not metric.startswith(NOT_MEASURED) and (fly or limit.only_with is None)
    }
    return [j for j in judge_scene(name, metrics, limits) if j.verdict == "fail"]
