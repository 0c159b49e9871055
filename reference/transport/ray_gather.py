"""Light gathered by rays at points, straight from the patches and without keeping form factors.

    E     = ∫ L(ω) max(n·ω, 0) dω         irradiance at a surface
    c_lm  = ∫ L(ω) Y_lm(ω) dω             radiance SH: what a probe that stands there should hold

L is the radiance of what a ray ends in: a patch, a bin of the sky, or nothing. Both integrals come from the same rays, and for
several lightings of the same patches at once: differences between them then carry hardly any of the rays' noise. Where there is
a normal, half of the rays follow the cosine and half the sphere (balance heuristic; Veach 1997), without one all the sphere.
Rays are REPLICATES independent scrambles of Owen-scrambled Sobol points (see low_discrepancy.py), kept apart as batches: the
cross-half estimator of validation/metrics/error.py cancels their noise. The same seed gives point i the same directions wherever
it stands. Plain twin: `transport.form_factors` (the same integrals through rows; test_ray_gather.py holds them together).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..datatypes import F32, F64
from ..device_arrays import drop_device_cache, to_f32
from ..low_discrepancy import receiver_seeds, scrambled, sobol_table
from ..sh import Y0, Y1, Y2, Y20, Order, coefficient_count
from ..variant import ensure_variant
from ..visibility import LIFT, Geometry
from .form_factors import REPLICATES
from .hits import DevicePatches, columns_of_rays

LANES = 1 << 19  # rays per launch: each carries up to 9 coefficients of three colours


@dataclass(frozen=True, eq=False)
class RayGather:
    """irradiance (T, B, N, 3) f64 W·m⁻² for T lightings, B = REPLICATES batches; None where the points have no normal.
    radiance (B, N, K, 3) f64 W·m⁻²: SH coefficients for the last lighting, K = 4 or 9. rays: per point, in all batches."""

    irradiance: F64 | None
    radiance: F64
    rays: int


def ray_gather(
    g: Geometry, p: DevicePatches, positions: F64, normals: F64 | None, lights: Sequence[F64 | F32], rays: int, seed: int,
    order: Order = 1,
) -> RayGather:  # fmt: skip
    """Light at `positions` (N, 3) m, lifted a hair along unit `normals` (N, 3) if given.

    lights: per lighting what the columns carry, (columns, 3) W·m⁻² as `Radiosity.light`. rays: per point, a power of two, at least
    4 · REPLICATES. Raises ValueError for another number, and without a lighting.
    """
    if rays < 4 * REPLICATES or rays & (rays - 1):
        raise ValueError(f"rays must be a power of two, at least {4 * REPLICATES}, got {rays}")
    if not lights:
        raise ValueError("expected at least one lighting, got none")
    ensure_variant()
    n, k = len(positions), coefficient_count(order)
    boxed = (np.asarray(positions, dtype=np.float64) - g.centre) / g.scale
    origin = to_f32(boxed if normals is None else boxed + LIFT * normals)
    normal = None if normals is None else to_f32(normals)
    tables = [to_f32(light) for light in lights]
    step = max(1, LANES // rays)
    parts = [
        _launch(g, p, (origin, normal, tables), range(first, min(first + step, n)), rays, seed, k)
        for first in range(0, n, step)
    ]
    drop_device_cache()
    sums = np.concatenate(parts, axis=2) if parts else np.zeros((3 * (len(lights) + k), REPLICATES, 0))
    shaped = sums.reshape(-1, 3, *sums.shape[1:]).transpose(0, 2, 3, 1)  # (lightings, then coefficients; B, N, 3)
    irradiance = None if normals is None else shaped[:-k]
    return RayGather(irradiance, np.ascontiguousarray(shaped[-k:].transpose(1, 2, 0, 3)), rays)


def _launch(
    g: Geometry, p: DevicePatches, data: tuple[Any, Any, list[Any]], part: range, rays: int, seed: int, k: int
) -> F64:
    """Means over the rays of each batch, (values, B, part) f64: three colours of each lighting's irradiance, where there are
    normals, then of each of the K coefficients."""
    import drjit as dr
    import mitsuba as mi

    origin, normals, tables = data
    each = rays // REPLICATES
    lane = dr.arange(mi.UInt32, len(part) * rays)
    receiver = (lane >> dr.opaque(mi.UInt32, rays.bit_length() - 1)) + dr.opaque(mi.UInt32, part.start)
    ray = lane & dr.opaque(mi.UInt32, rays - 1)
    replicate, index = ray >> dr.opaque(mi.UInt32, each.bit_length() - 1), ray & dr.opaque(mi.UInt32, each - 1)
    scramble, table = receiver_seeds(receiver, replicate, dr.opaque(mi.UInt32, seed)), sobol_table(each)
    xi = mi.Point2f(*(scrambled(table, index, scramble, d) for d in (0, 1)))
    direction, cosine, density = _direction(receiver, index, xi, normals, each)
    column, _ = columns_of_rays(g, p, dr.gather(mi.Point3f, origin, receiver), direction)
    radiances = [dr.gather(mi.Color3f, light, column) * (dr.inv_pi / density) for light in tables]
    values = [] if cosine is None else [c * cosine for radiance in radiances for c in radiance]
    values += [c * y for y in _basis(direction, k) for c in radiances[-1]]
    dr.eval(values)  # together: each sum by itself would trace all rays again
    sums = [np.array(dr.block_sum(v, each), dtype=np.float64).reshape(len(part), REPLICATES).T / each for v in values]
    return np.stack(sums)


def _direction(receiver: Any, index: Any, xi: Any, normals: Any, each: int) -> tuple[Any, Any, Any]:
    """Directions, max(n·ω, 0) (None without normals) and density per steradian. The first half of a Sobol net is a net too."""
    import drjit as dr
    import mitsuba as mi

    anywhere = mi.warp.square_to_uniform_sphere(xi)
    if normals is None:
        return anywhere, None, mi.Float(dr.inv_four_pi)
    normal = dr.gather(mi.Vector3f, normals, receiver)
    ahead = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(xi))
    direction = dr.select(index < dr.opaque(mi.UInt32, each // 2), ahead, anywhere)
    cosine = dr.maximum(dr.dot(normal, direction), 0.0)
    return direction, cosine, 0.5 * cosine * dr.inv_pi + 0.5 * dr.inv_four_pi


def _basis(d: Any, k: int) -> list[Any]:
    """The first K functions of `sh.basis` in directions `d` (mi.Vector3f)."""
    import mitsuba as mi

    first = [mi.Float(Y0), Y1 * d.y, Y1 * d.z, Y1 * d.x]
    if k == len(first):
        return first
    x, y, z = d.x, d.y, d.z
    return [*first, Y2 * x * y, Y2 * y * z, Y20 * (3.0 * z * z - 1.0), Y2 * x * z, 0.5 * Y2 * (x * x - y * y)]
