"""Exact form factors between planar polygons that nothing stands between: the slow, plain version.

    F12 = 1 / (2π A1) Σ over edges e1 of 1, e2 of 2 of  (t1 · t2) ∫∫ ln r ds1 ds2                    (Sparrow 1963)

The inner integral has a closed form, the outer one too where the edges are parallel; elsewhere it is done by tanh-sinh
quadrature (Takahasi and Mori 1974) on the parts into which the nearest point and the ends of the other edge cut the
edge, so that the integrand's only singularities, x ln x at r → 0, lie at ends of parts. Polygons are first clipped to
the front of each other's plane. Far pairs use Gauss points on one polygon and Lambert's formula for the other
(`lambert`), because the contour sum cancels there. `contour_batch` does the same on the device.
"""

from __future__ import annotations

import math

import numpy as np

from ...datatypes import F64
from .lambert import gauss_lambert
from .polygon_clip import mutually_visible, vector_areas

# Edges count as parallel under this sine: taking d as constant then moves r by less than its own rounding.
PARALLEL_SINE = 1e-13
# The second antiderivative loses (reach / shorter edge)² roundings against the area form factors are divided by.
PARALLEL_REACH = 30.0
# Distance of two polygons in radii of the smaller from which Gauss points do; 8 × 8 points are then exact to 1e-11.
FAR = 3.0
FAR_NODES = 8
TINY = float(np.finfo(np.float64).tiny)


def tanh_sinh(step: float = 1.0 / 12.0, reach: float = 3.0) -> tuple[F64, F64]:
    """Nodes (K,) in (0, 1), given as distance from the nearer end with the far ones negative, and weights (K,).

    A node −x stands for 1 − x: near its end the integrand needs the distance, not the rounded place.
    """
    t = np.arange(-round(reach / step), round(reach / step) + 1) * step
    u = 0.5 * math.pi * np.sinh(t)
    weights = step * 0.25 * math.pi * np.cosh(t) / np.cosh(u) ** 2
    nodes = 1.0 / (1.0 + np.exp(2.0 * np.abs(u)))
    return np.where(t <= 0.0, nodes, -nodes), weights


def log_integral(x: F64, d: F64) -> F64:
    """∫₀ˣ ln √(u² + d²) du, odd in x."""
    w = np.maximum(x * x + d * d, TINY)
    return np.asarray(0.5 * x * np.log(w) - x + d * np.arctan2(x, d))


def log_double_integral(x: F64, d: F64) -> F64:
    """An antiderivative of `log_integral` in x, even in x; 0 at r = 0."""
    w = np.maximum(x * x + d * d, TINY)
    return np.asarray(0.25 * (x * x - d * d) * np.log(w) - 0.75 * x * x + d * x * np.arctan2(x, d))


def edge_integrals(p0: F64, p1: F64, q0: F64, q1: F64) -> F64:
    """(t1 · t2) ∫∫ ln r of the edges p0 p1 and q0 q1, each (E, 3); (E,), length² . Edges of no length give 0.

    Lengths should be near 1: the logarithm of the unit cancels over closed polygons, its rounding does not.
    """
    l1, l2 = (np.linalg.norm(v, axis=1) for v in (p1 - p0, q1 - q0))
    swap = l1 > l2  # the outer edge is the shorter one: less of the integrand's range, and less cancellation
    p0, p1, q0, q1 = (np.where(swap[:, None], *pair) for pair in ((q0, p0), (q1, p1), (p0, q0), (p1, q1)))
    l1, l2 = np.minimum(l1, l2), np.maximum(l1, l2)
    t1, t2 = (p1 - p0) / np.maximum(l1, TINY)[:, None], (q1 - q0) / np.maximum(l2, TINY)[:, None]
    cosine = np.einsum("nk,nk->n", t1, t2)
    out = np.zeros(len(l1))
    live = (l1 > 0.0) & (l2 > 0.0) & (np.abs(cosine) > PARALLEL_SINE)
    reach = np.linalg.norm(p0 - q0, axis=1) + l1 + l2
    parallel = live & (np.linalg.norm(np.cross(t1, t2), axis=1) < PARALLEL_SINE) & (reach < PARALLEL_REACH * l1)
    out[parallel] = _parallel(p0[parallel], p1[parallel], q0[parallel], t2[parallel], l2[parallel])
    rest = live & ~parallel
    out[rest] = cosine[rest] * _outer(p0[rest], t1[rest], l1[rest], q0[rest], t2[rest], l2[rest])
    return out


def _parallel(p0: F64, p1: F64, q0: F64, t2: F64, l2: F64) -> F64:
    d = np.linalg.norm(np.cross(0.5 * (p0 + p1) - q0, t2), axis=1)
    a, b = (np.einsum("nk,nk->n", p - q0, t2) for p in (p0, p1))
    g = log_double_integral
    return np.asarray(g(l2 - a, d) - g(l2 - b, d) - g(a, d) + g(b, d))


def cut_points(p0: F64, t1: F64, l1: F64, q0: F64, t2: F64, l2: F64) -> F64:
    """Places (E, 5) along the first edge, ascending: its ends, the feet of the other's ends, the point nearest its line."""
    cosine = np.einsum("nk,nk->n", t1, t2)
    b = q0 - p0
    first, axial = np.einsum("nk,nk->n", b, t1), np.einsum("nk,nk->n", b, t2)
    sine2 = np.maximum(np.einsum("nk,nk->n", np.cross(t1, t2), np.cross(t1, t2)), TINY)
    nearest = (first - cosine * axial) / sine2
    cuts = np.stack([np.zeros_like(l1), first, first + cosine * l2, nearest, l1], axis=1)
    return np.sort(np.clip(cuts, 0.0, l1[:, None]), axis=1)


def _outer(p0: F64, t1: F64, l1: F64, q0: F64, t2: F64, l2: F64) -> F64:
    """∫ over the first edge of the inner integral over the second, part by part."""
    nodes, weights = tanh_sinh()
    cuts = cut_points(p0, t1, l1, q0, t2, l2)
    total = np.zeros(len(l1))
    for part in range(4):
        begin, end = cuts[:, part, None], cuts[:, part + 1, None]
        s = np.where(nodes > 0.0, begin, end) + nodes * (end - begin)
        r = (p0 - q0)[:, None, :] + s[..., None] * t1[:, None, :]
        axial = np.einsum("nsk,nk->ns", r, t2)
        d = np.linalg.norm(np.cross(r, t2[:, None, :]), axis=2)
        inner = log_integral(l2[:, None] - axial, d) + log_integral(axial, d)
        total += (cuts[:, part + 1] - cuts[:, part]) * (inner @ weights)
    return total


def contour_sum(first: F64, second: F64) -> float:
    """Area times form factor, length², between the parts (n, 3) and (m, 3) that see each other whole."""
    corners = np.concatenate([first, second])
    centre, unit = corners.mean(axis=0), float(np.ptp(corners, axis=0).max())
    a, b = (first - centre) / unit, (second - centre) / unit
    i, j = (x.ravel() for x in np.indices((len(a), len(b))))
    edges = edge_integrals(a[i], np.roll(a, -1, axis=0)[i], b[j], np.roll(b, -1, axis=0)[j])
    return math.fsum(edges) * unit * unit / (2.0 * math.pi)


def separation(first: F64, second: F64) -> tuple[float, float, bool]:
    """Lower bound of the distance between two polygons (m), radius of the smaller (m), whether the first is it."""
    centres = [0.5 * (p.min(axis=0) + p.max(axis=0)) for p in (first, second)]
    radii = [float(np.linalg.norm(p - c, axis=1).max()) for p, c in zip((first, second), centres, strict=True)]
    small = int(radii[1] < radii[0])
    other = (first, second)[1 - small]
    outside = np.maximum(np.maximum(other.min(axis=0) - centres[small], centres[small] - other.max(axis=0)), 0.0)
    centres_apart = float(np.linalg.norm(centres[0] - centres[1]))
    return max(centres_apart - radii[1 - small], float(np.linalg.norm(outside))), radii[small], small == 0


def polygon_form_factor(emitter: F64, receiver: F64) -> float:
    """Fraction of the diffuse power leaving the front of `emitter` (n, 3) that reaches the front of `receiver` (m, 3).

    Corners in m, counter-clockwise from the front; simple polygons, convex or not, nothing between them. Exactly 0
    where the polygons are coplanar, face away, or lie below each other's horizon. Raises ValueError without area.
    """
    emitter, receiver = np.asarray(emitter, dtype=np.float64), np.asarray(receiver, dtype=np.float64)
    area = float(np.linalg.norm(vector_areas(emitter[None])[0]))
    if area == 0.0 or not np.any(vector_areas(receiver[None])):
        raise ValueError("both polygons need an area, got 0")
    parts = mutually_visible(emitter[None], receiver[None])
    if parts[2][0] == 0:
        return 0.0
    a, b = parts[0][0, : parts[2][0]], parts[1][0, : parts[3][0]]
    distance, radius, first_small = separation(a, b)
    if distance > FAR * radius:
        exchange = gauss_lambert(a, b, FAR_NODES) if first_small else gauss_lambert(b, a, FAR_NODES)
    else:
        exchange = contour_sum(a, b)
    return max(0.0, exchange / area)
