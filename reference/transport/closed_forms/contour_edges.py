"""The contour integral on the device: near pairs of polygons, one lane per pair of edges.

The plain twin, with the formulas' sources, is `contour.edge_integrals`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ...datatypes import F64, U32
from ...device_arrays import to_f64, to_lanes
from .contour import PARALLEL_REACH, PARALLEL_SINE, TINY, tanh_sinh
from .polygon_table import Corners

EDGE_LANES = 1 << 22


def contour_exchange(table: Corners, first: U32, second: U32) -> F64:
    """Contour integrals, a lane per pair of edges; edges that are not parallel go through the quadrature."""
    import drjit as dr
    import mitsuba as mi

    c = table.corner_count
    step = max(1, EDGE_LANES // (c * c))
    out = np.zeros(len(first))
    for begin in range(0, len(first), step):
        part = slice(begin, min(begin + step, len(first)))
        a, b = to_lanes(first[part]), to_lanes(second[part])
        lanes = dr.arange(mi.UInt32, dr.width(a) * c * c)
        unit, *edges = _edges(table, a, b, lanes)
        value, general = _parallel(*edges)
        dr.eval(value, general, unit)
        sums = np.array(value)
        rest = np.flatnonzero(np.array(general)).astype(np.uint32)
        if len(rest):
            sums[rest] = _outer(*_edges(table, a, b, to_lanes(rest))[1:])[: len(rest)]
        # One edge after the other: a sum whose order hangs on the corners that padding adds would make a pair depend on its batch.
        added = np.cumsum(sums.reshape(-1, c * c), axis=1)[:, -1]
        exchanged = added * np.array(unit)[:: c * c] ** 2 / (2.0 * np.pi)
        out[part] = exchanged[: part.stop - begin]
    return out


def _edges(table: Corners, first: Any, second: Any, lanes: Any) -> tuple[Any, ...]:
    """Unit of length, ends p0, p1 of the shorter and q0, q1 of the longer edge, in that unit about the pair's middle."""
    import drjit as dr
    import mitsuba as mi

    c = table.corner_count
    pair, i, j = lanes // (c * c), (lanes // c) % c, lanes % c
    a, b = dr.gather(mi.UInt32, first, pair), dr.gather(mi.UInt32, second, pair)
    lower = dr.minimum(dr.gather(mi.Vector3d, table.lower, a), dr.gather(mi.Vector3d, table.lower, b))
    upper = dr.maximum(dr.gather(mi.Vector3d, table.upper, a), dr.gather(mi.Vector3d, table.upper, b))
    centre, unit = 0.5 * (lower + upper), dr.max(upper - lower)

    def corner(polygon: Any, k: Any) -> Any:
        place = polygon * c + dr.select(k == c, 0, k)
        return (dr.gather(mi.Vector3d, table.corners, place) - centre) / unit

    p0, p1, q0, q1 = corner(a, i), corner(a, i + 1), corner(b, j), corner(b, j + 1)
    swap = dr.squared_norm(p1 - p0) > dr.squared_norm(q1 - q0)
    ends = ((p0, q0), (p1, q1), (q0, p0), (q1, p1))
    return (unit, *(dr.select(swap, y, x) for x, y in ends))


def _frames(p0: Any, p1: Any, q0: Any, q1: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Lengths, unit directions and the cosine of two edges."""
    import drjit as dr

    l1, l2 = dr.norm(p1 - p0), dr.norm(q1 - q0)
    t1, t2 = (p1 - p0) / dr.maximum(l1, TINY), (q1 - q0) / dr.maximum(l2, TINY)
    return l1, l2, t1, t2, dr.dot(t1, t2)


def _parallel(p0: Any, p1: Any, q0: Any, q1: Any) -> tuple[Any, Any]:
    """Integral where the edges are parallel (else 0), and whether the edges need the quadrature."""
    import drjit as dr

    l1, l2, t1, t2, cosine = _frames(p0, p1, q0, q1)
    live = (l1 > 0.0) & (l2 > 0.0) & (dr.abs(cosine) > PARALLEL_SINE)
    reach = dr.norm(p0 - q0) + l1 + l2
    parallel = live & (dr.norm(dr.cross(t1, t2)) < PARALLEL_SINE) & (reach < PARALLEL_REACH * l1)
    d = dr.norm(dr.cross(0.5 * (p0 + p1) - q0, t2))
    a, b = dr.dot(p0 - q0, t2), dr.dot(p1 - q0, t2)

    def g(x: Any) -> Any:
        w = dr.maximum(x * x + d * d, TINY)
        return 0.25 * (x * x - d * d) * dr.log(w) - 0.75 * x * x + d * x * dr.atan2(x, d)

    return dr.select(parallel, g(l2 - a) - g(l2 - b) - g(a) + g(b), 0.0), live & ~parallel


def _outer(p0: Any, p1: Any, q0: Any, q1: Any) -> F64:
    """Quadrature over the first edge, four parts of it one after another."""
    import drjit as dr
    import mitsuba as mi

    l1, l2, t1, t2, cosine = _frames(p0, p1, q0, q1)
    cuts = _cuts(p0, t1, l1, q0, t2, l2, cosine)
    nodes, weights = (to_f64(x) for x in tanh_sinh())
    count, r0 = dr.opaque(mi.UInt32, dr.width(nodes)), p0 - q0

    def log_integral(x: Any, d: Any) -> Any:
        return 0.5 * x * dr.log(dr.maximum(x * x + d * d, TINY)) - x + d * dr.atan2(x, d)

    def step(node: Any, total: Any) -> tuple[Any, Any]:
        x, w = dr.gather(mi.Float64, nodes, node), dr.gather(mi.Float64, weights, node)
        for begin, end in pairwise(cuts):
            r = r0 + (dr.select(x > 0.0, begin, end) + x * (end - begin)) * t1
            axial, d = dr.dot(r, t2), dr.norm(dr.cross(r, t2))
            total += w * (end - begin) * (log_integral(l2 - axial, d) + log_integral(axial, d))
        return node + 1, total

    state = (dr.zeros(mi.UInt32, dr.width(l1)), dr.zeros(mi.Float64, dr.width(l1)))
    result = dr.while_loop(state, lambda node, total: node < count, step)
    return np.array(result[1] * cosine)


def _cuts(p0: Any, t1: Any, l1: Any, q0: Any, t2: Any, l2: Any, cosine: Any) -> list[Any]:
    """`contour.cut_points`: five places along the first edge, ascending."""
    import drjit as dr

    b = q0 - p0
    first, axial = dr.dot(b, t1), dr.dot(b, t2)
    nearest = (first - cosine * axial) / dr.maximum(dr.squared_norm(dr.cross(t1, t2)), TINY)
    x, y, z = (dr.clip(place, 0.0, l1) for place in (first, first + cosine * l2, nearest))
    low, high = dr.minimum(x, y), dr.maximum(x, y)
    return [0.0 * l1, dr.minimum(low, z), dr.maximum(low, dr.minimum(high, z)), dr.maximum(high, z), l1]
