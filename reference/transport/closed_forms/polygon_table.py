"""Padded polygons in device memory, with what the kernels ask of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...datatypes import F64
from ...device_arrays import to_f64
from .polygon_clip import bounds, longest_edges, normalised, vector_areas

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class Corners:
    """Polygons in device memory. host: padded (P, C, 3). corners: flat mi.Float64 (P·C·3). lower, upper: flat (P·3) corners
    of their bounds."""

    host: F64
    corners: Any
    lower: Any
    upper: Any

    @property
    def corner_count(self) -> int:
        """C."""
        return self.host.shape[1]


@dataclass(frozen=True, eq=False)
class PolygonTable(Corners):
    """Polygons with what judging them takes, per polygon: normal (flat, 3), radius and width, m."""

    normal: Any
    radius: Any
    width: Any


def upload_corners(host: F64) -> Corners:
    """Padded polygons (P, C, 3) m into device memory."""
    return Corners(host, *map(to_f64, (host, *bounds(host))))


def upload(host: F64) -> PolygonTable:
    """The same with normals, radii and widths."""
    lower, upper = bounds(host)
    radius = np.linalg.norm(host - 0.5 * (lower + upper)[:, None], axis=2).max(axis=1)
    areas = vector_areas(host)
    width = np.maximum(np.linalg.norm(areas, axis=1) / np.maximum(longest_edges(host), TINY), TINY)
    return PolygonTable(host, *map(to_f64, (host, lower, upper, normalised(areas), radius, width)))
