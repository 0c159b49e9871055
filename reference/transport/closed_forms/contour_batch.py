"""Form factors of millions of polygon pairs that nothing stands between: `contour` on the device, in float64.

Each pair is first judged: whether it sees nothing, whether a horizon cuts it, how many radii of the smaller polygon lie
between. Far pairs take Gauss points on the smaller polygon and Lambert's formula for the other, as many points as the
distance asks for; near ones the contour integral, a lane per pair of edges. One lane writes one number: no atomics.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...datatypes import F64, I64, U32
from ...device_arrays import to_f64, to_lanes
from ...variant import ensure_variant
from .contour_edges import contour_exchange
from .lambert import gauss_square, quads_of
from .polygon_clip import EPSILON, ROUNDINGS, mutually_visible, padded
from .polygon_table import TINY, Corners, PolygonTable, upload, upload_corners

# (distance over radius from which it holds, Gauss points per edge): (d + √(d² + 1))^(-2 n) stays under 1e-9.
TIERS = ((30.0, 3), (9.0, 4), (6.0, 5), (3.0, 6), (1.5, 10))
NEAR = len(TIERS)
_TIER_BITS, _SWAPPED, _CUT, _BLIND = 7, 8, 16, 32  # NEAR fits into the tier's bits


def pair_form_factors(polygons: F64, sizes: I64, pairs: I64) -> F64:
    """Area of i times form factor from i to j, m², (N,), for the pairs (i, j) of `pairs` (N, 2). Symmetric in i and j.

    polygons (P, C, 3) m, simple and planar, of which the first sizes (P,) corners count, counter-clockwise from the
    front. Nothing may stand between a pair: see `shaft`. Exactly 0 where neither sees the other's front. Error
    under 1e-11 of the smaller area, and under 1e-8 of the value unless a horizon leaves only a sliver.
    """
    ensure_variant()
    host = padded(polygons, np.asarray(sizes))
    table = upload(host)
    first, second = (np.ascontiguousarray(pairs[:, k], dtype=np.uint32) for k in (0, 1))
    out = np.zeros(len(first))
    if len(first) == 0:
        return out
    code = _judge(table, first, second)
    swap = (code & _SWAPPED) != 0
    first, second = np.where(swap, second, first), np.where(swap, first, second)
    for cut in (False, True):
        chosen = np.flatnonzero((code & (_BLIND | _CUT)) == (_CUT if cut else 0))
        if len(chosen):
            out[chosen] = _exchange(
                table, first[chosen], second[chosen], (code[chosen] & _TIER_BITS).astype(np.int64), cut
            )
    return out


def _exchange(table: Corners, first: U32, second: U32, tier: I64, cut: bool) -> F64:
    """Pairs by tier; the smaller polygon is the first."""
    if cut:
        parts = mutually_visible(table.host[first], table.host[second])
        # A cut gives a convex polygon one corner more at most. Room for it always, so that no pair's rounding depends on the others'.
        count, width = len(first), max(table.corner_count + 1, parts[0].shape[1], parts[1].shape[1])
        host = np.concatenate([np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0)), mode="edge") for p in parts[:2]])
        table = upload_corners(host)
        first, second = np.arange(count, dtype=np.uint32), np.arange(count, 2 * count, dtype=np.uint32)
        seen = parts[2] > 0
    else:
        seen = np.ones(len(first), dtype=np.bool_)
    out = np.zeros(len(first))
    for number in range(NEAR + 1):
        chosen = np.flatnonzero((tier == number) & seen)
        if len(chosen):
            pair = first[chosen], second[chosen]
            out[chosen] = contour_exchange(table, *pair) if number == NEAR else _far(table, *pair, TIERS[number][1])
    return np.maximum(out, 0.0)


def _judge(table: PolygonTable, first: U32, second: U32) -> U32:
    """Tier of each pair, with flags: the second polygon is the smaller; a horizon cuts one; neither sees the other."""
    import drjit as dr
    import mitsuba as mi

    i, j = to_lanes(first), to_lanes(second)
    lower_i, lower_j = (dr.gather(mi.Vector3d, table.lower, k) for k in (i, j))
    upper_i, upper_j = (dr.gather(mi.Vector3d, table.upper, k) for k in (i, j))
    lower, upper = dr.minimum(lower_i, lower_j), dr.maximum(upper_i, upper_j)
    span, magnitude = dr.norm(upper - lower), dr.max(dr.maximum(dr.abs(lower), dr.abs(upper)))

    def heights(plane: Any, other: Any) -> tuple[Any, Any]:
        normal = dr.gather(mi.Vector3d, table.normal, plane)
        origin = dr.gather(mi.Vector3d, table.corners, plane * table.corner_count)
        lever = 1.0 + span / dr.gather(mi.Float64, table.width, plane)
        tolerance = ROUNDINGS * EPSILON * magnitude * dr.minimum(lever, 1e6)
        low, high = mi.Float64(dr.inf), mi.Float64(-dr.inf)
        for k in range(table.corner_count):
            corner = dr.gather(mi.Vector3d, table.corners, other * table.corner_count + k)
            h = dr.dot(corner - origin, normal)
            low, high = dr.minimum(low, h), dr.maximum(high, h)
        return high <= tolerance, low < -tolerance

    behind_i, cut_j = heights(i, j)
    behind_j, cut_i = heights(j, i)
    radius_i, radius_j = dr.gather(mi.Float64, table.radius, i), dr.gather(mi.Float64, table.radius, j)
    swap = radius_j < radius_i
    centre_i, centre_j = 0.5 * (lower_i + upper_i), 0.5 * (lower_j + upper_j)
    centre = dr.select(swap, centre_j, centre_i)
    outside = dr.maximum(dr.select(swap, lower_i, lower_j) - centre, centre - dr.select(swap, upper_i, upper_j))
    apart = dr.norm(centre_i - centre_j) - dr.maximum(radius_i, radius_j)
    ratio = dr.maximum(apart, dr.norm(dr.maximum(outside, 0.0))) / dr.minimum(radius_i, radius_j)
    tier = mi.UInt32(NEAR)
    for number, (least, _) in reversed(list(enumerate(TIERS))):
        tier = dr.select(ratio >= least, mi.UInt32(number), tier)
    code = tier + dr.select(swap, mi.UInt32(_SWAPPED), 0) + dr.select(cut_i | cut_j, mi.UInt32(_CUT), 0)
    return np.array(code + dr.select(behind_i | behind_j, mi.UInt32(_BLIND), 0))[: len(first)]


def _far(table: Corners, emitter: U32, receiver: U32, count: int) -> F64:
    """Gauss points (count² per quadrilateral) on the emitter, Lambert's formula for the receiver."""
    import drjit as dr
    import mitsuba as mi

    c = table.corner_count
    i, j = to_lanes(emitter), to_lanes(receiver)
    origin = dr.gather(mi.Vector3d, table.corners, i * c)  # differences of near numbers keep their digits
    e = [dr.gather(mi.Vector3d, table.corners, i * c + k) - origin for k in range(c)]
    r = [dr.gather(mi.Vector3d, table.corners, j * c + k) - origin for k in range(c)]
    u_table, v_table, w_table = (to_f64(x) for x in gauss_square(count))
    nodes = dr.opaque(mi.UInt32, count * count)

    def step(node: Any, total: Any) -> tuple[Any, Any]:
        u, v, w = (dr.gather(mi.Float64, x, node) for x in (u_table, v_table, w_table))
        for corners in quads_of(c):
            k0, k1, k2, k3 = (e[k] for k in corners)
            along, across = dr.lerp(k1 - k0, k2 - k3, v), dr.lerp(k3 - k0, k2 - k1, u)
            point = k0 + u * (k1 - k0) + v * across
            total += w * dr.dot(_edge_vectors([x - point for x in r]), dr.cross(along, across))
        return node + 1, total

    state = (dr.zeros(mi.UInt32, dr.width(i)), dr.zeros(mi.Float64, dr.width(i)))
    result = dr.while_loop(state, lambda node, total: node < nodes, step)
    return np.array(result[1])[: len(emitter)] / (2.0 * np.pi)


def _edge_vectors(r: list[Any]) -> Any:
    """`lambert.edge_vectors` for corners relative to the point."""
    import drjit as dr
    import mitsuba as mi

    total = mi.Vector3d(0.0)
    for a, b in zip(r, r[1:] + r[:1], strict=True):
        cross = dr.cross(b, a)
        length = dr.norm(cross)
        total += cross * (dr.atan2(length, dr.dot(a, b)) / dr.maximum(length, TINY))
    return total
