"""Ray estimates of what two meshes exchange, from REPLICATES independent Owen-scrambled Sobol sequences.

Rays are dealt to cells in systematic order by what the cells send, so each gets its share to within one ray, and the
Sobol points of neighbours are stratified against one another. The standard error is that of replicates about their
mean: no assumption about the integrand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...datatypes import F64, I64, U32, Bool
from ...device_arrays import to_f64, to_u32
from ...low_discrepancy import SobolTable, mixed, receiver_seeds, scrambled, sobol_table
from ...visibility import LIFT, Geometry, cast
from .pair_exchange import Exchange
from .polygon_clip import unit_normals
from .segment_walk import blocked
from .shaft import Blockers

REPLICATES = 32
# 97.5 % quantile of Student's t with 31 degrees of freedom over that of the normal distribution: with it the interval
# value ± 1.96 se covers 95 %, though its width is itself known from 32 numbers only.
STUDENT = 2.0395 / 1.9600
LANES = 1 << 21
# Cells nearer than this share of the larger one's radius: their kernel is too peaked for points chosen by area.
NEAR = 0.25


@dataclass(frozen=True)
class Estimate:
    """Mean and its standard error (both in the unit of the quantity), and rays cast."""

    value: float
    se: float
    rays: int


def _summary(passed: F64, whole: F64, scale: float, rays: int) -> Estimate:
    """`scale` times the ratio of two sums over replicates, each (REPLICATES,), with its linearised standard error.

    When no ray, or every ray, got through, replicates agree and say nothing about the error: then it is what would
    have let a 1 in `rays` chance go unseen (the rule of three, as ±1.96 standard errors).
    """
    total = max(float(whole.sum()), np.finfo(np.float64).tiny)
    ratio = float(passed.sum()) / total
    residual = passed - ratio * whole
    se = STUDENT * math.sqrt(float(residual @ residual) * REPLICATES / (REPLICATES - 1)) / total
    return Estimate(scale * ratio, scale * max(se, 1.5 / max(rays, 1)), rays)


def _dealt(weights: F64, count: int, replicates: I64, seed: int) -> U32:
    """Cell (replicates, count) of each ray: ray k of a replicate falls at the share (k + δ) / count of the weights' sum."""
    cumulative = np.cumsum(weights)
    with np.errstate(over="ignore"):  # arithmetic modulo 2^32 is meant
        seeds = receiver_seeds(np.full(len(replicates), 1, np.uint32), replicates.astype(np.uint32), seed)
        delta = mixed(seeds) * 2.0**-32
    places = (np.arange(count)[None, :] + delta[:, None]) * (cumulative[-1] / count)
    found = np.searchsorted(cumulative, places.ravel(), side="right")
    return np.minimum(found, len(weights) - 1).astype(np.uint32)


def _batches(per_replicate: int) -> list[I64]:
    """Replicate numbers in groups of at most about LANES rays."""
    step = max(1, LANES // per_replicate)
    return [np.arange(b, min(b + step, REPLICATES)) for b in range(0, REPLICATES, step)]


def _points(table: SobolTable, per_replicate: int, replicates: I64, seed: int) -> tuple[Any, ...]:
    """Four mi.Float coordinates of each ray's point."""
    import drjit as dr
    import mitsuba as mi

    lane = dr.arange(mi.UInt32, len(replicates) * per_replicate)
    count = dr.opaque(mi.UInt32, per_replicate)
    replicate = dr.opaque(mi.UInt32, int(replicates[0])) + lane // count
    seeds = receiver_seeds(dr.zeros(mi.UInt32, dr.width(lane)), replicate, dr.opaque(mi.UInt32, seed))
    return tuple(scrambled(table, lane % count, seeds, d) for d in range(4))


def visible_exchange(blockers: Blockers, e: Exchange, rays: int, seed: int) -> Estimate:
    """What the undecided cells of `e` exchange, m²: their closed form times the share of it that shadow rays let through."""
    first, second = e.first - blockers.centre, e.second - blockers.centre
    cells = tuple(to_f64(x) for x in (first, second, unit_normals(first), unit_normals(second), e.weights))
    by_cosine = to_u32(_near(first, second))
    per_replicate = rays // REPLICATES
    table = sobol_table(1 << max(0, per_replicate - 1).bit_length())
    passed, whole, cast_rays = np.zeros(REPLICATES), np.zeros(REPLICATES), 0
    for replicates in _batches(per_replicate):
        cell = to_u32(_dealt(e.weights, per_replicate, replicates, seed))
        xi = _points(table, per_replicate, replicates, seed)
        weight, seen = (np.array(x) for x in _shadow_rays(blockers, cells, by_cosine, cell, xi))
        w = weight.reshape(len(replicates), per_replicate)
        passed[replicates] = np.where(seen.reshape(w.shape), w, 0.0).sum(axis=1)
        whole[replicates] = w.sum(axis=1)
        cast_rays += int(np.count_nonzero(w))
    return _summary(passed, whole, float(e.weights.sum()), cast_rays)


def _near(first: F64, second: F64) -> Bool:
    """(K,) whether directions are chosen instead of points on the second cell."""
    radii = [np.linalg.norm(x - x.mean(axis=1, keepdims=True), axis=2).max(axis=1) for x in (first, second)]
    apart = np.linalg.norm(first.mean(axis=1) - second.mean(axis=1), axis=1) - radii[0] - radii[1]
    gap = np.maximum(first.min(axis=1) - second.max(axis=1), second.min(axis=1) - first.max(axis=1))
    distance = np.maximum(apart, np.linalg.norm(np.maximum(gap, 0.0), axis=1))
    return np.asarray(distance < NEAR * np.maximum(*radii))


def _shadow_rays(blockers: Blockers, cells: tuple[Any, ...], by_cosine: Any, cell: Any, xi: tuple[Any, ...]) -> Any:
    """Weight of each ray (mean 1 over a cell pair, 0 where the ends cannot see each other) and whether it gets through."""
    import drjit as dr
    import mitsuba as mi

    a, b = ([dr.gather(mi.Vector3d, t, cell * 4 + k) for k in range(4)] for t in cells[:2])
    normal_a, normal_b = (dr.gather(mi.Vector3d, t, cell) for t in cells[2:4])
    u1, v1, u2, v2 = (mi.Float64(x) for x in xi)
    x, density_x = _bilinear(a, u1, v1)
    y_area, density_y = _bilinear(b, u2, v2)
    y_cosine, inside = _along_cosine(x, normal_a, b, normal_b, u2, v2)
    chosen = dr.gather(mi.UInt32, by_cosine, cell) != 0
    y = dr.select(chosen, y_cosine, y_area)
    d = y - x
    cosines = dr.maximum(dr.dot(normal_a, d), 0.0) * dr.maximum(-dr.dot(normal_b, d), 0.0)
    kernel = cosines * density_y / (dr.pi * dr.square(dr.maximum(dr.squared_norm(d), 1e-300)))
    weight = density_x * dr.select(chosen, dr.select(inside, 1.0, 0.0), kernel) / dr.gather(mi.Float64, cells[4], cell)
    live = weight > 0.0
    tolerance = dr.opaque(mi.Float64, blockers.tolerance)
    seen = live & ~blocked(blockers.scene, x, y, tolerance, live)
    dr.eval(weight, seen)
    return weight, seen


def _bilinear(quad: list[Any], u: Any, v: Any) -> tuple[Any, Any]:
    """`lambert.bilinear`: point and area density."""
    import drjit as dr

    a, b, c, d = quad
    along, across = dr.lerp(b - a, c - d, v), dr.lerp(d - a, c - b, u)
    return a + u * (b - a) + v * across, dr.norm(dr.cross(along, across))


def _along_cosine(x: Any, normal: Any, quad: list[Any], plane: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Where a cosine-distributed ray from `x` meets the plane of `quad`, and whether inside it and from its front."""
    import drjit as dr
    import mitsuba as mi

    direction = _cosine_direction(normal, u, v)
    slope = dr.dot(direction, plane)
    t = dr.dot(quad[0] - x, plane) / dr.select(slope < 0.0, slope, -1.0)
    y = x + t * direction
    inside = (slope < 0.0) & (t > 0.0)
    for p, q in zip(quad, quad[1:] + quad[:1], strict=True):
        inside &= dr.dot(dr.cross(q - p, y - p), plane) >= 0.0
    return dr.select(inside, y, x + mi.Vector3d(direction)), inside


def _cosine_direction(normal: Any, u: Any, v: Any) -> Any:
    """Direction about `normal` with density cos θ / π (Malley's method; frame of Duff et al. 2017)."""
    import drjit as dr

    radius, angle = dr.sqrt(u), 2.0 * dr.pi * v
    sign = dr.select(normal.z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + normal.z)
    b = normal.x * normal.y * a
    vector = type(normal)
    tangent = vector(1.0 + sign * dr.square(normal.x) * a, sign * b, -sign * normal.x)
    bitangent = vector(b, sign + dr.square(normal.y) * a, -normal.y)
    height = dr.sqrt(dr.maximum(0.0, 1.0 - u))
    return radius * dr.cos(angle) * tangent + radius * dr.sin(angle) * bitangent + height * normal


def hit_share(g: Geometry, source: int, target: int, rays: int, seed: int) -> Estimate:
    """Form factor from mesh number `source` of the geometry to `target`: cosine rays that meet a front of it first."""
    chosen = np.flatnonzero(g.mesh == source)
    corners = (g.vertices[g.faces[chosen]] - g.centre) / g.scale
    device = to_f64(corners), to_f64(g.normals[chosen])
    aimed = to_u32(g.mesh == target)
    per_replicate = rays // REPLICATES
    table = sobol_table(1 << max(0, per_replicate - 1).bit_length())
    passed = np.zeros(REPLICATES)
    for replicates in _batches(per_replicate):
        triangle = to_u32(_dealt(g.areas[chosen], per_replicate, replicates, seed))
        hits = _first_hits(g, device, triangle, _points(table, per_replicate, replicates, seed), aimed)
        passed[replicates] = hits.reshape(len(replicates), per_replicate).sum(axis=1)
    return _summary(passed, np.full(REPLICATES, float(per_replicate)), 1.0, per_replicate * REPLICATES)


def _first_hits(g: Geometry, device: tuple[Any, Any], triangle: Any, xi: tuple[Any, ...], aimed: Any) -> Bool:
    import drjit as dr
    import mitsuba as mi

    u, v, u2, v2 = (mi.Float64(x) for x in xi)
    a, b, c = (dr.gather(mi.Vector3d, device[0], triangle * 3 + k) for k in range(3))
    normal = dr.gather(mi.Vector3d, device[1], triangle)
    root = dr.sqrt(u)
    x = a + root * ((1.0 - v) * (b - a) + v * (c - a))
    hits = cast(g, mi.Point3f(x + LIFT * normal), mi.Vector3f(_cosine_direction(normal, u2, v2)))
    met = hits.front & (dr.gather(mi.UInt32, aimed, hits.triangle, hits.front) != 0)
    return np.array(met)
