"""Seams: at one point on a border of voxels, the formulas of both sides must agree.

    J(n) = |Êa(n) - Êb(n)|        S∞ = max J(n) / (Ê₀ + 0.01 Ē₀)        seam_area = share of points with J / Ê₀ > 1 %

J is taken at the worst of all normals (it is linear in the SH difference, so the worst is known), Ê₀ is the irradiance
averaged over normals and Ē₀ its mean over points: so the figure belongs to the texture, not to a choice of normals.
`seam_sup_normal` is the same at one random normal per point and relative to Ê there; where L1 irradiance all but
cancels (the side away from the light) it divides by almost nothing, and is larger.

`seam_gradient` is Sg of the catalogue: the jump over what the light changes by across the finer voxel (`seam_gradients`).

Points lie on faces, edges and vertices of leaf voxels (the ones samples really use); the sides are all the voxels that
meet there, found by looking a hair to each side. Three quarters lie between levels, where there are so many.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64
from ...reference.directions import sphere
from ...reference.sh import COSINE_A0, COSINE_A1, Y0, Y1, irradiance_weights
from ...reference.texture_types import VirtualTexture
from ...reference.volume.sampler import MIN_WEIGHT, locate, resolve
from .error import Measured

NUDGE = 1e-3  # of a finest voxel: how far to each side to look for the neighbour
MAX_POINTS = 20_000
GRADIENTS = 2_000  # points at which jumps are held against gradients
SIDES = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SeamPoints:
    """q (N, 3) f64 border points in finest voxels; normals (N, 3); across_levels: number of points between levels."""

    q: F64
    normals: np.ndarray
    across_levels: int


def seam_points(texture: VirtualTexture, regions: np.ndarray | None, seed: int) -> SeamPoints:
    """Random faces, edges and vertices of leaf voxels, level borders first.

    regions: (M, 3) positions in finest voxels around which to look, or None for everywhere.
    """
    rng = np.random.default_rng([seed, 23])
    n = 4 * MAX_POINTS
    if regions is None or len(regions) == 0:
        around = rng.random((n, 3)) * texture.extent
    else:
        around = regions[rng.integers(len(regions), size=n)] + rng.normal(size=(n, 3)) * 2.0
    where = np.clip(around, 0.0, texture.extent - 1e-3).astype(np.float32).astype(np.float64)
    _, level = locate(texture, where, np.full(n, texture.level))
    size = np.exp2(texture.level - level)[:, None]
    corner = np.round(where / size)
    kind = rng.integers(1, 4, size=n)  # on a face, an edge, a vertex
    rank = np.argsort(rng.random((n, 3)), axis=1)
    q = np.where(rank < kind[:, None], corner * size, where)
    inside = ((q > 0) | (rank >= kind[:, None])).all(axis=1) & (q < texture.extent).all(axis=1)
    q = q[inside]
    levels = np.stack([locate(texture, _nudged(texture, q, s), np.full(len(q), texture.level))[1] for s in SIDES])
    across = (levels != levels[0]).any(axis=0)
    order = np.concatenate([np.flatnonzero(across)[: 3 * MAX_POINTS // 4], np.flatnonzero(~across)])[:MAX_POINTS]
    normals = sphere(rng.random((len(order), 2)))
    return SeamPoints(q[order], normals, int(across[order].sum()))


def _nudged(texture: VirtualTexture, q: F64, side: F64) -> F64:
    """Look to one side, along the axes on whose borders the points lie."""
    step = np.where(q == np.round(q), NUDGE * side, 0.0)
    return np.asarray(np.clip(q + step, 0.0, texture.extent), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SeamJumps:
    """At N border points. jump (N,): J at the worst normal, W·m⁻²; relative (N,): over Ê₀ + 0.01 Ē₀; mean (N,): Ê₀. own (N,): J at
    the point's own normal, W·m⁻²; own_mean (N,): Ê there; at_normal (N,): the one over the other + 0.01 Ē."""

    jump: F64
    relative: F64
    mean: F64
    at_normal: F64
    own: F64
    own_mean: F64


def seam_jumps(texture: VirtualTexture, points: SeamPoints) -> SeamJumps:
    """The jumps of a virtual texture at border points."""
    n, weights = len(points.q), irradiance_weights(points.normals)
    mean, jump, own_mean, own = (np.zeros(n) for _ in range(4))
    for rows, meeting in _meeting(points.q):
        q = points.q[rows]
        sides = np.stack([_radiance(texture, q, _nudged(texture, q, s)) for s in meeting])
        mean[rows] = COSINE_A0 * Y0 * np.abs(sides[..., 0]).mean(axis=(0, 2))
        for a, b in itertools.combinations(range(len(sides)), 2):
            jump[rows] = np.maximum(jump[rows], _worst_jump(sides[a] - sides[b]))
        at_normal = np.einsum("nk,snck->snc", weights[rows], sides)
        own_mean[rows] = np.abs(at_normal).mean(axis=(0, 2))
        own[rows] = (at_normal.max(axis=0) - at_normal.min(axis=0)).max(axis=1)
    relative = jump / (mean + 0.01 * float(mean.mean()) + 1e-30)
    return SeamJumps(jump, relative, mean, own / (own_mean + 0.01 * float(own_mean.mean()) + 1e-30), own, own_mean)


def _meeting(q: F64) -> Iterator[tuple[I64, F64]]:
    """Numbers (K,) of the points `q` (N, 3) that lie on borders along the same axes, and the sides (2, 4 or 8, 3) that meet there:
    along another axis both ways lead into the same voxel."""
    on = q == np.round(q)
    for axes in (SIDES > 0.0)[1:]:
        rows = np.flatnonzero((on == axes).all(axis=1))
        if len(rows):
            yield rows, SIDES[(SIDES > 0.0)[:, ~axes].all(axis=1)]


def measure_seams(texture: VirtualTexture, points: SeamPoints, suffix: str = "") -> dict[str, Measured]:
    """seam_sup, seam_p99, seam_area and seam_sup_normal of a virtual texture, names followed by `suffix`."""
    return seam_metrics(seam_jumps(texture, points), suffix)


def seam_metrics(jumps: SeamJumps, suffix: str = "") -> dict[str, Measured]:
    """The same of jumps found already."""
    n = len(jumps.jump)
    return {
        f"seam_sup{suffix}": Measured(float(jumps.relative.max()), 0.0, n),
        f"seam_p99{suffix}": Measured(float(np.percentile(jumps.relative, 99)), 0.0, n),
        f"seam_area{suffix}": Measured(float((jumps.jump > 0.01 * jumps.mean).mean()), 0.0, n),
        f"seam_sup_normal{suffix}": Measured(float(jumps.at_normal.max()), 0.0, n),
    }


def seam_gradients(texture: VirtualTexture, points: SeamPoints, jumps: SeamJumps) -> tuple[I64, F64]:
    """Numbers (K,) of up to GRADIENTS points, those with the largest jumps among them, and Sg (K,) there: the jump over what the light
    changes by across the finer voxel anyway, at the point's own normal.

        Sg = J / (h_fine max_sides |∇Ê| + 1e-6 Ē)

    Gradients are differences over a quarter of each side's voxel, towards its middle, with the formula of that side.
    """
    order = np.argsort(-jumps.at_normal, kind="stable")
    rest = np.random.default_rng(0).permutation(order[GRADIENTS // 2 :])
    some = np.concatenate([order[: GRADIENTS // 2], rest[: GRADIENTS - GRADIENTS // 2]]).astype(np.int64)
    q, weights = points.q[some], irradiance_weights(points.normals[some])
    steepest, finer = np.zeros(len(some)), np.full(len(some), np.inf)
    for rows, meeting in _meeting(q):
        for side in meeting:
            slope, size = _slope(texture, q[rows], _nudged(texture, q[rows], side), weights[rows])
            steepest[rows] = np.maximum(steepest[rows], slope)
            finer[rows] = np.minimum(finer[rows], size)
    across = finer * steepest + 1e-6 * float(jumps.own_mean.mean()) + 1e-30
    return some, np.asarray(jumps.own[some] / across)


def _slope(texture: VirtualTexture, q: F64, lookup: F64, weights: F64) -> tuple[F64, F64]:
    """Largest |∇Ê| (N,) over colours at `q`, by the formula of the voxel that holds `lookup`, and its size (N,), finest voxels."""
    _, level = locate(texture, lookup, np.full(len(q), texture.level))
    size = np.exp2(texture.level - level)[:, None]
    inwards = np.where((np.floor(lookup / size) + 0.5) * size >= q, 0.25, -0.25) * size
    here = _at_normal(texture, q, lookup, weights)
    slopes = []
    for axis in np.eye(3):
        step = inwards * axis
        change = _at_normal(texture, q + step, lookup, weights) - here
        slopes.append(change / step.sum(axis=1)[:, None])
    return np.asarray(np.linalg.norm(slopes, axis=0).max(axis=1)), size[:, 0]


def _at_normal(texture: VirtualTexture, q: F64, lookup: F64, weights: F64) -> F64:
    """Irradiance (N, 3) at `q`, by the formula of the voxel that holds `lookup`."""
    return np.asarray(np.einsum("nk,nck->nc", weights, _radiance(texture, q, lookup)))


def _radiance(texture: VirtualTexture, q: F64, lookup: F64) -> F64:
    """Radiance SH of order 1 (N, 3, 4) at `q`, by the formula of the voxel that holds `lookup`."""
    light, weight, _ = resolve(texture, q, lookup, texture.level)
    return light[:, :12].reshape(-1, 3, 4).astype(np.float64) / np.maximum(weight, MIN_WEIGHT)[:, None, None]


def _worst_jump(difference: F64) -> F64:
    """Largest |ΔE(n)| over normals and colours (N,) of a radiance SH difference (N, 3, 4)."""
    directed = np.linalg.norm(difference[..., 1:], axis=-1)
    return np.asarray((COSINE_A0 * Y0 * np.abs(difference[..., 0]) + COSINE_A1 * Y1 * directed).max(axis=1))
