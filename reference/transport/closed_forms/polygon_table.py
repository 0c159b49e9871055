"""Padded polygons in device memory, with what the kernels ask of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...datatypes import F64
from ...device_arrays import to_f64
from .polygon_clip import unit_normals, vector_areas

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class PolygonTable:
    """Polygons in device memory. host: padded (P, C, 3). corners: flat mi.Float64 (P·C·3). The rest are per polygon:
    normal (flat, 3), lower, upper (flat, 3) corner of its bounds, radius and width, m."""

    host: F64
    corners: Any
    normal: Any
    lower: Any
    upper: Any
    radius: Any
    width: Any

    @property
    def corner_count(self) -> int:
        """C."""
        return self.host.shape[1]


def upload(host: F64) -> PolygonTable:
    """Padded polygons (P, C, 3) m into device memory."""
    lower, upper = host.min(axis=1), host.max(axis=1)
    radius = np.linalg.norm(host - 0.5 * (lower + upper)[:, None], axis=2).max(axis=1)
    longest = np.linalg.norm(np.roll(host, -1, axis=1) - host, axis=2).max(axis=1)
    width = np.maximum(np.linalg.norm(vector_areas(host), axis=1) / np.maximum(longest, TINY), TINY)
    return PolygonTable(host, *map(to_f64, (host, unit_normals(host), lower, upper, radius, width)))
