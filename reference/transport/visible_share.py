"""The share of the light between two patches that nothing stops: shadow rays between points of both, weighted with the
kernel cosθ cosθ' / r². Its estimate is a ratio, so it is exact where all or nothing is seen, and multiplies a closed form.

At common edges the kernel has no finite variance over points chosen by area. Half of the rays of such pairs leave the
first patch by the cosine instead, and both halves are weighted by the balance heuristic (Veach and Guibas 1995,
"Optimally combining sampling techniques for Monte Carlo rendering"): no weight then exceeds two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..datatypes import F64, I64, Bool
from ..device_arrays import to_f32, to_u32
from ..low_discrepancy import receiver_seeds, scrambled, sobol_table
from ..visibility import LIFT, Geometry
from .form_factors import RAYS_PER_BATCH, REPLICATES

LEAST_DISTANCE = 1e-9  # in the unit box


@dataclass(frozen=True, eq=False)
class DeviceCells:
    """Quadrilaterals in the unit box, lifted off the surface: corner (E,) four mi.Float arrays of Vector4f, whose fourth
    numbers are the share of the area in triangle 0 1 2, and the normal."""

    corner: tuple[Any, ...]


def upload_cells(g: Geometry, cells: F64, normals: F64) -> DeviceCells:
    """cells (E, 4, 3) m, normals (E, 3)."""

    boxed = (cells - g.centre) / g.scale
    first, second = (
        np.linalg.norm(np.cross(boxed[:, a] - boxed[:, 0], boxed[:, b] - boxed[:, 0]), axis=1)
        for a, b in ((1, 2), (2, 3))
    )
    fourth = [first / np.maximum(first + second, np.finfo(np.float64).tiny), *normals.T]
    lifted = boxed + LIFT * normals[:, None]
    packed = [np.column_stack([lifted[:, k], fourth[k]]).astype(np.float32) for k in range(4)]
    return DeviceCells(tuple(to_f32(x) for x in packed))


def visible_share(g: Geometry, cells: DeviceCells, pairs: I64, near: Bool, rays: I64, seed: int) -> tuple[F64, F64]:
    """Visible share (N,) of pairs (N, 2) of cells and its standard error (N,), REPLICATES - 1 degrees of freedom.

    near: (N,) whether the second fills so much of what the first sees that half of the rays shall leave the first by the
    cosine. rays: (N,) powers of two, at least 2 · REPLICATES.
    """
    share, se = np.zeros(len(pairs)), np.zeros(len(pairs))
    for n in np.unique(rays):
        step = max(1, RAYS_PER_BATCH // int(n))
        for close in (False, True):
            mine = np.flatnonzero((rays == n) & (near == close))
            for begin in range(0, len(mine), step):
                part = mine[begin : begin + step]
                share[part], se[part] = _batch(g, cells, pairs[part], close, part, int(n), seed)
    return share, se


def _batch(
    g: Geometry, cells: DeviceCells, pairs: I64, close: bool, number: I64, rays: int, seed: int
) -> tuple[F64, F64]:
    """`visible_share` of pairs that are all near, or none."""
    import drjit as dr
    import mitsuba as mi

    points = rays // REPLICATES
    table, lane = sobol_table(points), dr.arange(mi.UInt32, len(pairs) * rays)
    pair = lane >> dr.opaque(mi.UInt32, rays.bit_length() - 1)
    ray = lane & dr.opaque(mi.UInt32, rays - 1)
    index, replicate = ray & dr.opaque(mi.UInt32, points - 1), ray >> dr.opaque(mi.UInt32, points.bit_length() - 1)
    scramble = receiver_seeds(dr.gather(mi.UInt32, to_u32(number), pair), replicate, dr.opaque(mi.UInt32, seed))
    first, second = (_cell(cells, dr.gather(mi.UInt32, to_u32(pairs[:, k]), pair)) for k in range(2))
    u = [scrambled(table, index, scramble, k) for k in range(4)]
    a, by_direction = _point(first, u[0], u[1]), index >= dr.opaque(mi.UInt32, points // 2)
    between, kernel = _near_kernel(first, second, a, u, by_direction) if close else _kernel(first, second, a, u)
    distance = dr.sqrt(_squared(between))
    shadow = mi.Ray3f(a, between / distance)
    shadow.maxt = distance * (1.0 - 1e-5)
    seen = dr.select(g.caster.ray_test(shadow, coherent=False, active=kernel > 0.0), 0.0, kernel)
    dr.eval(kernel, seen)
    whole, part = (np.array(dr.block_sum(x, points), dtype=np.float64).reshape(-1, REPLICATES) for x in (kernel, seen))
    total = np.maximum(whole.sum(axis=1), np.finfo(np.float64).tiny)
    share = part.sum(axis=1) / total
    residual = part - share[:, None] * whole
    return share, np.sqrt((residual**2).sum(axis=1) * REPLICATES / (REPLICATES - 1.0)) / total


def _kernel(first: _Cell, second: _Cell, a: Any, u: list[Any]) -> tuple[Any, Any]:
    """Way from `a` to a uniform point of the second cell, and cosθ cosθ' / π r² times its area."""
    return _by_area(first, second, _point(second, u[2], u[3]) - a)


def _near_kernel(first: _Cell, second: _Cell, a: Any, u: list[Any], by_direction: Any) -> tuple[Any, Any]:
    """The same where half of the rays leave by the cosine, weighted by the balance heuristic."""
    import drjit as dr
    import mitsuba as mi

    frame = mi.Frame3f(mi.Normal3f(first.normal))
    direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[2], u[3])))
    met, inside = _met(second, a, direction)
    between, by_area = _by_area(first, second, dr.select(by_direction, met, _point(second, u[2], u[3])) - a)
    return between, dr.select(by_direction & ~inside, 0.0, by_area / (0.5 + 0.5 * by_area))


def _by_area(first: _Cell, second: _Cell, between: Any) -> tuple[Any, Any]:
    import drjit as dr

    cosines = dr.maximum(dr.dot(first.normal, between), 0.0) * dr.maximum(-dr.dot(second.normal, between), 0.0)
    return between, cosines / dr.square(_squared(between)) * _area(second) / dr.pi


def _squared(between: Any) -> Any:
    import drjit as dr

    return dr.maximum(dr.squared_norm(between), LEAST_DISTANCE**2)


class _Cell(NamedTuple):
    """Corners of the lanes' cells (four mi.Point3f), unit normal, share of the area in triangle 0 1 2."""

    corner: list[Any]
    normal: Any
    share: Any


def _cell(cells: DeviceCells, number: Any) -> _Cell:
    import drjit as dr
    import mitsuba as mi

    c = [dr.gather(mi.Vector4f, table, number) for table in cells.corner]
    return _Cell([mi.Point3f(k.x, k.y, k.z) for k in c], mi.Vector3f(c[1].w, c[2].w, c[3].w), c[0].w)


def _area(c: _Cell) -> Any:
    import drjit as dr

    diagonal = c.corner[2] - c.corner[0]
    return 0.5 * sum(dr.norm(dr.cross(c.corner[k] - c.corner[0], diagonal)) for k in (1, 3))


def _point(c: _Cell, u: Any, v: Any) -> Any:
    """Uniform point of a cell."""
    import drjit as dr

    first = u < c.share
    u = dr.clip(dr.select(first, u / c.share, (u - c.share) / (1.0 - c.share)), 0.0, 1.0)
    fold = u + v > 1.0
    u, v = dr.select(fold, 1.0 - u, u), dr.select(fold, 1.0 - v, v)
    origin = c.corner[0]
    p, q = dr.select(first, c.corner[1], c.corner[2]), dr.select(first, c.corner[2], c.corner[3])
    return origin + u * (p - origin) + v * (q - origin)


def _met(c: _Cell, origin: Any, direction: Any) -> tuple[Any, Any]:
    """Where a ray meets the plane of a cell, and whether on the front and within the cell."""
    import drjit as dr

    falling = dr.dot(c.normal, direction)
    reach = dr.dot(c.normal, c.corner[0] - origin) / falling
    place = origin + reach * direction
    inside = (falling < 0.0) & (reach > 0.0)
    for start, end in zip(c.corner, [*c.corner[1:], c.corner[0]], strict=True):
        inside &= dr.dot(dr.cross(end - start, place - start), c.normal) >= 0.0
    return place, inside
