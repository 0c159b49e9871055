"""How many rays each receiver gets: enough for the error asked for, and no more.

A pilot traces PILOT rays per receiver and lets them gather a guess of the light. The spread of its replicates gives each
receiver's relative variance per ray σ_i². The mean square error over all receivers, Σ a_i σ_i²/N_i with weights a_i, reaches
τ² with the fewest rays for N_i = √a_i σ_i · Σ_j √a_j σ_j / τ² (Neyman 1934, optimum allocation), with τ = noise. The pilot is
not used again, so that stopping where the spread happened to look small cannot bias the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I64, U32
from ..visibility import Geometry
from .accumulate import launch_batch
from .form_factors import RAYS_PER_BATCH, REPLICATES
from .hits import upload_patches
from .patches import Patches
from .receivers import Receivers

PILOT = 64
LEAST = 64
# The pilot's variance of one receiver has only REPLICATES - 1 degrees of freedom: it is drawn to the mean of all, which
# counts as this many more.
PRIOR = 3.0
STEPS = 20
DIM = 0.1
PILOT_SEED = 7919  # the pilot's rays are others than those of the result


@dataclass(frozen=True, eq=False)
class Allocation:
    """rays (R,) i64: per receiver, powers of two. spent: their sum and the pilot's. uniform: rays that the same number for
    every receiver would need for the same root-mean-square error. reached: that error, relative."""

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


def gathered(pilot: Pilot, light: F64) -> tuple[F64, F64]:
    """Irradiance (R,) that the pilot gathers from `light` (columns,), and its variance (R,) from the replicates.

    For probes of irradiance averaged over all normals: with E(n) = π Y00 L00 + 2π/3 Σ_m Y1m(n) L1m the mean square of its
    error is var(mean B) + 4/3 Σ_m var(mean ω_m B), over rays of direction ω that find radiosity B.
    """
    found = light[pilot.columns]
    terms = found[..., None]
    if pilot.directions is not None:
        terms = np.concatenate([terms, math.sqrt(4.0 / 3.0) * pilot.directions * terms], axis=2)
    parts = terms.reshape(len(found), REPLICATES, -1, terms.shape[2]).mean(axis=2)
    return parts[..., 0].mean(axis=1), parts.var(axis=1, ddof=1).sum(axis=1) / REPLICATES


def pilot_matrix(pilot: Pilot, columns: int) -> sparse.csr_array:
    """Form factors (R, columns) as the pilot found them, for receivers whose rays weigh 1."""
    r = len(pilot.columns)
    data = np.full(pilot.columns.size, 1.0 / PILOT)
    indptr = np.arange(r + 1) * PILOT
    m = sparse.csr_array((data, pilot.columns.ravel().astype(np.int32), indptr), shape=(r, columns))
    m.sum_duplicates()
    return m


def allocate(pilot: Pilot, light: F64, weights: F64, noise: float, most: int, least: int = LEAST) -> Allocation:
    """Rays for a relative standard error of `noise` of the gathered light, in the root mean square over receivers.

    Relative to what the receiver itself gathers, so that a bright outside does not hide a room; receivers darker than
    DIM × the mean count as that. light: (columns,) guess of what each column sends. weights: (R,) of the receivers in the
    mean (areas, or ones). most, least: rays of one receiver.
    """
    count, least = len(pilot.columns), min(least, most)
    if count == 0 or not light.any():
        return fixed(count, least)
    share, (mean, variance) = weights / weights.sum(), gathered(pilot, light)
    scale = mean + DIM * float(share @ mean)
    relative = variance / np.maximum(scale, np.finfo(np.float64).tiny) ** 2
    dof = REPLICATES - 1.0
    per_ray = PILOT * (dof * relative + PRIOR * float(share @ relative)) / (dof + PRIOR)
    deviation = np.sqrt(share * per_ray)

    def rays_for(square: float) -> I64:
        exact = np.clip(deviation * deviation.sum() / square, least, most)
        return np.asarray(2 ** np.rint(np.log2(exact)).astype(np.int64))

    square = noise**2
    rays = rays_for(square)
    for _ in range(STEPS):  # powers of two, the least and the most leave the target by a little
        if float(share @ (per_ray / rays)) <= noise**2 or (rays == most).all():
            break
        square *= 0.9
        rays = rays_for(square)
    reached = float(share @ (per_ray / rays))
    uniform = float(share @ per_ray) / reached if reached > 0.0 else float(least)
    return Allocation(rays, int(rays.sum()) + PILOT * count, round(uniform * count), float(np.sqrt(reached)))
