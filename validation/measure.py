"""One scene, measured: bake, update, sample on the device, compare with the ground truth, picture by picture."""

from __future__ import annotations

import resource
import statistics
from collections.abc import Callable
from typing import Any

from ..fastpath.device import OpenDevice
from ..reference import pipeline
from ..reference.clock import Clock
from ..reference.datatypes import Scene
from ..reference.progress import Progress
from ..reference.visibility import build_geometry
from . import findings
from .bake import REPEATS, Baked, bake, lifted, sample_points
from .block_findings import block_findings
from .efficiency.of_run import efficiency
from .ground_truth import GroundTruth, ground_truth
from .image_findings import image_findings
from .pictures import scene_views
from .placement_findings import placement_findings
from .report.pictures import SceneView
from .report.voxel_maps import voxel_maps
from .spots import place_rows

Keep = Callable[[GroundTruth, Baked], None]


def measure_scene(
    scene: Scene, device: OpenDevice, seed: int, progress: Progress, keep: Keep | None = None
) -> tuple[dict[str, Any], list[SceneView]]:
    """The record of a scene (results.json, one of "scenes") and its pictures. keep: is given the truth and the bake, its probes from
    before culling among it, for who goes on with them."""
    clock = Clock()
    pipeline.check_placement(scene, build_geometry(scene))
    truth = ground_truth(scene, seed, progress)
    clock.lap("truth")
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    octree = pipeline.place(scene, surfaces, seed)
    clock.lap("surfaces and octree")
    bitmap = pipeline.bitmap(scene, octree.grid)
    clock.lap("bitmap, for its picture")
    baked = bake(scene, device, (surfaces, light), octree, seed, progress, keep_traced=keep is not None)
    clock.lap("probes")
    progress("metrics", 0, 1)
    sampled = {name: sample_points(baked, p) for name, p in truth.points.items()}
    found = findings.find(baked, device, truth, sampled, seed)
    placement = placement_findings(baked, truth, sampled, seed)
    grids = efficiency(baked, truth, sampled, seed, progress)
    blocks = block_findings(truth, sampled)
    views = scene_views(baked.scene, baked.probes, truth, lambda p: sample_points(baked, p).irradiance)
    images = image_findings(truth, views)
    record: dict[str, Any] = {
        "name": scene.name,
        "status": "ok",
        "metrics": found.metrics | blocks.metrics | images.metrics | placement.metrics | grids.metrics,
        "cost": {**_costs(baked, truth, clock.seconds), **grids.cost},
        "sampling": {"storage": baked.storage, "layout": baked.layout, "device": device.info.name},
        "counts_by_level": _levels(baked),
        "maps": voxel_maps(scene, octree, bitmap),
        **placement.tables,
        "grids": grids.grids,
        "worst": findings.worst(truth, sampled),
        "biased": blocks.biased,
        "places": place_rows(baked, [*found.spots, *placement.spots]),
        "images": images.images,
        "verdicts": [],
        "files": {},
        "notes": [*scene.notes, *bitmap.notes, *found.notes, *images.notes, *placement.notes, *grids.notes],
    }
    progress("metrics", 1, 1)
    if keep is not None:
        keep(truth, baked)
    return record, views


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
    cost["spectral_radius"] = light.radiosity.spectral_radius
    cost["bounces"] = light.radiosity.bounces
    for name, allocation in (("patch", surfaces.allocation), ("probe", baked.probes.allocation)):
        cost[f"{name}_rays"] = allocation.spent
        cost[f"{name}_rays_if_uniform"] = allocation.uniform
        cost[f"{name}_noise"] = allocation.reached
    cost["truth_s"] = truth.seconds
    cost["truth_paths"] = sum(e.spp * e.irradiance.shape[1] for e in truth.estimates.values())
    cost["truth_depth"] = truth.depth
    cost["peak_rss_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return cost


def _levels(baked: Baked) -> list[dict[str, Any]]:
    """Counts by level of the octree."""
    octree, layout, culled = baked.probes.octree, baked.probes.layout, baked.probes.culled
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
                "culled": int(culled.by_level[level]) if culled is not None else 0,
                "tiles": len(layout.parents[level - 1]) if level else 0,
            }
        )
    return rows
