"""Form factors from points: Lambert's formula, and Gauss points over a polygon that each use it.

    F(point → polygon) = 1/2π Σ edges  angle(r_k, r_k+1) · n · (r_k × r_k+1) / |r_k × r_k+1|          (Lambert 1760)

Exact for any planar polygon above the point's horizon; below it the polygon is clipped first.
"""

from __future__ import annotations

import math

import numpy as np

from ...datatypes import F64
from .polygon_clip import clip_polygon, vector_areas

TINY = float(np.finfo(np.float64).tiny)


def edge_vectors(points: F64, polygon: F64) -> F64:
    """Σ over edges of angle × unit normal of the plane through point and edge: (N, 3) for points (N, 3).

    Positive along what sees the polygon's front. Corners at a point, and edges of no length, contribute nothing.
    """
    r = polygon[None, :, :] - points[:, None, :]
    s = np.roll(r, -1, axis=1)
    cross = np.cross(s, r)
    length = np.linalg.norm(cross, axis=2)
    angle = np.arctan2(length, np.einsum("nck,nck->nc", r, s))
    return np.asarray((cross * (angle / np.maximum(length, TINY))[..., None]).sum(axis=1))


def point_form_factor(position: F64, normal: F64, polygon: F64) -> float:
    """Form factor from a surface element at `position` (3,) m with unit `normal` (3,) to the front of `polygon` (n, 3).

    Exactly 0 where the element is behind the polygon or in its plane, and where the polygon is below the horizon.
    """
    position, polygon = np.asarray(position, dtype=np.float64), np.asarray(polygon, dtype=np.float64)
    normal = np.asarray(normal, dtype=np.float64)
    area = vector_areas(polygon[None])[0]
    size = float(np.linalg.norm(polygon - position, axis=1).max())
    height = float(np.dot(position - polygon[0], area)) / max(float(np.linalg.norm(area)), TINY)
    tolerance = 1e-14 * max(size, float(np.abs(polygon).max()), float(np.abs(position).max()))
    if height <= tolerance:
        return 0.0
    above = clip_polygon(polygon, (polygon - position) @ normal, tolerance)
    if len(above) < 3:
        return 0.0
    return max(0.0, float(edge_vectors(position[None], above)[0] @ normal) / (2.0 * math.pi))


def gauss_square(count: int) -> tuple[F64, F64, F64]:
    """`count`² Gauss-Legendre nodes u, v in the unit square and their weights, each (count²,)."""
    x, w = np.polynomial.legendre.leggauss(count)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    return np.repeat(x, count), np.tile(x, count), np.outer(w, w).ravel()


def quads_of(corners: int) -> list[tuple[int, int, int, int]]:
    """Corner numbers of quadrilaterals that make up a polygon as a fan; the last may be a triangle, one corner doubled."""
    return [(0, k, k + 1, min(k + 2, corners - 1)) for k in range(1, corners - 1, 2)]


def bilinear(quad: F64, u: F64, v: F64) -> tuple[F64, F64]:
    """Points (N, 3) of the bilinear map of a planar quad (4, 3), and normal times area density there (N, 3), signed.

    Signed densities make integrals right over quads that are not convex too, for functions smooth around them.
    """
    a, b, c, d = quad
    along = (1.0 - v)[:, None] * (b - a) + v[:, None] * (c - d)
    across = (1.0 - u)[:, None] * (d - a) + u[:, None] * (c - b)
    points = a + u[:, None] * (b - a) + v[:, None] * across
    return points, np.asarray(np.cross(along, across))


def gauss_lambert(emitter: F64, receiver: F64, count: int) -> float:
    """Area times form factor, m², from Gauss points on `emitter` (n, 3) to `receiver` (m, 3), both wholly visible.

    The error falls like (d + √(d² + 1))^(-2 count), d the distance over half the emitter's size.
    """
    u, v, weights = gauss_square(count)
    total = 0.0
    for corners in quads_of(len(emitter)):
        points, density = bilinear(emitter[list(corners)], u, v)
        total += float(np.einsum("nk,nk,n->", edge_vectors(points, receiver), density, weights))
    return total / (2.0 * math.pi)
