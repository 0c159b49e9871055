"""Whether triangles touch cubes: separating axes, exact up to a hair (Akenine-Möller 2001).

A convex pair is apart if and only if its projections are apart on one of 13 axes: 3 cube normals, the triangle's normal, 9
cross products of edges. `triangles_touch_boxes` is the slow, obvious version in NumPy; `CubeTest` is the same as one Dr.Jit
kernel, which takes the eight cubes of a 2 × 2 × 2 block at once. Both are closed: touching counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..datatypes import F64, I64, Bool
from ..device_arrays import to_f64, to_lanes
from ..variant import ensure_variant

# Share of the half edge by which cubes are grown, so that rounding loses no triangle that lies in a face.
HAIR = 1e-9


def triangles_touch_boxes(corners: F64, half: float | F64) -> Bool:
    """Whether triangles (N, 3, 3), relative to the centre of boxes of half edges `half`, one for all or (N, 3), touch them (closed):
    (N,) bool."""
    h = np.broadcast_to(half * (1.0 + HAIR), (len(corners), 3))
    touch = ((corners.min(axis=1) <= h) & (corners.max(axis=1) >= -h)).all(axis=1)
    rows = np.flatnonzero(touch)
    c, h = corners[rows], h[rows]
    edges = np.roll(c, -1, axis=1) - c
    normal = np.cross(edges[:, 0], edges[:, 1])
    ok = np.abs(np.einsum("ni,ni->n", normal, c[:, 0])) <= (h * np.abs(normal)).sum(axis=1)
    for axis in np.eye(3):
        for e in range(3):
            a = np.cross(edges[:, e], axis)
            projected = np.einsum("nvi,ni->nv", c, a)
            reach = (h * np.abs(a)).sum(axis=1)
            ok &= (projected.min(axis=1) <= reach) & (projected.max(axis=1) >= -reach)
    touch[rows] = ok
    return np.asarray(touch)


class CubeTest:
    """Triangles (T, 3, 3) f64 m in device memory, to be tested against the cubes of a lattice whose corner is their origin.

    reach: (T, 3) m, how far off each triangle counts as touched, per axis; nothing without it.
    """

    def __init__(self, corners: F64, reach: F64 | None = None) -> None:
        """Upload. One triangle goes up twice: tables of one row would be compiled as constants, in a kernel of their own."""
        ensure_variant()
        twice = 2 if len(corners) == 1 else 1
        rows = np.repeat(corners, twice, axis=0)
        off = np.zeros((len(rows), 3)) if reach is None else np.repeat(reach, twice, axis=0)
        self._table = [[to_f64(rows[:, v, i]) for i in range(3)] for v in range(3)]
        self._reach = [to_f64(off[:, i]) for i in range(3)]

    def __call__(self, triangle: I64, block: I64, size: float) -> Bool:
        """Which of eight cubes each triangle touches: (N, 8) bool, octants in the order of `lattice.OCTANTS`.

        triangle (N,): row. block (N, 3), not negative: cell of the block's lowest cube. size, m: edge of a cell.
        """
        import drjit as dr
        import mitsuba as mi

        if len(triangle) == 0:
            return np.zeros((0, 8), dtype=np.bool_)
        lane = dr.arange(mi.UInt32, 8 * max(2, len(triangle)))
        row = dr.gather(mi.UInt32, to_lanes(triangle), lane >> 3)
        edge, hair = dr.opaque(mi.Float64, size), dr.opaque(mi.Float64, 1.0 + HAIR)
        h = [(0.5 * edge + dr.gather(mi.Float64, self._reach[i], row)) * hair for i in range(3)]
        centre = []
        for i in range(3):
            first = dr.gather(mi.UInt32, to_lanes(block[:, i]), lane >> 3)
            centre.append((mi.Float64(first + ((lane >> (2 - i)) & 1)) + 0.5) * edge)
        c = [[dr.gather(mi.Float64, self._table[v][i], row) - centre[i] for i in range(3)] for v in range(3)]
        touch = _touch(c, h)
        dr.eval(touch)
        return np.asarray(np.array(touch).reshape(-1, 8)[: len(triangle)])


def _touch(c: list[list[Any]], h: list[Any]) -> Any:
    """The 13 axes for corners c[v][i] of a triangle, f64, relative to the centre of a box of half edges h[i]."""
    import drjit as dr
    import mitsuba as mi

    def within(values: list[Any], reach: Any) -> Any:
        low, high = dr.minimum(dr.minimum(*values[:2]), values[2]), dr.maximum(dr.maximum(*values[:2]), values[2])
        return (low <= reach) & (high >= -reach)

    ok = mi.Bool(True)
    for i in range(3):
        ok &= within([c[v][i] for v in range(3)], h[i])
    edges = [[c[(v + 1) % 3][i] - c[v][i] for i in range(3)] for v in range(3)]
    n = [
        edges[0][(i + 1) % 3] * edges[1][(i + 2) % 3] - edges[0][(i + 2) % 3] * edges[1][(i + 1) % 3] for i in range(3)
    ]
    distance = n[0] * c[0][0] + n[1] * c[0][1] + n[2] * c[0][2]
    ok &= dr.abs(distance) <= h[0] * dr.abs(n[0]) + h[1] * dr.abs(n[1]) + h[2] * dr.abs(n[2])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for e in edges:
            ok &= within([c[v][j] * e[k] - c[v][k] * e[j] for v in range(3)], h[k] * dr.abs(e[j]) + h[j] * dr.abs(e[k]))
    return ok
