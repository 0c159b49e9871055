"""Other ways to read the same probes: what they share, fixed-point fractions, and one sample per mesh. Plain specifications.

    answering    the voxel that the plain sampler reads: the finest in which the texels' trilinear weights sum to MIN_WEIGHT or more
    fixed point  fractions rounded to 8 bits, as texture units interpolate (24.8; failure-catalogue E1): f' = round(256 f) / 256
    per mesh     the texture sampled once, at the middle of a mesh; that light serves all of the mesh by each pixel's own normal (talk,
                 "Per-mesh sampling")

Visibility weights are in other_ways_visibility.py, light stored as ratios in other_ways_ratio.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F32, F64, I32, I64, Bool
from ..lattice import OCTANTS
from ..sh import irradiance_weights
from ..texture_types import Samples, VirtualTexture
from .layout import TEXELS
from .linear import VOXEL_TEXELS
from .sampler import MIN_WEIGHT, lattice_position, locate

FRACTION_BITS = 8


@dataclass(frozen=True, eq=False)
class Voxels:
    """What samples read. corners (N, 8) i64: texels at the voxel's corners, tile · 27 + texel, z fastest; share (N, 8) f32: their
    trilinear weights; fraction (N, 3) f32 within the voxel; level (N,) i32 that answers, 0 where none does; missing (N,) bool: the
    position is NaN."""

    corners: I64
    share: F32
    fraction: F32
    level: I32
    missing: Bool


def answering(texture: VirtualTexture, positions: F32 | F64, bits: int | None = None) -> Voxels:
    """The voxels that answer samples at `positions` (N, 3) m; bits: of fixed-point fractions, exact ones without it."""
    q = lattice_position(texture, positions)
    n, missing = len(q), np.asarray(np.isnan(q).any(axis=1))
    corners, share = np.zeros((n, 8), dtype=np.int64), np.zeros((n, 8), dtype=np.float32)
    fraction, level = np.zeros((n, 3), dtype=np.float32), np.zeros(n, dtype=np.int32)
    weights = texture.texels[..., 12].ravel()
    active = np.flatnonzero(~missing)
    ask = np.full(len(active), texture.level, dtype=np.int64)
    while len(active):
        slot, found = locate(texture, q[active], ask)
        first, f = _within(texture, q[active], found)
        f = f if bits is None else np.floor(f * np.float32(1 << bits) + np.float32(0.5)) / np.float32(1 << bits)
        number, part = slot[:, None] * TEXELS + first[:, None] + VOXEL_TEXELS, shares(f)
        good = (part * weights[number]).sum(axis=1, dtype=np.float32) >= MIN_WEIGHT
        done = active[good]
        corners[done], share[done], fraction[done], level[done] = number[good], part[good], f[good], found[good]
        rest = ~good & (found > 1)
        active, ask = active[rest], found[rest] - 1
    return Voxels(corners, share, fraction, level, missing)


def _within(texture: VirtualTexture, q: F32 | F64, level: I64) -> tuple[I64, F32]:
    """First texel (N,) of the voxel of `level` that holds q (N, 3), within its tile, and the place in the voxel (N, 3), 0 … 1."""
    cell = np.minimum(np.floor(q), texture.extent - 1).astype(np.int64)
    fraction = (q - cell).astype(np.float32)
    shift = (texture.level - level)[:, None]
    inner = (cell & ((1 << shift) - 1)).astype(np.float32) + fraction
    f = inner * np.exp2(-shift.astype(np.float32))
    return ((cell >> shift) & 1) @ np.array([9, 3, 1]), f


def shares(f: F32) -> F32:
    """Trilinear weights (N, 8) of a voxel's corners, z fastest, at the places f (N, 3) in it."""
    x, y, z = (
        np.where(OCTANTS[None, :, axis] == 1, f[:, axis, None], np.float32(1.0) - f[:, axis, None]) for axis in range(3)
    )
    return np.asarray((x * y) * z, dtype=np.float32)


def mixed(texture: VirtualTexture, at: Voxels, share: F32) -> F32:
    """Texels (N, 13) at the corners, summed with the weights `share` (N, 8)."""
    table = texture.texels[..., :13].reshape(-1, 13)
    return np.asarray(sum(table[at.corners[:, i]] * share[:, i, None] for i in range(8)), dtype=np.float32)


def lit(at: Voxels, light: F32, weight: F32, normals: F32 | F64) -> Samples:
    """Irradiance of premultiplied light (N, 12) and its weight (N,) at unit `normals` (N, 3): 0 where no level answers, NaN where the
    position was."""
    known = at.level > 0
    divided = (light / np.where(known, weight, np.float32(1.0))[:, None]).astype(np.float32)
    irradiance = np.where(known[:, None], evaluated(divided, normals), np.float32(0.0))
    irradiance[at.missing] = np.nan
    return Samples(irradiance, at.level, np.where(known, weight, np.float32(0.0)))


def evaluated(light: F32, normals: F32 | F64) -> F32:
    """Irradiance (N, 3) of radiance SH (N, 12), four of red, of green, of blue, at unit `normals` (N, 3)."""
    w = irradiance_weights(np.asarray(normals, dtype=np.float32)).astype(np.float32)
    return np.asarray(np.einsum("nck,nk->nc", light.reshape(-1, 3, 4), w), dtype=np.float32)


def fixed_point(
    texture: VirtualTexture, positions: F32 | F64, normals: F32 | F64, bits: int = FRACTION_BITS
) -> Samples:
    """The plain sampler with fractions of `bits` bits, at `positions` (N, 3) m for unit `normals` (N, 3)."""
    at = answering(texture, positions, bits)
    found = mixed(texture, at, at.share)
    return lit(at, found[:, :12], found[:, 12], normals)


def mesh_light(texture: VirtualTexture, middles: F32 | F64) -> F32:
    """Radiance SH (M, 12) at the middles (M, 3) m of meshes; 0 where no level answers."""
    at = answering(texture, middles)
    found = mixed(texture, at, at.share)
    known = (at.level > 0)[:, None]
    return np.where(known, found[:, :12] / np.where(known, found[:, 12:13], np.float32(1.0)), np.float32(0.0))


def per_mesh(light: F32, mesh: I32, normals: F32 | F64) -> F32:
    """Irradiance (N, 3) of pixels that take the light (M, 12) of their `mesh` (N,) at unit `normals` (N, 3)."""
    return evaluated(light[mesh], normals)
