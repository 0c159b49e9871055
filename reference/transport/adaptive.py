"""How many rays each receiver gets: enough for the error asked for, and no more.

A pilot traces PILOT rays per receiver and lets them gather a guess of the light. The spread of its replicates gives each
receiver's relative variance per ray σ_i². The mean square error over all receivers, Σ a_i σ_i²/N_i with weights a_i, reaches
τ² with the fewest rays for N_i = √a_i σ_i · Σ_j √a_j σ_j / τ² (Neyman 1934, optimum allocation), with τ = noise. The pilot is
not used again, so that stopping where the spread happened to look small cannot bias the result.

A receiver whose few pilot rays missed a small lamp looks dark and even at once. So its replicates are taken in two halves:
the spread of one is set against the mean of the other, and what the allocation of one gains is judged by the other.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I64, U32, Bool, Scene
from ..sky import SKY_BINS, bin_radiance, split_peaks
from ..visibility import Geometry
from .accumulate import launch_batch
from .form_factors import RAYS_PER_BATCH, REPLICATES
from .hits import upload_patches
from .patches import Patches
from .receivers import Receivers

PILOT = 64
LEAST = 64
# The pilot's variance of one receiver has few degrees of freedom: it is drawn to the mean of all, which counts as this many.
PRIOR = 3.0
STEPS = 20
PILOT_BOUNCES = 8
DIM = 0.1
PILOT_SEED = 7919  # the pilot's rays are others than those of the result


@dataclass(frozen=True, eq=False)
class Allocation:
    """rays (R,) i64: per receiver, powers of two. spent: their sum and the pilot's. uniform: rays that the same number for
    every receiver would need for the same root-mean-square error, rather too few than too many. reached: that error,
    relative, as the pilot foresees it."""

    rays: I64
    spent: int
    uniform: int
    reached: float


def fixed(count: int, rays: int) -> Allocation:
    """The same rays for all."""
    return Allocation(np.full(count, rays, dtype=np.int64), count * rays, count * rays, 0.0)


@dataclass(frozen=True, eq=False)
class Pilot:
    """columns (R, PILOT) u32: where each ray ended. directions (R, PILOT, 3) f32 of probes' rays, else None."""

    columns: U32
    directions: F32 | None


def trace_pilot(g: Geometry, p: Patches, receivers: Receivers, seed: int) -> Pilot:
    """PILOT rays from every receiver."""
    device, step = upload_patches(g, p), max(1, RAYS_PER_BATCH // PILOT)
    columns = np.empty((receivers.count, PILOT), dtype=np.uint32)
    directions = np.empty((receivers.count, PILOT, 3), dtype=np.float32) if receivers.spherical else None
    for begin in range(0, receivers.count, step):
        rows = np.arange(begin, min(begin + step, receivers.count))
        traced = launch_batch(g, device, receivers, rows, PILOT, REPLICATES, seed + PILOT_SEED)
        keys = np.array(traced.keys)
        columns[rows] = (keys // np.array(PILOT, keys.dtype)).reshape(len(rows), PILOT)
        if directions is not None:
            directions[rows] = np.array(traced.directions).T.reshape(len(rows), PILOT, 3)
    return Pilot(columns, directions)


def gathered(pilot: Pilot, light: F64, of: slice = slice(None)) -> tuple[F64, F64]:
    """Irradiance (R,) that the pilot gathers from `light` (columns,), and its variance (R,) from the replicates.

    of: replicates that count. For probes of irradiance averaged over all normals: with E(n) = π Y00 L00 + 2π/3 Σ_m Y1m(n) L1m
    the mean square of its error is var(mean B) + 4/3 Σ_m var(mean ω_m B), over rays of direction ω that find radiosity B.
    """
    found = light[pilot.columns]
    terms = found[..., None]
    if pilot.directions is not None:
        terms = np.concatenate([terms, math.sqrt(4.0 / 3.0) * pilot.directions * terms], axis=2)
    parts = terms.reshape(len(found), REPLICATES, -1, terms.shape[2]).mean(axis=2)[:, of]
    return parts[..., 0].mean(axis=1), parts.var(axis=1, ddof=1).sum(axis=1) / parts.shape[1]


def pilot_matrix(pilot: Pilot, columns: int) -> sparse.csr_array:
    """Form factors (R, columns) as the pilot found them, for receivers whose rays weigh 1."""
    r = len(pilot.columns)
    data = np.full(pilot.columns.size, 1.0 / PILOT)
    indptr = np.arange(r + 1) * PILOT
    m = sparse.csr_array((data, pilot.columns.ravel().astype(np.int32), indptr), shape=(r, columns))
    m.sum_duplicates()
    return m


def guess_light(scene: Scene, p: Patches, pilot: Pilot, direct: F64) -> F64:
    """Mean colour (columns,) of the light on patches and sky, from the pilot's rays and direct light (P, 3): good enough to
    say where more rays are needed."""
    matrix = pilot_matrix(pilot, p.count + SKY_BINS + 1)
    sky = np.pi * bin_radiance(None if scene.sky is None else split_peaks(scene.sky)[0])
    b = p.exitance + p.albedo * direct
    for _ in range(PILOT_BOUNCES):
        b = p.exitance + p.albedo * (direct + matrix @ np.concatenate([b, sky, np.zeros((1, 3))]))
    return np.concatenate([b, sky, np.zeros((1, 3))]).mean(axis=1)


def allocate(pilot: Pilot, light: F64, weights: F64, noise: float, most: int, least: int = LEAST) -> Allocation:
    """Rays for a relative standard error of `noise` of the gathered light, in the root mean square over receivers.

    Relative to what the receiver itself gathers, so that a bright outside does not hide a room; receivers darker than
    DIM × the mean count as that. light: (columns,) guess of what each column sends. weights: (R,) of the receivers in the
    mean (areas, or ones). most, least: rays of one receiver.
    """
    count, least = len(pilot.columns), min(least, most)
    if count == 0 or not light.any():
        return fixed(count, least)
    share, (one, two) = weights / weights.sum(), (gathered(pilot, light, slice(k, None, 2)) for k in (0, 1))
    dark = DIM * float(share @ (one[0] + two[0])) / 2.0
    if dark == 0.0:  # what shines was not met by any of them
        return fixed(count, least)
    halves = [PILOT / 2 * a[1] / (b[0] + dark) ** 2 for a, b in ((one, two), (two, one))]
    per_ray = _drawn((halves[0] + halves[1]) / 2.0, share, REPLICATES - 2.0)
    square, rays = noise**2, _neyman(per_ray, share, noise**2, least, most)
    for _ in range(STEPS):  # powers of two, the least and the most leave the target by a little
        if float(share @ (per_ray / rays)) <= noise**2 or (rays == most).all():
            break
        square *= 0.9
        rays = _neyman(per_ray, share, square, least, most)
    reached = float(share @ (per_ray / rays))
    by_half = [_neyman(_drawn(h, share, REPLICATES / 2 - 1.0), share, square, least, most) for h in halves]
    judged = float(share @ (halves[1] / by_half[0] + halves[0] / by_half[1]))
    uniform = float(share @ (halves[0] + halves[1])) / judged if judged > 0.0 else float(least)
    return Allocation(rays, int(rays.sum()) + PILOT * count, round(uniform * count), float(np.sqrt(reached)))


def raised(a: Allocation, b: Allocation, where: Bool) -> Allocation:
    """`a`, but with the rays of `b` where those are more, at receivers `where` (R,)."""
    rays = np.where(where, np.maximum(a.rays, b.rays), a.rays)
    return dataclasses.replace(a, rays=rays, spent=a.spent + int((rays - a.rays).sum()))


def _drawn(per_ray: F64, share: F64, dof: float) -> F64:
    """Variances (R,) of `dof` degrees of freedom, drawn to their mean."""
    return np.asarray((dof * per_ray + PRIOR * float(share @ per_ray)) / (dof + PRIOR))


def _neyman(per_ray: F64, share: F64, square: float, least: int, most: int) -> I64:
    """Rays (R,), powers of two, for a mean square error `square`."""
    deviation = np.sqrt(share * per_ray)
    exact = np.clip(deviation * deviation.sum() / square, least, most)
    return np.asarray(2 ** np.rint(np.log2(exact)).astype(np.int64))
