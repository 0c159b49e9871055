"""Light leaks: light where the reference is exactly 0 by construction, beside the light lost elsewhere.

    leak     = mean over the dark set of Ê / mean over the lit set of R
    overdark = mean over the lit set of max(R - Ê, 0) / R
    band     = mean over the lit band of (Ê - R) / mean over it of R

Always together, so that "black everywhere" does not win (failure-catalogue, Metrics, Leak). The band is what of the lit set lies
within one voxel of a wall to the dark: there light that leaked is missing.

Overdark is a mean of what was cut off at 0, to which the reference's noise would add. So one half of the reference says whether
light is missing, the other how much: right light then reads 0 in the mean, whatever the noise. Points with under 1 % of the lit mean,
where the relative loss is noise over noise, do not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...reference.datatypes import F64
from ...reference.turned import TurnedBox
from .error import Measured


def measure_leak(ours: F64, batches: F64, dark: np.ndarray) -> dict[str, Measured]:
    """leak, leak_worst, leak_area (share of dark points above 1e-3 of the lit mean), overdark.

    ours (N, 3); batches (B, N, 3) of the reference; dark (N,) bool. Raises ValueError if a set is empty or the dark set is not dark.
    """
    reference = batches.mean(axis=0)
    if not dark.any() or dark.all():
        raise ValueError(f"leak needs dark and lit points, got {int(dark.sum())} dark of {len(dark)}")
    if reference[dark].any():
        raise ValueError(
            f"the reference is not 0 in the dark set (worst {reference[dark].max():g}): the scene leaks itself"
        )
    lit_mean = float(reference[~dark].mean())
    share = np.abs(ours[dark]).mean(axis=1) / lit_mean
    lost = _lost(ours[~dark].mean(axis=1), batches[:, ~dark].mean(axis=2), 0.01 * lit_mean)

    def mean(values: F64) -> Measured:
        return Measured(float(values.mean()), float(values.std() / math.sqrt(len(values))), len(values))

    return {
        "leak": mean(share),
        "leak_worst": Measured(float(share.max()), 0.0, len(share)),
        "leak_area": mean((share > 1e-3).astype(np.float64)),
        "overdark": mean(lost),
    }


def _lost(ours: F64, batches: F64, least: float) -> F64:
    """max(R - ours, 0) / R of points brighter than `least`; ours (N,), batches (B, N). Single values may be under 0, see above."""
    bright = batches.mean(axis=0) > least
    mine, one, two = ours[bright], batches[0::2, bright].mean(axis=0), batches[1::2, bright].mean(axis=0)

    def by(judge: F64, other: F64) -> F64:
        return np.asarray((judge > mine) * (other - mine) / np.maximum(judge, least))

    return 0.5 * (by(one, two) + by(two, one))


def measure_band(ours: F64, reference: F64, band: np.ndarray) -> Measured | None:
    """Signed mean error over the lit band, relative to its mean light; negative: too dark. None where no light is in the band.

    ours, reference (N, 3); band (N,) bool.
    """
    mean = float(reference[band].mean()) if band.any() else 0.0
    if mean <= 0.0:
        return None
    error = (ours[band] - reference[band]).mean(axis=1) / mean
    return Measured(float(error.mean()), float(error.std() / math.sqrt(len(error))), len(error))


def in_boxes(positions: F64, boxes: Sequence[TurnedBox]) -> np.ndarray:
    """Whether positions (N, 3) lie in one of the boxes: (N,) bool."""
    inside = np.zeros(len(positions), dtype=np.bool_)
    for box in boxes:
        inside |= box.inside(positions)
    return inside
