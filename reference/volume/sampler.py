"""The plain sampler: what the OpenCL kernel must return, step by step in float32 NumPy.

    q = (p - origin) / h, clamped to the extent          position in finest voxels
    texel = indirection[lod][q / tile edge]               finest tile of level ≤ lod
    (light, weight) = trilinear of the voxel's 8 texels   light is premultiplied
    E(n) = Σ_k w_k(n) light_k / weight                     irradiance from L1 radiance

Where the weight is under MIN_WEIGHT all nearby probes are invalid, and the level above is asked instead.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F32, F64, I32, I64, Samples, VirtualTexture, check_lod
from ..sh import irradiance_weights

MIN_WEIGHT = np.float32(1.0 / 1024.0)


def sample(texture: VirtualTexture, positions: F32 | F64, normals: F32 | F64, lod: int | I32 | None = None) -> Samples:
    """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3). `lod`: finest level to use, one for all or (N,) i32, one for
    each sample; without it all levels.

    A NaN position gives NaN there and nowhere else. Raises ValueError for a `lod` that the texture does not have.
    """
    check_lod(lod, texture.level, len(positions))
    q = lattice_position(texture, positions)
    weights = irradiance_weights(np.asarray(normals, dtype=np.float32)).astype(np.float32)
    light, weight, level = resolve(texture, q, q, texture.level if lod is None else lod)
    irradiance = _divide(light, weight, weights)
    irradiance[~np.isfinite(q).all(axis=1)] = np.nan
    return Samples(irradiance, level, weight)


def _divide(light: F32, weight: F32, weights: F32) -> F32:
    out = np.zeros((len(light), 3), dtype=np.float32)
    ok = weight >= MIN_WEIGHT
    for colour in range(3):
        c = light[:, 4 * colour : 4 * colour + 4]
        e = weights[:, 0] * c[:, 0] + weights[:, 1] * c[:, 1] + weights[:, 2] * c[:, 2] + weights[:, 3] * c[:, 3]
        out[ok, colour] = e[ok] / weight[ok]
    return out


def lattice_position(texture: VirtualTexture, positions: F32 | F64) -> F32:
    """Positions (N, 3) in finest voxels, f32, clamped to the extent; NaN stays NaN."""
    origin, inverse = texture.origin.astype(np.float32), np.float32(1.0 / texture.finest)
    q = (np.asarray(positions, dtype=np.float32) - origin) * inverse
    return np.clip(q, np.float32(0.0), texture.extent.astype(np.float32))


def resolve(texture: VirtualTexture, q: F32, lookup: F32, lod: int | I32) -> tuple[F32, F32, I32]:
    """Premultiplied light (N, 12), weight (N,) and level (N,) at `q` (N, 3) finest voxels, in the voxel that holds `lookup`.

    `lookup` differs from `q` only to ask for the other side of a border. lod: finest level to use, one for all or (N,).
    """
    n = len(q)
    light, weight = np.zeros((n, 12), dtype=np.float32), np.zeros(n, dtype=np.float32)
    level = np.zeros(n, dtype=np.int32)
    active = np.flatnonzero(np.isfinite(q).all(axis=1))
    ask = np.broadcast_to(np.asarray(lod, dtype=np.int64), (n,))[active]
    while len(active):
        slot, found = locate(texture, lookup[active], ask)
        value = interpolate(texture, q[active], lookup[active], slot, found)
        good = value[:, 12] >= MIN_WEIGHT
        done = active[good]
        light[done], weight[done], level[done] = value[good, :12], value[good, 12], found[good]
        rest = ~good & (found > 1)
        active, ask = active[rest], found[rest] - 1
    return light, weight, level


def locate(texture: VirtualTexture, lookup: F32, lod: I64) -> tuple[I64, I64]:
    """Slot (N,) and level (N,) of the tile that LOD `lod` (N,) gives at `lookup` (N, 3) finest voxels."""
    i = texture.indirection
    cell = tile_cell(texture, lookup, lod)
    dims = i.dims[lod - 1]
    texel = i.texels[i.first[lod - 1] + (cell[:, 0] * dims[:, 1] + cell[:, 1]) * dims[:, 2] + cell[:, 2]].astype(
        np.int64
    )
    slot = (texel & 255) + i.cache[0] * (((texel >> 8) & 255) + i.cache[1] * ((texel >> 16) & 255))
    return slot, texel >> 24


def tile_cell(texture: VirtualTexture, lookup: F32, level: I64) -> I64:
    """Cell (N, 3) of level's tiles that holds `lookup`; the upper border belongs to the last cell."""
    edge = np.exp2(texture.level - level + 1).astype(np.float32)
    return np.minimum((lookup / edge[:, None]).astype(np.int64), texture.indirection.dims[level - 1] - 1)


def interpolate(texture: VirtualTexture, q: F32, lookup: F32, slot: I64, level: I64) -> F32:
    """Trilinear texel (N, 13) at `q` within the tile in `slot`, in the tile's voxel that holds `lookup`."""
    half = np.exp2(texture.level - level).astype(np.float32)[:, None]
    base = tile_cell(texture, lookup, level).astype(np.float32) * (2 * half)
    voxel = np.clip(np.floor((lookup - base) / half), 0, 1)
    f = np.clip((q - base) / half - voxel, np.float32(0.0), np.float32(1.0))
    first = (voxel[:, 0] * 9 + voxel[:, 1] * 3 + voxel[:, 2]).astype(np.int64)

    def texel(x: int, y: int, z: int) -> F32:
        return texture.texels[slot, first + (9 * x + 3 * y + z)]

    fx, fy, fz = f[:, :1], f[:, 1:2], f[:, 2:]
    one = np.float32(1.0)
    edge = {(x, y): texel(x, y, 0) * (one - fz) + texel(x, y, 1) * fz for x in (0, 1) for y in (0, 1)}
    face = {x: edge[x, 0] * (one - fy) + edge[x, 1] * fy for x in (0, 1)}
    return np.asarray(face[0] * (one - fx) + face[1] * fx, dtype=np.float32)
