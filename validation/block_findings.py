"""Bias that blocks of neighbouring camera points show: where light is wrong on the whole, found by Welch's test, and where it is shown
to be right, by two one-sided tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F64, I64
from ..reference.texture_types import Samples
from ..reference.truth.points import Points, PointSet
from .ground_truth import GroundTruth
from .record import metric
from .statistics.blocks import near_blocks
from .statistics.equivalence import equivalent
from .statistics.welch import Blocks, biased_blocks

BLOCK_POINTS = 25
ALPHA = 0.05
EQUAL_WITHIN = 0.02  # of the truth in the block (failure-catalogue F5)
SHOWN = 8


@dataclass(frozen=True)
class BlockFindings:
    """metrics by name and the worst blocks, as results.json holds them under `metrics` and `biased`."""

    metrics: dict[str, Any]
    biased: list[dict[str, Any]]


def block_findings(truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> BlockFindings:
    """biased_blocks: share of blocks of camera points whose mean is wrong beyond chance, Holm at ALPHA over all blocks. block_noise:
    median over blocks of three standard errors over the truth: the bias that can just be found. equal_blocks: share whose mean is
    shown to be within EQUAL_WITHIN of truth, each at ALPHA. Nothing where no camera sees a lit surface."""
    if "camera" not in truth.points or truth.estimates["camera"].irradiance.mean() <= 0.0:
        return BlockFindings({}, [])
    points, batches = truth.points["camera"], truth.estimates["camera"].irradiance
    ours = sampled["camera"].irradiance.astype(np.float64)
    block = near_blocks(points.positions, BLOCK_POINTS, None if points.camera is None else points.camera)
    found = biased_blocks(ours, batches, block, ALPHA)
    n, level = len(found.points), np.maximum(found.truth.mean(axis=1), 1e-30)
    seen = float(np.median(3.0 * found.se.mean(axis=1) / level))
    share = float(found.biased.mean())
    equal = float(_equal(found, len(batches)).mean())
    metrics = {
        "biased_blocks": metric(share, math.sqrt(share * (1.0 - share) / n), n),
        "block_noise": metric(seen, None, n),
        "equal_blocks": metric(equal, math.sqrt(equal * (1.0 - equal) / n), n),
    }
    return BlockFindings({k: v for k, v in metrics.items() if v is not None}, _worst(points, block, found))


def _equal(found: Blocks, batches: int) -> F64:
    """Whether each block is shown to be equal within EQUAL_WITHIN in every colour (intersection-union: no correction is needed)."""
    room = EQUAL_WITHIN * found.truth.mean(axis=1, keepdims=True)
    inside = equivalent(found.ours - found.truth, found.se, batches - 1, -room, room, ALPHA)
    return np.asarray(inside.all(axis=1), dtype=np.float64)


def _worst(points: Points, block: I64, found: Blocks) -> list[dict[str, Any]]:
    """The biased blocks that are furthest off, over the mean of all blocks' truth. position: the point nearest to a block's middle."""
    scale = float(found.truth.mean())
    relative = (found.ours - found.truth).mean(axis=1) / scale
    order = [int(i) for i in np.argsort(-np.abs(relative), kind="stable") if found.biased[i]][:SHOWN]
    rows = []
    for i in order:
        mine = np.flatnonzero(block == i)
        around = points.positions[mine]
        nearest = int(np.argmin(np.linalg.norm(around - around.mean(axis=0), axis=1)))
        rows.append(
            {
                "position": around[nearest].tolist(),
                "size_m": float(np.linalg.norm(np.ptp(around, axis=0))),
                "points": int(found.points[i]),
                "ours": found.ours[i].tolist(),
                "truth": found.truth[i].tolist(),
                "relative": float(relative[i]),
                "noise": float(found.se[i].mean() / scale),
                "p": float(found.p[i]),
            }
        )
    return rows
