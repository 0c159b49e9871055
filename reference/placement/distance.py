"""Harmonic mean distance to surfaces: HM = N / Σ 1/d_i over N directions (Tatarchuk 2005; talk, "Subdivision heuristic").

A miss adds 0 to the sum, so all misses give infinity; a distance of 0 gives 0; NaN cannot arise (failure-catalogue C5).

One kernel, one lane per corner: a loop over the N directions of a spherical Fibonacci lattice (Keinert et al. 2015, eq. 1), turned by
a random rotation (Shoemake 1992, "Uniform random rotations") that a counter-based hash makes of the corner's key and the seed
alone. A corner's value is its own: whatever else is asked, in whatever batch, it stays the same to the bit.

Whether a corner is *nearer* than some limit is known as soon as the sum passes N / limit: terms are never negative, so its
lane stops there, with the answer that the whole sum would give.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ..datatypes import F32, F64, I64, Bool
from ..device_arrays import to_f32, to_u32
from ..variant import ensure_variant
from ..visibility import Geometry, to_box

CORNERS_PER_BATCH = 1 << 20
GOLDEN = 0x9E3779B9  # 2^32 over the golden section
GOLDEN_TURN = 0x61C88647  # 2^32 over its square: the golden angle, 2^32 to the turn


def harmonic_mean(g: Geometry, positions: F64, keys: I64, rays: int, seed: int) -> F64:
    """Harmonic mean distance (N,) m from `positions` (N, 3) m; `keys` (N,) choose the rotations of the `rays` directions."""
    total = _inverse_sums(g, positions, keys, np.full(len(keys), np.inf), rays, seed)
    with np.errstate(divide="ignore"):
        return np.asarray(g.scale * rays / total.astype(np.float64))


def nearer_than(g: Geometry, positions: F64, keys: I64, limit: float, rays: int, seed: int) -> Bool:
    """Whether the harmonic mean distance from each position is under `limit`, m: (N,) bool."""
    enough = np.full(len(keys), rays * g.scale / limit, dtype=np.float32)
    return _inverse_sums(g, positions, keys, enough, rays, seed) > enough


def _inverse_sums(
    g: Geometry, positions: F64, keys: I64, enough: npt.NDArray[np.floating], rays: int, seed: int
) -> F32:
    """Σ 1/d (N,) over the directions, d in halves of the scene's longest side; a sum stops growing once it passes `enough` (N,)."""
    ensure_variant()
    if len(keys) == 1:  # a single lane would be compiled as a constant, in a kernel of its own
        twice = np.repeat(positions, 2, axis=0), np.repeat(keys, 2), np.repeat(enough, 2)
        return _inverse_sums(g, *twice, rays, seed)[:1]
    total = np.empty(len(keys), dtype=np.float32)
    for begin in range(0, len(keys), CORNERS_PER_BATCH):
        part = slice(begin, begin + CORNERS_PER_BATCH)
        total[part] = _launch(g, positions[part], keys[part], enough[part], rays, seed)
    return total


def _launch(g: Geometry, positions: F64, keys: I64, enough: npt.NDArray[np.floating], rays: int, seed: int) -> F32:
    """One batch of `_inverse_sums`."""
    import drjit as dr
    import mitsuba as mi

    origin, stop = to_box(g, positions), to_f32(enough)
    count, axes = dr.opaque(mi.UInt32, rays), _rotation(keys, seed)

    def add(i: Any, total: Any) -> tuple[Any, Any]:
        found = g.caster.ray_intersect_preliminary(mi.Ray3f(origin, _direction(axes, i, count)), coherent=False)
        inverse = dr.rcp(dr.abs(found.t))  # -0 where the origin lies on the surface
        return i + 1, total + dr.select(found.is_valid(), inverse, 0)

    def unfinished(i: Any, total: Any) -> Any:
        return (i < count) & (total <= stop)

    lanes = dr.width(stop)
    state = dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float, lanes)
    return np.array(dr.while_loop(state, unfinished, add, label="harmonic mean")[1])


def corner_rays(g: Geometry, positions: F64, keys: I64, rays: int, seed: int) -> tuple[Any, Any]:
    """The rays of `harmonic_mean` in memory, evaluated: origins and directions (rays · N,), in the scene's unit box, all first
    directions first. For measuring what tracing them takes without anything else."""
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    lane = dr.arange(mi.UInt32, rays * len(keys))
    corner = lane % dr.opaque(mi.UInt32, len(keys))
    axes = tuple(dr.gather(mi.Vector3f, axis, corner) for axis in _rotation(keys, seed))
    directions = _direction(axes, lane // dr.opaque(mi.UInt32, len(keys)), dr.opaque(mi.UInt32, rays))
    origins = dr.gather(mi.Point3f, to_box(g, positions), corner)
    dr.eval(origins, directions)
    return origins, directions


def _direction(axes: tuple[Any, ...], i: Any, count: Any) -> Any:
    """Direction `i` of `count` on the spherical Fibonacci lattice in a rotated frame; whole turns are dropped in integers, so
    that none is rounded."""
    import drjit as dr
    import mitsuba as mi

    z = 1 - (2 * mi.Float(i) + 1) / mi.Float(count)
    r = dr.sqrt(dr.maximum(0, 1 - z * z))
    sine, cosine = dr.sincos(mi.Float(i * GOLDEN_TURN) * (2 * math.pi * 2.0**-32))
    return r * cosine * axes[0] + r * sine * axes[1] + z * axes[2]


def _rotation(keys: I64, seed: int) -> tuple[Any, Any, Any]:
    """Columns of a uniform random rotation matrix for each key (N,), a function of its two halves and the seed."""
    import drjit as dr
    import mitsuba as mi

    low, high = to_u32(keys & 0xFFFFFFFF), to_u32(keys >> 32)
    first = _mixed(low ^ _mixed(high ^ _mixed(dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))))
    second = _mixed(first + GOLDEN)
    u, v, w = (mi.Float(bits) * 2.0**-32 for bits in (first, second, _mixed(second + GOLDEN)))
    (s1, c1), (s2, c2) = dr.sincos(2 * math.pi * v), dr.sincos(2 * math.pi * w)
    r1, r2 = dr.sqrt(dr.maximum(0, 1 - u)), dr.sqrt(u)
    x, y, z, real = r1 * s1, r1 * c1, r2 * s2, r2 * c2
    return (
        mi.Vector3f(1 - 2 * (y * y + z * z), 2 * (x * y + real * z), 2 * (x * z - real * y)),
        mi.Vector3f(2 * (x * y - real * z), 1 - 2 * (x * x + z * z), 2 * (y * z + real * x)),
        mi.Vector3f(2 * (x * z + real * y), 2 * (y * z - real * x), 1 - 2 * (x * x + y * y)),
    )


def _mixed(bits: Any) -> Any:
    """A bijective hash of 32 bits in which every bit of the argument moves every bit of the result (Wellons 2018, "lowbias32")."""
    import mitsuba as mi

    bits = mi.UInt32(bits)
    bits = (bits ^ (bits >> 16)) * 0x7FEB352D
    bits = (bits ^ (bits >> 15)) * 0x846CA68B
    return bits ^ (bits >> 16)
