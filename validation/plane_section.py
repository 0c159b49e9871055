"""Where a plane across an axis cuts triangles: the outlines of maps and plans."""

from __future__ import annotations

import numpy as np

from ..reference.datatypes import F64


def plane_section(corners: F64, axis: int, at: float) -> F64:
    """Lines (E, 2, 3) m in which triangles (T, 3, 3) cross the plane `axis` = `at`, m."""
    beyond = corners[:, :, axis] >= at
    mixed = beyond.any(axis=1) & ~beyond.all(axis=1)
    a, beyond = corners[mixed], beyond[mixed]
    b = np.roll(a, -1, axis=1)
    crosses = beyond != np.roll(beyond, -1, axis=1)  # two of the three edges
    a, b = a[crosses], b[crosses]
    share = (at - a[:, axis]) / (b - a)[:, axis]
    return np.asarray((a + share[:, None] * (b - a)).reshape(-1, 2, 3))
