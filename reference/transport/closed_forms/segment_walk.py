"""Shadow rays in float64 on the device: whether a convex surface of a `shaft_walk.Scene` crosses the way between points.

Single precision cannot tell a carpet a millionth above a floor from the floor; these rays can, with the tolerance that
the proofs of `shaft` have. They stop at the first surface, so the order of the tree does not matter. Dr.Jit arrays.
"""

from __future__ import annotations

from typing import Any

from .shaft_walk import INNER, ROW, Scene


def blocked(scene: Scene, start: Any, end: Any, tolerance: Any, active: Any) -> Any:
    """Mask of lanes in which something lies strictly between `start` and `end` (mi.Vector3d, m, about the scene's centre).

    Ends may lie on surfaces: what they are nearer to than `tolerance` does not count. Edges are closed: a ray through
    the seam of two surfaces is blocked. active: lanes to look at; the others read false.
    """
    import drjit as dr
    import mitsuba as mi

    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    reach = dr.abs(half) + tolerance
    nodes = dr.opaque(mi.UInt32, scene.nodes)

    def descend(node: Any, leaf: Any) -> tuple[Any, Any]:
        low, high = dr.gather(mi.Vector3d, scene.lower, node), dr.gather(mi.Vector3d, scene.upper, node)
        missed = _apart(middle - 0.5 * (low + high), half, reach, 0.5 * (high - low))
        leaf = ~missed & (dr.gather(mi.UInt32, scene.primitive, node) != INNER)
        after = dr.select(missed, dr.gather(mi.UInt32, scene.skip, node), node + 1)
        return dr.select(leaf, node, after), leaf

    def step(node: Any, found: Any) -> tuple[Any, Any]:
        begin = (node, dr.zeros(mi.Bool, dr.width(node)))
        node, leaf = dr.while_loop(begin, lambda n, hit: (n < nodes) & ~hit, descend)
        surface = dr.gather(mi.UInt32, scene.primitive, node, leaf)
        return node + 1, found | (leaf & _crosses(scene, surface, leaf, start, end, tolerance))

    state = (dr.select(active, mi.UInt32(0), nodes), dr.zeros(mi.Bool, dr.width(active)))
    return dr.while_loop(state, lambda node, found: (node < nodes) & ~found, step)[1]


def _apart(offset: Any, half: Any, reach: Any, box: Any) -> Any:
    """Separating axes of a segment (centre `offset` from the box's, ± `half`) and a box ± `box` (Ericson 2005, 5.3.3)."""
    import drjit as dr

    size = dr.abs(offset)
    out = (size.x > box.x + reach.x) | (size.y > box.y + reach.y) | (size.z > box.z + reach.z)
    out |= dr.abs(offset.y * half.z - offset.z * half.y) > box.y * reach.z + box.z * reach.y
    out |= dr.abs(offset.z * half.x - offset.x * half.z) > box.x * reach.z + box.z * reach.x
    return out | (dr.abs(offset.x * half.y - offset.y * half.x) > box.x * reach.y + box.y * reach.x)


def _crosses(scene: Scene, surface: Any, active: Any, start: Any, end: Any, tolerance: Any) -> Any:
    """Whether the way crosses the surface's plane, both ends clear of it, at a point not outside any of its edges."""
    import drjit as dr
    import mitsuba as mi

    def sides(place: int) -> tuple[Any, Any]:
        numbers = [dr.gather(mi.Float64, scene.rows, surface * ROW + place + n, active) for n in range(4)]
        normal = mi.Vector3d(*numbers[:3])
        return dr.dot(normal, start) - numbers[3], dr.dot(normal, end) - numbers[3]

    h, k = sides(12)
    crosses = ((h > tolerance) & (k < -tolerance)) | ((h < -tolerance) & (k > tolerance))
    for edge in range(4):
        f, g = sides(16 + 4 * edge)
        crosses &= f * dr.abs(k) + g * dr.abs(h) <= tolerance * (dr.abs(h) + dr.abs(k))
    return crosses
