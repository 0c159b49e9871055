"""Eight texels, each weighted by how likely the sample sees its probe: the plain specification.

    c = ((ω · n + 1) / 2)² + 0.2              ω from the sample to the probe: probes behind the surface count less
    v = σ² / (σ² + (d - m)²) if d > m else 1  Chebyshev's bound on the share of surfaces further away than the sample
    u = c max(v³, 0.05);  u = u³ / 0.2² where u < 0.2          small weights are crushed
    E(n) = Σ_i t_i u_i L_i(n) / Σ_i t_i u_i w_i

d is the distance between sample and probe, m and σ² = m₂ - m² mean and variance of what the probe sees in that direction, all in
voxels of the level that answers; t_i are trilinear weights, and light is premultiplied by w_i, which is 0 for invalid probes. So
RTXGI-DDGI weights its probes. Halves hold m² and m₂ to a part in two thousand each, so no variance under 2^-10 m² is believed. ω is
that from the lifted sample, where RTXGI takes the surface's own point.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F32, F64
from ..lattice import OCTANTS
from ..octahedral import read
from ..texture_types import DistanceMaps, Samples, VirtualTexture
from .layout import TEXEL_OFFSETS, TEXELS, TileLayout
from .other_ways import answering, lit, mixed

FACING, FLOOR, CRUSHED, LEAST_VARIANCE, NEAR = (np.float32(v) for v in (0.2, 0.05, 0.2, 2.0**-10, 1e-6))


def served_places(layout: TileLayout) -> tuple[F64, F64, np.ndarray]:
    """Where samples need to know how far a probe sees: positions (M, 3) m of texels, distinct by level and place, the voxel edge (M,) m
    of that level, and the number (tiles, 27) i32 of each texel's place."""
    grid, places, edges, numbers, known = layout.grid, [], [], [], 0
    for level, parents in enumerate(layout.parents, start=1):
        step = 1 << (grid.level - level)
        corner = (2 * parents[:, None, :] + TEXEL_OFFSETS[None]).reshape(-1, 3) * step
        distinct, number = np.unique(corner, axis=0, return_inverse=True)
        places.append(grid.corner_positions(distinct))
        edges.append(np.full(len(distinct), grid.size(level)))
        numbers.append(number.reshape(len(parents), TEXELS) + known)
        known += len(distinct)
    return np.concatenate(places), np.concatenate(edges), np.concatenate(numbers).astype(np.int32)


def chebyshev(texture: VirtualTexture, maps: DistanceMaps, positions: F32 | F64, normals: F32 | F64) -> Samples:
    """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3), texels weighted by visibility; the level is that which the plain
    sampler answers with."""
    at = answering(texture, positions)
    share = np.empty_like(at.share)
    n = np.asarray(normals, dtype=np.float32)
    number = maps.number.reshape(-1)[at.corners]
    for i, corner in enumerate(OCTANTS):
        share[:, i] = at.share[:, i] * visibility(
            maps.moments, number[:, i], corner.astype(np.float32) - at.fraction, n
        )
    found = mixed(texture, at, share)
    return lit(at, found[:, :12], found[:, 12], normals)


def visibility(moments: np.ndarray, number: np.ndarray, towards: F32, normals: F32) -> F32:
    """Weights (N,) of probes that lie `towards` (N, 3) voxels from their samples, whose maps are `number` (N,) of `moments`."""
    x, y, z = towards[:, 0], towards[:, 1], towards[:, 2]
    distance = np.sqrt((x * x + y * y) + z * z)
    near = distance < NEAR  # the sample is the probe: it sees itself, from no direction
    length = np.where(near, np.float32(1.0), distance)
    half = np.float32(0.5)
    along = (x * normals[:, 0] + y * normals[:, 1]) + z * normals[:, 2]
    facing = (along / length + np.float32(1.0)) * half
    back = np.where(near[:, None], np.array([0, 0, 1], np.float32), -towards)
    seen = read(moments, number, back)
    m = seen[:, 0]
    variance = np.maximum(seen[:, 1] - m * m, m * m * LEAST_VARIANCE)
    beyond = distance - m
    bound = np.where(
        beyond > 0, variance / np.where(beyond > 0, variance + beyond * beyond, np.float32(1.0)), np.float32(1.0)
    )
    u = (facing * facing + FACING) * np.maximum((bound * bound) * bound, FLOOR)
    return np.asarray(np.where(u < CRUSHED, u * (u * u) / (CRUSHED * CRUSHED), u), dtype=np.float32)
