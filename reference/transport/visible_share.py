"""The share of the light between two patches that nothing stops: shadow rays between points of both, weighted with the
kernel cosθ cosθ' / r². Its estimate is a ratio, so it is exact where all or nothing is seen, and multiplies a closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..datatypes import F64, I64
from ..device_arrays import to_f32, to_u32
from ..low_discrepancy import receiver_seeds, scrambled, sobol_table
from ..visibility import LIFT, Geometry

REPLICATES = 8
RAYS_PER_BATCH = 1 << 21


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


def visible_share(g: Geometry, cells: DeviceCells, pairs: I64, rays: I64, seed: int) -> tuple[F64, F64]:
    """Visible share (N,) of pairs (N, 2) of cells and its standard error (N,), REPLICATES - 1 degrees of freedom.

    rays: (N,) powers of two, at least 2 · REPLICATES.
    """
    share, se = np.zeros(len(pairs)), np.zeros(len(pairs))
    for n in np.unique(rays):
        mine = np.flatnonzero(rays == n)
        step = max(1, RAYS_PER_BATCH // int(n))
        for begin in range(0, len(mine), step):
            part = mine[begin : begin + step]
            share[part], se[part] = _batch(g, cells, pairs[part], part, int(n), seed)
    return share, se


def _batch(g: Geometry, cells: DeviceCells, pairs: I64, number: I64, rays: int, seed: int) -> tuple[F64, F64]:
    import drjit as dr
    import mitsuba as mi

    points = rays // REPLICATES
    table, lane = sobol_table(points), dr.arange(mi.UInt32, len(pairs) * rays)
    pair = lane >> dr.opaque(mi.UInt32, rays.bit_length() - 1)
    ray = lane & dr.opaque(mi.UInt32, rays - 1)
    index, replicate = ray & dr.opaque(mi.UInt32, points - 1), ray >> dr.opaque(mi.UInt32, points.bit_length() - 1)
    name = dr.gather(mi.UInt32, to_u32(number), pair)
    scramble = receiver_seeds(name, replicate, dr.opaque(mi.UInt32, seed))
    (a, na), (b, nb) = (
        _point(cells, dr.gather(mi.UInt32, to_u32(pairs[:, k]), pair),
               scrambled(table, index, scramble, 2 * k), scrambled(table, index, scramble, 2 * k + 1))
        for k in range(2)
    )  # fmt: skip
    between = b - a
    squared = dr.squared_norm(between)
    kernel = dr.maximum(dr.dot(na, between), 0.0) * dr.maximum(-dr.dot(nb, between), 0.0) / dr.square(squared)
    distance = dr.sqrt(squared)
    shadow = mi.Ray3f(a, between / distance)
    shadow.maxt = distance * (1.0 - 1e-5)
    seen = dr.select(g.caster.ray_test(shadow, coherent=False, active=kernel > 0.0), 0.0, kernel)
    dr.eval(kernel, seen)
    whole, part = (np.array(dr.block_sum(x, points), dtype=np.float64).reshape(-1, REPLICATES) for x in (kernel, seen))
    total = np.maximum(whole.sum(axis=1), np.finfo(np.float64).tiny)
    share = part.sum(axis=1) / total
    residual = part - share[:, None] * whole
    return share, np.sqrt((residual**2).sum(axis=1) * REPLICATES / (REPLICATES - 1.0)) / total


def _point(cells: DeviceCells, cell: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Uniform point of a cell, and its normal."""
    import drjit as dr
    import mitsuba as mi

    c = [dr.gather(mi.Vector4f, table, cell) for table in cells.corner]
    first = u < c[0].w
    u = dr.clip(dr.select(first, u / c[0].w, (u - c[0].w) / (1.0 - c[0].w)), 0.0, 1.0)
    fold = u + v > 1.0
    u, v = dr.select(fold, 1.0 - u, u), dr.select(fold, 1.0 - v, v)
    origin, p, q = (
        mi.Point3f(k.x, k.y, k.z) for k in (c[0], dr.select(first, c[1], c[2]), dr.select(first, c[2], c[3]))
    )
    return origin + u * (p - origin) + v * (q - origin), mi.Vector3f(c[1].w, c[2].w, c[3].w)
