"""Seams: at one point on a border of voxels, the formulas of both sides must agree.

    J(n) = |Êa(n) - Êb(n)|        S∞ = max J(n) / (Ê₀ + 0.01 Ē₀)        seam_area = share of points with J / Ê₀ > 1 %

J is taken at the worst of all normals (it is linear in the SH difference, so the worst is known), Ê₀ is the irradiance
averaged over normals and Ē₀ its mean over points: so the figure belongs to the texture, not to a choice of normals.
`seam_sup_normal` is the same at one random normal per point and relative to Ê there; where L1 irradiance all but
cancels (the side away from the light) it divides by almost nothing, and is larger.

Points lie on faces, edges and vertices of leaf voxels (the ones samples really use); the sides are all the voxels that
meet there, found by looking a hair to each side. Three quarters lie between levels, where there are so many.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64
from ...reference.directions import sphere
from ...reference.sh import COSINE_A0, COSINE_A1, Y0, Y1, irradiance_weights
from ...reference.texture_types import VirtualTexture
from ...reference.volume.sampler import MIN_WEIGHT, locate, resolve
from .error import Measured

NUDGE = 1e-3  # of a finest voxel: how far to each side to look for the neighbour
MAX_POINTS = 20_000
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


def measure_seams(texture: VirtualTexture, points: SeamPoints, suffix: str = "") -> dict[str, Measured]:
    """seam_sup, seam_p99, seam_area and seam_sup_normal of a virtual texture, names followed by `suffix`."""
    sides = np.stack([_radiance(texture, points.q, _nudged(texture, points.q, s)) for s in SIDES])
    mean = COSINE_A0 * Y0 * np.abs(sides[..., 0]).mean(axis=(0, 2))
    jump = np.zeros(len(points.q))
    for a, b in itertools.combinations(range(len(sides)), 2):
        jump = np.maximum(jump, _worst_jump(sides[a] - sides[b]))
    relative, n = jump / (mean + 0.01 * float(mean.mean()) + 1e-30), len(jump)
    at_normal = np.einsum("nk,snck->snc", irradiance_weights(points.normals), sides)
    local = np.abs(at_normal).mean(axis=(0, 2))
    spread = (at_normal.max(axis=0) - at_normal.min(axis=0)).max(axis=1) / (local + 0.01 * float(local.mean()) + 1e-30)
    return {
        f"seam_sup{suffix}": Measured(float(relative.max()), 0.0, n),
        f"seam_p99{suffix}": Measured(float(np.percentile(relative, 99)), 0.0, n),
        f"seam_area{suffix}": Measured(float((jump > 0.01 * mean).mean()), 0.0, n),
        f"seam_sup_normal{suffix}": Measured(float(spread.max()), 0.0, n),
    }


def _radiance(texture: VirtualTexture, q: F64, lookup: F64) -> F64:
    """Radiance SH of order 1 (N, 3, 4) at `q`, by the formula of the voxel that holds `lookup`."""
    light, weight, _ = resolve(texture, q, lookup, texture.level)
    return light[:, :12].reshape(-1, 3, 4).astype(np.float64) / np.maximum(weight, MIN_WEIGHT)[:, None, None]


def _worst_jump(difference: F64) -> F64:
    """Largest |ΔE(n)| over normals and colours (N,) of a radiance SH difference (N, 3, 4)."""
    directed = np.linalg.norm(difference[..., 1:], axis=-1)
    return np.asarray((COSINE_A0 * Y0 * np.abs(difference[..., 0]) + COSINE_A1 * Y1 * directed).max(axis=1))
