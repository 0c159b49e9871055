"""Where a metric is worst: position, the voxel that answers there, and the probes whose light it is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F64
from ..reference.texture_types import Samples
from ..reference.truth.points import PointSet
from .bake import Baked, lifted, plain_samples
from .ground_truth import GroundTruth
from .leaks.measured import SETS, dark_boxes
from .leaks.weights import probe_weights
from .metrics.leaks import in_boxes


@dataclass(frozen=True, eq=False)
class Spot:
    """metric: its name in the record. position (3,) m; sampled_at (3,) m: where the texture is asked, off the surface. value: of the
    metric there, in its unit."""

    metric: str
    position: F64
    sampled_at: F64
    value: float


def place_rows(baked: Baked, spots: Sequence[Spot]) -> list[dict[str, Any]]:
    """The record's `places`: each spot with the level and size of the voxel that answers and its real probes by falling weight, which
    sum to 1 where there is any light. Virtual texels are taken apart into the real probes they are interpolated from."""
    if not spots:
        return []
    texture, probes = baked.texture, baked.probes
    at = np.stack([spot.sampled_at for spot in spots])
    w = probe_weights(texture, probes.layout, probes.light_from, at)
    rows = []
    for i, spot in enumerate(spots):
        mine = np.flatnonzero(w.sample == i)
        mine = mine[np.argsort(-w.weight[mine], kind="stable")]
        share = w.weight[mine] / max(float(w.weight[mine].sum()), 1e-30)
        level = int(w.level[i])
        row: dict[str, Any] = {
            "metric": spot.metric,
            "position": _triple(spot.position),
            "value": spot.value,
            "level": level,
        }
        if level:
            row["voxel_m"] = texture.finest * 2.0 ** (texture.level - level)
        row["probes"] = [
            {"position": _triple(probes.octree.positions[p]), "weight": float(s)}
            for p, s in zip(w.probe[mine][:8], share[:8], strict=True)
        ]
        rows.append(row)
    return rows


def receiver_spots(baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> list[Spot]:
    """Worst measured receivers: where boxes are dark of leaking and of lost light, of no light at all, of what culling changed."""
    names = [n for n in SETS if n in truth.points]
    if not names:
        return []
    where = np.concatenate([truth.points[n].positions for n in names])
    asked = np.concatenate([lifted(baked.scene, baked.texture, truth.points[n]) for n in names])
    ours = np.concatenate([sampled[n].irradiance.astype(np.float64) for n in names])
    reference = np.concatenate([truth.estimates[n].mean for n in names])
    unlit = np.concatenate([sampled[n].level == 0 for n in names])
    found: list[tuple[str, F64]] = []
    boxes = dark_boxes(baked.scene)
    dark = in_boxes(where, boxes) if boxes else np.zeros(len(where), np.bool_)
    lit_mean = float(reference[~dark].mean()) if not dark.all() else 0.0
    if dark.any() and lit_mean > 0.0:
        found.append(("leak_worst", np.where(dark, np.abs(ours).mean(axis=1) / lit_mean, 0.0)))
        bright = ~dark & (reference.mean(axis=1) > 0.01 * lit_mean)
        lost = np.maximum(reference - ours, 0.0).mean(axis=1) / np.maximum(reference.mean(axis=1), 1e-30)
        found.append(("overdark", np.where(bright, lost, 0.0)))
    if unlit.any() and lit_mean > 0.0:
        found.append(("unlit_share", np.where(unlit, reference.mean(axis=1) / lit_mean, 0.0)))
    if baked.uncut is not None and lit_mean > 0.0:
        before = np.concatenate([plain_samples(baked, baked.uncut, truth.points[n]).irradiance for n in names])
        found.append(("culled_raise", np.abs(ours - before).mean(axis=1) / lit_mean))
    worst = [(name, values, int(values.argmax())) for name, values in found]
    return [Spot(name, where[i], asked[i], float(values[i])) for name, values, i in worst if values[i] > 0.0]


def _triple(v: F64) -> list[float]:
    return [float(x) for x in v]
