"""What culling did to the error of a baked scene against the ground truth, and what was foreseen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F64
from ...reference.texture_types import Samples
from ...reference.truth.points import PointSet
from ..bake import Baked, plain_samples
from ..ground_truth import GroundTruth
from ..metrics.error import Measured, jackknife, rel_rmse


def culled_metrics(
    baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples]
) -> tuple[dict[str, Measured], list[str]]:
    """culled_raise of every lit set: by how much of itself culling raised relRMSE, of the texture as the device stores it; and a
    sentence about what was foreseen. Nothing where no probe is culled."""
    culled = baked.probes.culled
    if culled is None:
        return {}, []
    if baked.uncut is None:
        return {}, [
            f"no probe was culled: none of {culled.able:,} with eight valid parents can go at placement.cull_error"
        ]
    found = {}
    for name, points in truth.points.items():
        batches = truth.estimates[name].irradiance
        if batches.mean() > 0.0:
            before = plain_samples(baked, baked.uncut, points).irradiance
            both = np.stack([sampled[name].irradiance, before]).astype(np.float64)
            found["culled_raise" + ("" if name == "camera" else f"_{name}")] = measure_raise(both, batches)
    return found, [_said(culled)]


def measure_raise(both: F64, batches: F64) -> Measured:
    """relRMSE after / before - 1; both (2, N, 3): after and before, batches (B, N, 3). Both have the same noise, so the standard
    error is that of the ratio."""
    return Measured(_raise(both, batches), jackknife(_raise, both, batches), both.shape[1])


def _raise(both: F64, batches: F64) -> float:
    before = rel_rmse(both[1], batches)
    return rel_rmse(both[0], batches) / before - 1.0 if before > 0.0 else 0.0


def _said(c: pipeline.Culled) -> str:
    return (
        f"{c.probes:,} of {c.able:,} probes with eight valid parents are culled (norm {c.norm}, damage up to "
        f"{c.threshold:.2g}); foreseen: {c.raise_expected:+.2%} error under the scene's own light, {c.raise_lightings:+.2%} at "
        f"worst under random lightings, odds of {c.odds_over:.2%} that a single patch's light gets worse than asked"
    )
