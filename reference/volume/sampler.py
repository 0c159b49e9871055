"""The plain sampler: what the OpenCL kernel must return, step by step in NumPy.

    q = (p - origin) / h, clamped to the extent          position in finest voxels: integer cell + f32 fraction
    texel = indirection[lod][q / tile edge]               finest tile of level ≤ lod
    (light, weight) = trilinear of the voxel's 8 texels   light is premultiplied
    E(n) = reconstruction(light / weight, n)

Where the weight is under MIN_WEIGHT all nearby probes are invalid, and the level above is asked instead.

Positions count from an anchor, of which cell and fraction are found in double precision: what is near the anchor is then resolved as
finely 100 km from the origin as at it (failure-catalogue E5). q holds cell + fraction in double precision, which is exact.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F32, F64, I32, I64
from ..reconstruction import Reconstruction, irradiance
from ..texture_types import FARTHEST, WEIGHT, Samples, Viewer, VirtualTexture, anchor_cell, check_lod
from .levels import ring_lod

MIN_WEIGHT = np.float32(1.0 / 1024.0)


def sample(
    texture: VirtualTexture,
    positions: F32 | F64,
    normals: F32 | F64,
    lod: int | I32 | Viewer | None = None,
    anchor: F64 | None = None,
    reconstruction: Reconstruction = "linear",
) -> Samples:
    """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3). `lod`: finest level to use, one for all or (N,) i32, one for
    each sample, or by distance from a viewer; without it all levels. anchor (3,) m: see above; the texture's origin if None.

    A NaN position gives NaN there and nowhere else. Raises ValueError for a `lod` that the texture does not have.
    """
    q = lattice_position(texture, positions, anchor)
    n = np.asarray(normals, dtype=np.float32)
    if not isinstance(lod, Viewer):
        check_lod(lod, texture.level, len(positions))
        light, weight, level = resolve(texture, q, q, texture.level if lod is None else lod)
        out = _irradiance(reconstruction, light, weight, n)
    else:
        start = texture.origin if anchor is None else anchor
        asked, share = ring_lod(
            (np.asarray(positions, np.float64) - start).astype(np.float32), lod, start, texture.level
        )
        light, weight, level = resolve(texture, q, q, asked)
        out = _irradiance(reconstruction, light, weight, n)
        mixed = np.flatnonzero((share > 0.0) & (level > 0))
        light, less, found = resolve(texture, q[mixed], q[mixed], asked[mixed] - 1)
        next_one, t = _irradiance(reconstruction, light, less, n[mixed]), share[mixed, None]
        out[mixed] = np.where((found > 0)[:, None], out[mixed] * (np.float32(1.0) - t) + next_one * t, out[mixed])
    out[~np.isfinite(q).all(axis=1)] = np.nan
    return Samples(out, level, weight)


def _irradiance(reconstruction: Reconstruction, light: F32, weight: F32, normals: F32) -> F32:
    """(N, 3) f32 from premultiplied light (N, 12 or 27), weights (N,) and normals; 0 where the weight is."""
    ok = weight >= MIN_WEIGHT
    divided = light[ok] / weight[ok, None]
    first = divided[:, :12].reshape(-1, 3, 4)
    coefficients = np.concatenate(
        [first, divided[:, 12:].reshape(len(first), 3, (divided.shape[1] - 12) // 3)], axis=2
    ).transpose(0, 2, 1)
    out = np.zeros((len(light), 3), dtype=np.float32)
    out[ok] = irradiance(reconstruction, coefficients, normals[ok])
    return out


def lattice_position(texture: VirtualTexture, positions: F32 | F64, anchor: F64 | None = None) -> F64:
    """Positions (N, 3) m in finest voxels, clamped to the extent: whole cells and f32 fractions, added up in f64; NaN stays NaN.

    Raises ValueError for an anchor that is not three finite numbers or is too far for 32-bit cells.
    """
    start = texture.origin if anchor is None else np.asarray(anchor, dtype=np.float64)
    cell, offset = anchor_cell(texture.origin, texture.finest, start)
    local = (np.asarray(positions, dtype=np.float64) - start).astype(np.float32)
    x = np.clip(local * np.float32(1.0 / texture.finest) + offset, np.float32(-FARTHEST), np.float32(FARTHEST))
    whole = np.floor(x)
    q = whole.astype(np.float64) + cell + (x - whole)
    return np.asarray(np.clip(q, 0.0, texture.extent.astype(np.float64)), dtype=np.float64)


def resolve(texture: VirtualTexture, q: F64, lookup: F64, lod: int | I32) -> tuple[F32, F32, I32]:
    """Premultiplied light (N, 12 or 27), weight (N,) and level (N,) at `q` (N, 3) finest voxels, in the voxel that holds `lookup`.

    `lookup` differs from `q` only to ask for the other side of a border. lod: finest level to use, one for all or (N,).
    """
    n = len(q)
    light = np.zeros((n, texture.texels.shape[2] - 1), dtype=np.float32)
    weight, level = np.zeros(n, dtype=np.float32), np.zeros(n, dtype=np.int32)
    active = np.flatnonzero(np.isfinite(q).all(axis=1))
    ask = np.broadcast_to(np.asarray(lod, dtype=np.int64), (n,))[active]
    while len(active):
        slot, found = locate(texture, lookup[active], ask)
        value = interpolate(texture, q[active], lookup[active], slot, found)
        good = value[:, WEIGHT] >= MIN_WEIGHT
        done = active[good]
        light[done], weight[done] = np.delete(value[good], WEIGHT, axis=1), value[good, WEIGHT]
        level[done] = found[good]
        rest = ~good & (found > 1)
        active, ask = active[rest], found[rest] - 1
    return light, weight, level


def locate(texture: VirtualTexture, lookup: F64, lod: I64) -> tuple[I64, I64]:
    """Slot (N,) and level (N,) of the tile that LOD `lod` (N,) gives at `lookup` (N, 3) finest voxels."""
    i = texture.indirection
    cell = tile_cell(texture, lookup, lod)
    dims = i.dims[lod - 1]
    texel = i.texels[i.first[lod - 1] + (cell[:, 0] * dims[:, 1] + cell[:, 1]) * dims[:, 2] + cell[:, 2]].astype(
        np.int64
    )
    slot = (texel & 255) + i.cache[0] * (((texel >> 8) & 255) + i.cache[1] * ((texel >> 16) & 255))
    return slot, texel >> 24


def tile_cell(texture: VirtualTexture, lookup: F64, level: I64) -> I64:
    """Cell (N, 3) of level's tiles that holds `lookup`; the upper border belongs to the last cell."""
    edge = np.exp2(texture.level - level + 1)
    return np.minimum((lookup / edge[:, None]).astype(np.int64), texture.indirection.dims[level - 1] - 1)


def interpolate(texture: VirtualTexture, q: F64, lookup: F64, slot: I64, level: I64) -> F32:
    """Trilinear texel (N, C) at `q` within the tile in `slot`, in the tile's voxel that holds `lookup`."""
    half = np.exp2(texture.level - level)[:, None]
    base = tile_cell(texture, lookup, level) * (2 * half)
    voxel = np.clip(np.floor((lookup - base) / half), 0, 1)
    f = np.clip((q - base) / half - voxel, 0.0, 1.0).astype(np.float32)
    per_tile, channels = texture.texels.shape[1:]
    texels = texture.texels.reshape(-1, channels)
    first = slot * per_tile + (voxel[:, 0] * 9 + voxel[:, 1] * 3 + voxel[:, 2]).astype(np.int64)

    def texel(x: int, y: int, z: int) -> F32:
        return texels.take(first + (9 * x + 3 * y + z), axis=0)  # whole rows: seven times as fast as two indices are

    fx, fy, fz = f[:, :1], f[:, 1:2], f[:, 2:]
    one = np.float32(1.0)
    edge = {(x, y): texel(x, y, 0) * (one - fz) + texel(x, y, 1) * fz for x in (0, 1) for y in (0, 1)}
    face = {x: edge[x, 0] * (one - fy) + edge[x, 1] * fy for x in (0, 1)}
    return np.asarray(face[0] * (one - fx) + face[1] * fx, dtype=np.float32)
