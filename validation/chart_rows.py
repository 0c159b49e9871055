"""One row of the chart: a way to read a placement's probes, its error and leak, and what it costs."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F32, F64, I32, Bool, Scene
from ..reference.truth.points import Points
from .bake import REPEATS, Baked, lifted
from .ground_truth import GroundTruth
from .leaks.measured import dark_boxes
from .metrics.error import Measured, measure_rel_rmse
from .metrics.leaks import in_boxes, measure_leak

LEAST_TIMED = 1 << 17  # samples behind a sample cost: fewer would time the launch
# Irradiance (N, 3) at positions (N, 3) m, for normals (N, 3), of pixels on meshes (N,).
Sampled = Callable[[F64, F64, I32], F32]


@dataclass(frozen=True, eq=False)
class Shade:
    """Points of the scene's surfaces, some of them in the dark by construction: batches (B, N, 3) of the reference, dark (N,)."""

    points: Points
    batches: F64
    dark: Bool


@dataclass(frozen=True, eq=False)
class Target:
    """What all rows are measured at. batches (B, N, 3): the reference at `points`; pixels: of a camera, in order, where sampling is
    timed; shade: None for a scene without dark boxes."""

    points: Points
    batches: F64
    pixels: Points
    shade: Shade | None


@dataclass(frozen=True)
class Way:
    """A method and setting by name; bytes on the device and of the bake; what an update takes, ms; reader: has `seconds`, the device
    time of the last call of `sampled`; remark: what else there is to know."""

    method: str
    setting: str
    bytes: int
    update_ms: float
    reader: Any
    sampled: Sampled
    remark: str = ""


def find_shade(scene: Scene, truth: GroundTruth) -> Shade | None:
    """The camera's and surfaces' points of a scene that says where it is dark, None without them."""
    boxes, names = dark_boxes(scene), [n for n in ("camera", "surface") if n in truth.points]
    if not boxes or not names:
        return None
    parts = [truth.points[n] for n in names]
    points = Points(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.mesh for p in parts]),
    )
    dark = in_boxes(points.positions, boxes)
    batches = np.concatenate([truth.estimates[n].irradiance for n in names], axis=1)
    return Shade(points, batches, dark) if dark.any() and not dark.all() else None


def measured_row(baked: Baked, target: Target, way: Way) -> dict[str, Any]:
    """The row (results.json, one of a chart's "rows"); its leak where the scene has dark boxes."""

    def at(points: Points) -> F64:
        return way.sampled(lifted(baked.scene, baked.texture, points), points.normals, points.mesh).astype(np.float64)

    row = {
        "method": way.method,
        "setting": way.setting,
        "probes": int(baked.cost["real_probes"]),
        "valid_probes": int(baked.cost["valid_probes"]),
        "bytes": way.bytes,
        "update_ms": way.update_ms,
        "sample_ns": sample_cost(baked, target.pixels, way),
        "relrmse": _value(measure_rel_rmse(at(target.points), target.batches)),
        "remark": way.remark,
    }
    if target.shade is not None:
        found = measure_leak(at(target.shade.points), target.shade.batches, target.shade.dark)
        row |= {"leak": _value(found["leak"]), "overdark": _value(found["overdark"])}
    return row


def _value(m: Measured) -> dict[str, Any]:
    return {"value": m.value, "se": m.se, "n": m.n}


def sample_cost(baked: Baked, pixels: Points, way: Way) -> float:
    """Device time of one sample, ns: median of REPEATS calls at the pixels, as often in a call as it takes to be LEAST_TIMED."""
    times = max(1, -(-LEAST_TIMED // len(pixels.positions)))
    where = lifted(baked.scene, baked.texture, pixels)
    asked = np.tile(where, (times, 1)), np.tile(pixels.normals, (times, 1)), np.tile(pixels.mesh, times)
    way.sampled(*asked)
    seconds = []
    for _ in range(REPEATS):
        way.sampled(*asked)
        seconds.append(way.reader.seconds)
    return 1e9 * statistics.median(seconds) / len(asked[2])
