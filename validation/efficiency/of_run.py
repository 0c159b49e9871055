"""Placement efficiency of one run: its own placement against a few uniform grids. `bench placement` does it with more of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...reference.progress import Progress
from ...reference.texture_types import Samples
from ...reference.truth.points import PointSet
from ..bake import Baked
from ..ground_truth import GroundTruth
from ..record import metric
from .curve import Cost, GridRow, Key, bracketing_curve
from .eta import eta, own_cost
from .judged import Judge, judges

STEP, MOST, SHIFTS = 2.0, 4, 2
# Suffix of a metric → what is counted. The error is the placement-only one; `eta` itself is at equal relRMSE.
COSTS: Mapping[str, Cost] = {
    "_placement": "probes",
    "_placement_valid": "valid_probes",
    "_placement_bytes": "bytes",
}


@dataclass(frozen=True)
class Efficiency:
    """metrics and costs (what holds a measured time) by name and the grids measured, as results.json holds them; notes: why there
    are none."""

    metrics: dict[str, Any]
    cost: dict[str, float]
    grids: list[dict[str, Any]]
    notes: list[str]


def efficiency(
    baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples], seed: int, progress: Progress
) -> Efficiency:
    """eta, eta_placement and its kin over the cameras' points (else the surfaces'), and eta_camera_NAME of each of several."""
    asked = list(judges(baked.scene, truth, ("camera",))) or list(judges(baked.scene, truth, ("surface",)))
    way = baked.scene.settings.sampling.reconstruction
    if way != "linear":
        return Efficiency(
            {}, {}, [], [f"no placement efficiency: grids are read linearly, the scene's reconstruction is {way}"]
        )
    if not asked:
        return Efficiency({}, {}, [], ["no placement efficiency: no lit point is seen by a camera or lit by probes"])
    found_by = {j.name: sampled[j.points].irradiance.astype(np.float64) for j in asked}
    errors = {(j.name, kind): j.error(found_by[j.name], kind) for j in asked for kind in j.batches}
    blocks = {(j.name, kind): j.blocks(found_by[j.name], kind) for j in asked for kind in j.batches}
    own, first = own_cost(baked.cost), asked[0]
    curve = bracketing_curve(
        baked.scene, baked.surfaces, baked.light, truth, asked,
        {(first.name, kind): errors[first.name, kind].value for kind in first.batches},
        own["probes"], STEP, MOST, SHIFTS, seed, progress,
    )  # fmt: skip
    wanted: dict[str, tuple[Key, Cost]] = {"eta": ((first.name, "total"), "probes")}
    wanted |= {f"eta{suffix}": ((first.name, "placement"), cost) for suffix, cost in COSTS.items()}
    wanted |= {f"eta_{j.name}": ((j.name, "total"), "probes") for j in asked[1:]}
    metrics = {}
    for name, (key, cost) in wanted.items():
        found = eta(curve, key, cost, own[cost], errors[key].value, blocks[key])
        bound = {"bound": found.bound} if found.bound else {}
        metrics[name] = metric(found.value, found.se, errors[key].n, interval=list(found.interval), **bound)
    alone: Key = (first.name, "placement")
    slower = eta(curve, alone, "entries", own["entries"], errors[alone].value, blocks[alone]).value
    found_all = {name: m for name, m in metrics.items() if m is not None}
    return Efficiency(found_all, {"eta_placement_update": slower}, [_row(row, first) for row in curve], [])


def _row(row: GridRow, judge: Judge) -> dict[str, Any]:
    return {
        "voxel_m": row.voxel,
        "probes": round(row.cost["probes"]),
        "valid_probes": round(row.cost["valid_probes"]),
        "relrmse": row.error[judge.name, "total"],
        "placement_error": row.error[judge.name, "placement"],
    }
