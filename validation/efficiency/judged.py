"""Errors by set of points and camera, in two kinds: against the truth, and against exact L1 SH at the point.

The second is placement-only: what L1 cannot hold is in both, so only where probes stand, and how they are mixed, is left.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...reference.datatypes import F64, Bool, Scene
from ...reference.truth.points import PointSet
from ..ground_truth import GroundTruth
from ..metrics.error import Measured, cross_half_mse, measure_error
from ..statistics.jackknife import mixed_blocks

Kind = Literal["total", "placement"]
KINDS: tuple[Kind, ...] = ("total", "placement")


@dataclass(frozen=True, eq=False)
class Judge:
    """One set of points or one camera's part of it. name: "camera", "surface", "volume", "camera_NAME"; mask (N,)."""

    name: str
    points: PointSet
    mask: Bool
    batches: Mapping[Kind, F64]

    def blocks(self, ours: F64, kind: Kind) -> F64:
        """Mean square error of `ours` (N, 3) in each block of points (B,), relative to the squared mean of the whole reference.
        Blocks are always the same and equally large: their mean is that of all points, and two placements can be compared block
        by block."""
        reference = self.batches[kind]
        block = mixed_blocks(reference.shape[1])
        mine = ours[self.mask]
        return np.array(
            [cross_half_mse(mine[block == b], reference[:, block == b]) for b in range(int(block.max()) + 1)]
        ) / (float(reference.mean()) ** 2)

    def error(self, ours: F64, kind: Kind) -> Measured:
        """Relative RMSE of `ours` (N, 3) with its standard error."""
        return measure_error(ours[self.mask], self.batches[kind])["relrmse"]


def judges(scene: Scene, truth: GroundTruth, sets: tuple[PointSet, ...]) -> Iterator[Judge]:
    """All sets with light in them, and each camera of several ("one number hides the room")."""
    for name in sets:
        if name not in truth.points or truth.estimates[name].irradiance.mean() <= 0.0:
            continue
        yield _judge(truth, name, name, np.ones(len(truth.points[name].positions), dtype=np.bool_))
        cameras = list(scene.settings.cameras)
        if name == "camera" and len(cameras) > 1:
            for number, camera in enumerate(cameras):
                mine = np.asarray(truth.points[name].camera == number)
                if mine.any() and truth.estimates[name].irradiance[:, mine].mean() > 0.0:
                    yield _judge(truth, f"camera_{camera}", name, mine)


def _judge(truth: GroundTruth, name: str, points: PointSet, mask: Bool) -> Judge:
    estimate = truth.estimates[points]
    assert estimate.l1 is not None
    return Judge(name, points, mask, {"total": estimate.irradiance[:, mask], "placement": estimate.l1[:, mask]})
