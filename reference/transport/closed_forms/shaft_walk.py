"""The walk of `shaft` on the device, in float64: one lane per face of a shaft, then one lane per pair of patches.

Planes are (n, d): n·x ≥ d is beyond them. All tests let `tolerance` pass, in m. Dr.Jit arrays throughout.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

CLEAR, MIXED, BLOCKED = 0, 1, 2
ROW = 32  # numbers per surface: 4 corners, unit normal and height, 4 planes through its edges, outward
NEVER = 1e30  # d of a plane that separates nothing
INNER = 0xFFFFFFFF  # in place of a surface's number
Plane = tuple[Any, Any]


@dataclass(frozen=True, eq=False)
class Scene:
    """E convex surfaces and N nodes of the tree over them. rows: flat mi.Float64 (E·32). lower, upper: flat mi.Float64
    (N·3). skip, primitive: mi.UInt32, as in `bounding_tree.BoundingTree`. nodes: N."""

    rows: Any
    lower: Any
    upper: Any
    skip: Any
    primitive: Any
    nodes: int


@dataclass(frozen=True, eq=False)
class _Shaft:
    """Of each lane: corners of both patches, and planes that nothing in the way is wholly beyond."""

    corners_a: list[Any]
    corners_b: list[Any]
    planes: list[Plane]
    tolerance: Any


def classes(
    scene: Scene, corners: Any, normals: Any, count: int, i: Any, j: Any, tolerance: Any, stop_early: bool
) -> Any:
    """Class (mi.UInt32) of patches i and j, of `count` corners each, flat in `corners`, with flat unit `normals`."""
    import drjit as dr
    import mitsuba as mi

    a, b = ([dr.gather(mi.Vector3d, corners, k * count + n) for n in range(count)] for k in (i, j))
    fronts = [(-dr.gather(mi.Vector3d, normals, k), p[0]) for k, p in ((i, a), (j, b))]
    behind = [(n, dr.dot(n, corner)) for n, corner in fronts]
    faces = _faces(corners, count, i, j, tolerance)
    pair = dr.arange(mi.UInt32, dr.width(i)) * (2 * count)
    sides = [
        (dr.gather(mi.Vector3d, faces[0], pair + k), dr.gather(mi.Float64, faces[1], pair + k))
        for k in range(2 * count)
    ]
    blind = _beyond(behind[0], b, tolerance) | _beyond(behind[1], a, tolerance)
    return _walk(scene, _Shaft(a, b, behind + sides, tolerance), blind, stop_early)


def _beyond(plane: Plane, corners: list[Any], tolerance: Any) -> Any:
    """Whether all corners lie beyond a plane."""
    import drjit as dr
    import mitsuba as mi

    out = mi.Bool(True)
    for x in corners:
        out &= dr.dot(plane[0], x) >= plane[1] - tolerance
    return out


def _faces(corners: Any, count: int, i: Any, j: Any, tolerance: Any) -> tuple[Any, Any]:
    """Faces of the shafts, flat: one for each edge of the first, then of the second patch, through a corner of the other,
    such that both patches lie on this side of it; NEVER where the edge has none."""
    import drjit as dr
    import mitsuba as mi

    lane = dr.arange(mi.UInt32, dr.width(i) * 2 * count)
    pair, side, edge = lane // (2 * count), (lane // count) % 2, lane % count
    first, second = dr.gather(mi.UInt32, i, pair), dr.gather(mi.UInt32, j, pair)
    own, other = dr.select(side == 0, first, second), dr.select(side == 0, second, first)
    mine, theirs = ([dr.gather(mi.Vector3d, corners, k * count + n) for n in range(count)] for k in (own, other))
    start = dr.gather(mi.Vector3d, corners, own * count + edge)
    end = dr.gather(mi.Vector3d, corners, own * count + dr.select(edge + 1 == count, 0, edge + 1))
    normal, offset = dr.zeros(mi.Vector3d, dr.width(lane)), dr.full(mi.Float64, NEVER, dr.width(lane))
    for corner in theirs:
        n = dr.cross(end - start, corner - start)
        length = dr.norm(n)
        n = n / dr.maximum(length, 1e-300)
        low, high = _range([dr.dot(n, x - start) for x in (*mine, *theirs)])
        n = dr.select(high <= tolerance, n, -n)
        valid = (length > 0.0) & ((high <= tolerance) | (low >= -tolerance))
        normal, offset = dr.select(valid, n, normal), dr.select(valid, dr.dot(n, start), offset)
    flat = dr.ravel(normal)
    dr.eval(flat, offset)
    return flat, offset


def _range(values: list[Any]) -> tuple[Any, Any]:
    import drjit as dr

    low, high = values[0], values[0]
    for v in values[1:]:
        low, high = dr.minimum(low, v), dr.maximum(high, v)
    return low, high


def _walk(scene: Scene, shaft: _Shaft, blind: Any, stop_early: bool) -> Any:
    """Visits every node whose box reaches into the shaft. blind: pairs with nothing to see."""
    import drjit as dr
    import mitsuba as mi

    lower, upper = shaft.corners_a[0], shaft.corners_a[0]
    for x in (*shaft.corners_a, *shaft.corners_b):
        lower, upper = dr.minimum(lower, x), dr.maximum(upper, x)
    lower, upper = lower + shaft.tolerance, upper - shaft.tolerance
    nodes, last = dr.opaque(mi.UInt32, scene.nodes), MIXED if stop_early else BLOCKED

    def descend(node: Any, leaf: Any) -> tuple[Any, Any]:
        low, high = dr.gather(mi.Vector3d, scene.lower, node), dr.gather(mi.Vector3d, scene.upper, node)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        missed = dr.any((low >= upper) | (high <= lower))
        for n, d in shaft.planes:
            missed |= dr.dot(n, middle) - dr.dot(dr.abs(n), half) >= d - shaft.tolerance
        leaf = ~missed & (dr.gather(mi.UInt32, scene.primitive, node) != INNER)
        after = dr.select(missed, dr.gather(mi.UInt32, scene.skip, node), node + 1)
        return dr.select(leaf, node, after), leaf

    def step(node: Any, found: Any) -> tuple[Any, Any]:
        start = (node, dr.zeros(mi.Bool, dr.width(node)))
        node, leaf = dr.while_loop(start, lambda n, hit: (n < nodes) & ~hit, descend)
        surface = dr.gather(mi.UInt32, scene.primitive, node, leaf)
        enters, covers = _meets(scene, surface, leaf, shaft, not stop_early)
        return node + 1, dr.maximum(found, dr.select(enters, dr.select(covers, mi.UInt32(BLOCKED), MIXED), CLEAR))

    state = (dr.select(blind, nodes, mi.UInt32(0)), dr.zeros(mi.UInt32, dr.width(blind)))
    return dr.while_loop(state, lambda node, found: (node < nodes) & (found < last), step)[1]


def _meets(scene: Scene, surface: Any, active: Any, shaft: _Shaft, cover: bool) -> tuple[Any, Any]:
    """Whether a surface may reach into the shaft, and, if asked to, whether it covers the shaft's whole section."""
    import drjit as dr
    import mitsuba as mi

    tol, everything = shaft.tolerance, (*shaft.corners_a, *shaft.corners_b)

    def row(place: Any, mask: Any) -> Plane:
        numbers = [dr.gather(mi.Float64, scene.rows, surface * ROW + place + n, mask) for n in range(4)]
        return mi.Vector3d(*numbers[:3]), numbers[3]

    corners = [row(3 * k, active)[0] for k in range(4)]
    normal, offset = row(12, active)
    h = [dr.dot(normal, x) - offset for x in everything]
    (low_a, high_a), (low_b, high_b) = _range(h[: len(h) // 2]), _range(h[len(h) // 2 :])
    near = active & (dr.minimum(low_a, low_b) < -tol) & (dr.maximum(high_a, high_b) > tol)
    for plane in shaft.planes:
        near &= ~_beyond(plane, corners, tol)
    above = (low_a >= -tol) & (high_a > tol) & (high_b <= tol) & (low_b < -tol)
    below = (high_a <= tol) & (low_a < -tol) & (low_b >= -tol) & (high_b > tol)
    covers = near & (above | below) if cover else mi.Bool(False)

    def edge(k: Any, near: Any, covers: Any) -> tuple[Any, Any, Any]:
        outward, d = row(16 + 4 * k, near)
        outside, inside = _edge_sides(h, [dr.dot(outward, x) - d for x in everything], tol)
        return k + 1, near & ~outside, covers & inside if cover else covers

    state = (dr.zeros(mi.UInt32, dr.width(near)), near, covers)
    _, near, covers = dr.while_loop(state, lambda k, near, covers: (k < 4) & near, edge)
    return near, covers & near


def _edge_sides(h: list[Any], f: list[Any], tol: Any) -> tuple[Any, Any]:
    """Whether the shaft's section with a surface's plane lies wholly outside, or inside, the line of one of its edges.

    h: heights of all corners over the plane; f: their distances outward from the edge. The section is spanned by the
    points where joins of corners on different sides cross the plane: at (f_p |h_q| + f_q |h_p|) / (|h_p| + |h_q|).
    """
    import drjit as dr
    import mitsuba as mi

    outside, inside = mi.Bool(True), mi.Bool(True)
    for p, q in combinations(range(len(h)), 2):
        joined = h[p] * h[q] <= 0.0
        crossing = dr.mulsign(f[q] * h[p] - f[p] * h[q], h[p] - h[q])
        slack = tol * dr.abs(h[p] - h[q])
        outside &= ~joined | (crossing >= -slack)
        inside &= ~joined | (crossing <= slack)
    return outside, inside
