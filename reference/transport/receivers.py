"""What gathers light, and the rays by which it looks: patches and lumels, points, probes, cubemap texels.

Every receiver turns four numbers in [0, 1), u(0) … u(3), into a ray in the unit box. u(0), u(1) choose the direction,
u(2), u(3) the origin; they come from the low-discrepancy points of `low_discrepancy`, scrambled for each receiver.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..datatypes import F64, I32, I64
from ..device_arrays import to_f32, to_u32
from ..sh import COEFFICIENTS, Order, coefficient_count
from ..visibility import LIFT, Geometry
from .elements import corners_of_elements
from .patches import Patches

Uniform = Callable[[int], Any]

# Origins on surfaces stay this far (share of the unit box) from their triangle's edges: beside a wall at less than a right angle
# that stands on the edge, the lift would end behind it, and the ray in the sky. 5e-6 holds down to 22°. Triangles with incircles
# of less than 5e-5 are made smaller by a tenth.
INSET, INSET_MOST = 5e-6, 0.1


class Receivers(Protocol):
    """count: how many. spherical: rows are SH coefficients of radiance, else one number. components: K, 4 or 9 of them, or 1.
    weight: what one ray of N adds, times N."""

    @property
    def count(self) -> int: ...
    @property
    def spherical(self) -> bool: ...
    @property
    def components(self) -> int: ...
    @property
    def weight(self) -> float: ...

    def rays(self, receiver: Any, u: Uniform) -> tuple[Any, Any]:
        """Origins (mi.Point3f, unit box) and unit directions (mi.Vector3f) of the lanes' `receiver` (mi.UInt32)."""
        ...


@dataclass(frozen=True, eq=False)
class AreaReceivers:
    """Pieces of surface, each a run of triangles: patches, or lumels. Origins are uniform over the area, directions have
    density cosθ/π, so a ray's weight is 1.

    run (R,) Array2u: first and last triangle of each receiver. corner, edge_u, edge_v (E,) Array4f: triangles in the unit
    box, lifted off the surface on the receiver's side and inset by INSET, and as fourth numbers the share of the receiver's area before
    and up to this triangle, and nothing. normal (E,) Array4f: unit, on the receiver's side. (Four at a time: one load.)
    """

    count: int
    run: Any
    corner: Any
    edge_u: Any
    edge_v: Any
    normal: Any
    upto: Any
    spherical: bool = False
    components: int = 1
    weight: float = 1.0

    def rays(self, receiver: Any, u: Uniform) -> tuple[Any, Any]:
        """See Receivers."""
        import drjit as dr
        import mitsuba as mi

        run, pick = dr.gather(mi.Vector2u, self.run, receiver), u(2)

        def halve(lo: Any, hi: Any) -> tuple[Any, Any]:
            mid = (lo + hi) >> 1
            beyond = pick >= dr.gather(mi.Float, self.upto, mid)
            return dr.select(beyond, mid + 1, lo), dr.select(beyond, hi, mid)

        element, _ = dr.while_loop((run.x, run.y), lambda lo, hi: lo < hi, halve)
        corner, edge_u, edge_v, normal = (
            dr.gather(mi.Vector4f, table, element) for table in (self.corner, self.edge_u, self.edge_v, self.normal)
        )
        # What is left of the number that picked the triangle is uniform again.
        a = dr.clip((pick - corner.w) / (edge_u.w - corner.w), 0.0, 1.0 - 2.0**-24)
        b = u(3)
        fold = a + b > 1.0
        a, b = dr.select(fold, 1.0 - a, a), dr.select(fold, 1.0 - b, b)
        origin = mi.Point3f(corner.x, corner.y, corner.z)
        origin += a * mi.Vector3f(edge_u.x, edge_u.y, edge_u.z) + b * mi.Vector3f(edge_v.x, edge_v.y, edge_v.z)
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u(0), u(1)))
        return origin, mi.Frame3f(mi.Normal3f(normal.x, normal.y, normal.z)).to_world(local)


def area_receivers(g: Geometry, corners: F64, normals: F64, begin: I64, end: I64) -> AreaReceivers:
    """Receivers made of triangles `corners` (E, 3, 3) m with unit `normals` (E, 3); receiver i owns begin[i] … end[i]."""
    import drjit as dr

    boxed = (corners - g.centre) / g.scale
    edges = boxed[:, 1:] - boxed[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    total = np.concatenate([[0.0], np.cumsum(area)])
    first, whole = np.repeat(total[begin], end - begin), np.repeat(total[end] - total[begin], end - begin)
    whole = np.maximum(whole, np.finfo(np.float64).tiny)
    before, upto = (total[:-1] - first) / whole, (total[1:] - first) / whole

    def packed(values: F64, fourth: F64) -> Any:
        return to_f32(np.column_stack([values, fourth]))

    nothing, within = np.zeros(len(before)), _inset(boxed)
    made = AreaReceivers(
        len(begin),
        to_u32(np.column_stack([begin, end - 1])),
        packed(within[:, 0] + LIFT * normals, before),
        packed(within[:, 1] - within[:, 0], upto),
        packed(within[:, 2] - within[:, 0], nothing),
        packed(normals, nothing),
        to_f32(upto),
    )
    dr.eval(made.run, made.corner, made.edge_u, made.edge_v, made.normal, made.upto)
    return made


def _inset(corners: F64) -> F64:
    """Triangles (E, 3, 3) of the unit box with every edge moved in by INSET: scaled about the centres of their incircles."""
    opposite = np.linalg.norm(np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1), axis=2)
    around = opposite.sum(axis=1)
    share = np.where(
        around[:, None] > 0.0, opposite / np.maximum(around, np.finfo(np.float64).tiny)[:, None], 1.0 / 3.0
    )
    centre = (share[:, :, None] * corners).sum(axis=1, keepdims=True)
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    by = np.minimum(INSET * around / np.maximum(double_area, np.finfo(np.float64).tiny), INSET_MOST)
    return np.asarray(centre + (1.0 - by)[:, None, None] * (corners - centre))


def patch_receivers(g: Geometry, p: Patches) -> AreaReceivers:
    """All patches, backs included."""
    element, sign, patch = patch_elements(p)
    triangle = p.element_triangle[element]
    corners = element_corners(g, p.cuts, p.first_element, triangle, element)
    begin = np.searchsorted(patch, np.arange(p.count + 1))
    return area_receivers(g, corners, sign[:, None] * g.normals[triangle], begin[:-1], begin[1:])


def some_of(receivers: AreaReceivers, rows: I64) -> AreaReceivers:
    """Only these receivers (R,), numbered anew."""
    import mitsuba as mi

    run = np.array(receivers.run).reshape(-1, 2)[rows]
    return dataclasses.replace(receivers, count=len(rows), run=mi.UInt32(np.ascontiguousarray(run).ravel()))


def patch_elements(p: Patches) -> tuple[I64, F64, I64]:
    """Elements (N,) of all patches, backs included, in the order of patches; side (N,) 1 or -1; patch (N,)."""
    lengths = np.diff(p.start)[p.twin]
    begin = np.cumsum(lengths) - lengths
    at = np.repeat(p.start[p.twin] - begin, lengths) + np.arange(lengths.sum())
    patch = np.repeat(np.arange(p.count), lengths)
    return p.order[at], np.where(patch >= p.front, -1.0, 1.0), patch


def element_corners(g: Geometry, cuts: I32, first: I64, triangle: I32, element: I64) -> F64:
    """Corners (N, 3, 3) m of elements (N,). In memory the elements are innermost: NumPy's loops over three are slow."""
    of = g.faces.take(triangle, axis=0).T
    a, b, c = (np.ascontiguousarray(g.vertices.take(of[i], axis=0).T) for i in range(3))
    uv, along, across = corners_of_elements(cuts, first, triangle, element).transpose(1, 2, 0), b - a, c - a
    return np.stack([a + u * along + v * across for u, v in uv]).transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class PointReceivers:
    """Points with a normal; directions have density cosθ/π."""

    count: int
    origin: Any
    normal: Any
    spherical: bool = False
    components: int = 1
    weight: float = 1.0

    def rays(self, receiver: Any, u: Uniform) -> tuple[Any, Any]:
        """See Receivers."""
        import drjit as dr
        import mitsuba as mi

        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u(0), u(1)))
        frame = mi.Frame3f(dr.gather(mi.Vector3f, self.normal, receiver))
        return dr.gather(mi.Point3f, self.origin, receiver), frame.to_world(local)


@dataclass(frozen=True, eq=False)
class ProbeReceivers:
    """Probes: uniform directions, rows are the SH coefficients of radiance (4π/N · Y(ω), over π for radiosity)."""

    count: int
    origin: Any
    spherical: bool = True
    components: int = COEFFICIENTS
    weight: float = 4.0

    def rays(self, receiver: Any, u: Uniform) -> tuple[Any, Any]:
        """See Receivers."""
        import drjit as dr
        import mitsuba as mi

        direction = mi.warp.square_to_uniform_sphere(mi.Point2f(u(0), u(1)))
        return dr.gather(mi.Point3f, self.origin, receiver), direction


@dataclass(frozen=True, eq=False)
class TexelReceivers:
    """Texels of cubemaps: directions uniform over the texel's square; a row gives the texel's mean radiance.

    origin (C,) per cubemap; size: texels per edge. Receiver number: ((cubemap · 6 + face) · size + row) · size + column,
    faces +x, -x, +y, -y, +z, -z laid out as OpenGL's cube maps are (table 8.19 of its 4.6 specification).
    """

    count: int
    origin: Any
    size: int
    spherical: bool = False
    components: int = 1
    weight: float = 1.0 / np.pi

    def rays(self, receiver: Any, u: Uniform) -> tuple[Any, Any]:
        """See Receivers."""
        import drjit as dr
        import mitsuba as mi

        size = dr.opaque(mi.UInt32, self.size)
        column, rest = receiver % size, receiver // size
        row, rest = rest % size, rest // size
        s = 2.0 * (mi.Float(column) + u(0)) / mi.Float(size) - 1.0
        t = 2.0 * (mi.Float(row) + u(1)) / mi.Float(size) - 1.0
        face, cube = rest % 6, rest // 6
        x = dr.select(face == 0, 1.0, dr.select(face == 1, -1.0, dr.select(face == 5, -s, s)))
        y = dr.select(face == 2, 1.0, dr.select(face == 3, -1.0, -t))
        z = dr.select(
            face == 4, 1.0, dr.select(face == 5, -1.0, dr.select(face == 0, -s, dr.select(face == 1, s, 0.0)))
        )
        z = dr.select(face == 2, t, dr.select(face == 3, -t, z))
        return dr.gather(mi.Point3f, self.origin, cube), dr.normalize(mi.Vector3f(x, y, z))


def _boxed(g: Geometry, positions: F64, normals: F64 | None = None) -> Any:
    boxed = (np.asarray(positions, dtype=np.float64) - g.centre) / g.scale
    if normals is not None:
        boxed = boxed + LIFT * normals
    return to_f32(boxed)


def point_receivers(g: Geometry, positions: F64, normals: F64) -> PointReceivers:
    """Surface elements at `positions` (R, 3) m with unit `normals` (R, 3)."""
    return PointReceivers(len(positions), _boxed(g, positions, normals), to_f32(normals))


def probe_receivers(g: Geometry, positions: F64, order: Order = 1) -> ProbeReceivers:
    """Probes at `positions` (R, 3) m, with SH of `order`."""
    return ProbeReceivers(len(positions), _boxed(g, positions), components=coefficient_count(order))


def texel_receivers(g: Geometry, positions: F64, size: int) -> TexelReceivers:
    """All texels of cubemaps of `size` texels an edge at `positions` (C, 3) m."""
    return TexelReceivers(6 * size * size * len(positions), _boxed(g, positions), size)
