"""Planar polygons in float64: normals, areas, and what lies in front of a plane.

Clipping: Sutherland and Hodgman 1974, "Reentrant polygon clipping", one plane at a time. Where a polygon that is not
convex falls apart, its pieces stay joined by edges along the plane that run forth and back: contour integrals over
them cancel, so they may stay.

Polygons come padded: `polygons` (P, C, 3) f64 m, `sizes` (P,) corners that count, counter-clockwise from the front.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from ...datatypes import F64, I64

# Heights within this many roundings of a polygon's plane lie on it: 16 leaves room for a rotated frame.
ROUNDINGS = 16.0
EPSILON = float(np.finfo(np.float64).eps)


def padded(polygons: F64, sizes: I64) -> F64:
    """The polygons with every place past `sizes` holding the last corner that counts: edges of no length."""
    place = np.minimum(np.arange(polygons.shape[1])[None, :], sizes[:, None] - 1)
    return np.take_along_axis(np.asarray(polygons, dtype=np.float64), place[:, :, None], axis=1)


def by_coordinate(polygons: F64) -> F64:
    """Polygons (P, C, 3) as (3, C, P): NumPy is many times faster along an axis of P than along one of three."""
    return np.ascontiguousarray(polygons.transpose(2, 1, 0))


def bounds(polygons: F64) -> tuple[F64, F64]:
    """Smallest and largest corner (P, 3), (P, 3) of the boxes around polygons (P, C, 3)."""
    places = by_coordinate(polygons)
    return np.ascontiguousarray(places.min(axis=1).T), np.ascontiguousarray(places.max(axis=1).T)


def vector_areas(polygons: F64) -> F64:
    """Normal times area (P, 3) m² of padded polygons (Newell's sum), from corners relative to the first. Corners are added one after
    the other: NumPy's own sum goes another way round where there is one polygon, and a polygon alone must read the same."""
    r = by_coordinate(polygons - polygons[:, :1])
    s = np.roll(r, -1, axis=1)
    return 0.5 * np.stack([reduce(np.add, r[a] * s[b] - r[b] * s[a]) for a, b in ((1, 2), (2, 0), (0, 1))], axis=1)


def longest_edges(polygons: F64) -> F64:
    """Length (P,) m of each polygon's longest edge."""
    corners = by_coordinate(polygons - polygons[:, :1])
    return np.asarray(np.sqrt(((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=0).max(axis=0)))


def unit_normals(polygons: F64) -> F64:
    """Unit normals (P, 3) of padded polygons; 0 for those without area."""
    return normalised(vector_areas(polygons))


def normalised(areas: F64) -> F64:
    """Unit normals (P, 3) of vector areas (P, 3); 0 for those without length."""
    return areas / np.maximum(np.linalg.norm(areas, axis=1), np.finfo(np.float64).tiny)[:, None]


def plane_tolerances(polygons: F64, areas: F64, spans: F64, magnitudes: F64) -> F64:
    """Height (P,) m under which a point counts as lying in the polygon's plane.

    areas (P, 3): vector areas. spans (P,): how far from the polygon points are judged. magnitudes (P,): largest coordinate
    that took part. The corners are known to `EPSILON` · magnitude; over the polygon's width that error tilts the plane.
    """
    width = np.linalg.norm(areas, axis=1) / np.maximum(longest_edges(polygons), np.finfo(np.float64).tiny)
    lever = 1.0 + spans / np.maximum(width, np.finfo(np.float64).tiny)
    return np.asarray(ROUNDINGS * EPSILON * magnitudes * np.minimum(lever, 1e6))


def clip_polygons(polygons: F64, heights: F64, tolerances: F64) -> tuple[F64, I64]:
    """What lies at heights ≥ 0.

    polygons (N, C, 3), padded; heights (N, C) of the corners above the cutting plane; tolerances (N,): smaller heights
    are 0. Returns padded polygons (N, D, 3) with D ≥ 1 and their sizes (N,), 0 where no corner is above the plane.
    A cut is computed from its upper to its lower end, so that polygons that share the edge share the new corner.
    """
    h = np.where(np.abs(heights) <= tolerances[:, None], 0.0, heights)
    cut = np.flatnonzero((h < 0.0).any(axis=1) | (h <= 0.0).all(axis=1))
    sizes = np.full(len(h), h.shape[1])
    if len(cut) == 0:
        return polygons, sizes
    parts, sizes[cut] = _cut(polygons[cut], h[cut])
    width = max(polygons.shape[1], parts.shape[1])
    out, parts = (
        np.concatenate([x, np.repeat(x[:, -1:], width - x.shape[1], axis=1)], axis=1) for x in (polygons, parts)
    )
    out[cut] = parts
    return out, sizes


def _cut(polygons: F64, h: F64) -> tuple[F64, I64]:
    """`clip_polygons` where heights `h` are exact."""
    following, h_next = np.roll(polygons, -1, axis=1), np.roll(h, -1, axis=1)
    crosses = (h * h_next) < 0.0
    upper = np.where((h > 0.0)[..., None], polygons, following)
    lower = np.where((h > 0.0)[..., None], following, polygons)
    share = np.maximum(h, h_next) / np.where(crosses, np.abs(h - h_next), 1.0)
    cuts = upper + share[..., None] * (lower - upper)
    some = (h > 0.0).any(axis=1, keepdims=True)
    n, c = h.shape
    slots = np.stack([polygons, cuts], axis=2).reshape(n, 2 * c, 3)
    counts = np.stack([(h >= 0.0) & some, crosses], axis=2).reshape(n, 2 * c)
    sizes = counts.sum(axis=1)
    order = np.argsort(~counts, axis=1, kind="stable")[:, : max(1, int(sizes.max(initial=1)))]
    kept = np.take_along_axis(slots, order[:, :, None], axis=1)
    return padded(kept, np.maximum(sizes, 1)), sizes


def clip_polygon(polygon: F64, heights: F64, tolerance: float = 0.0) -> F64:
    """What of one polygon (n, 3) lies at heights (n,) ≥ 0: (m, 3), m = 0 where no corner is above the plane."""
    clipped, sizes = clip_polygons(polygon[None], heights[None], np.array([tolerance]))
    return clipped[0, : int(sizes[0])]


def heights_over(normals: F64, corner: F64, points: F64) -> F64:
    """Heights (N, K) m of points (N, K, 3) over planes through `corner` (N, 3) with unit `normals` (N, 3)."""
    return np.asarray(np.einsum("nkc,nc->nk", points - corner[:, None, :], normals))


def mutually_visible(first: F64, second: F64) -> tuple[F64, F64, I64, I64]:
    """Of each pair of padded polygons (N, C, 3), (N, D, 3) the parts in front of the other's plane.

    Returns both parts, padded, and their sizes (N,), both 0 where either sees nothing of the other. For planar
    polygons nothing else is hidden by the horizon, so the contour integral over the parts is exact.
    """
    both = np.concatenate([first, second], axis=1)
    lower, upper = bounds(both)
    spans = np.linalg.norm(upper - lower, axis=1)
    magnitudes = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1)
    area_1, area_2 = vector_areas(first), vector_areas(second)
    tolerance_1 = plane_tolerances(first, area_1, spans, magnitudes)
    tolerance_2 = plane_tolerances(second, area_2, spans, magnitudes)
    part_2, size_2 = clip_polygons(second, heights_over(normalised(area_1), first[:, 0], second), tolerance_1)
    part_1, size_1 = clip_polygons(first, heights_over(normalised(area_2), second[:, 0], first), tolerance_2)
    seen = (size_1 > 2) & (size_2 > 2)
    return part_1, part_2, np.where(seen, size_1, 0), np.where(seen, size_2, 0)
