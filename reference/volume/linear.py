"""The virtual texture as sparse matrices: what fills a texel, and what a sample reads. The slow, obvious twin of `fill_tiles` and
`sample` for those who want many lightings at once: light is linear, weights do not depend on it.

    texel_t  = Σ_r T_tr light_r            T: real texels are probes, virtual ones are mixed from the parent tile
    light(x) = Σ_t S_xt texel_t / weight   S: trilinear, weight = Σ_t S_xt Σ_r T_tr

Both in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I32, I64
from ..lattice import OCTANTS
from ..texture_types import VirtualTexture
from .layout import TEXELS, TileLayout
from .sampler import MIN_WEIGHT, lattice_position, locate, tile_cell
from .tiles import PARENT_WEIGHTS, ROOT_WEIGHTS

VOXEL_TEXELS = OCTANTS @ np.array([9, 3, 1])  # a voxel's corners from its first texel on, within a tile


def texel_matrix(layout: TileLayout, light_from: I32) -> sparse.csr_array:
    """T (tiles · 27, R) in slot order; light_from (R,): whose light each probe uses, -1 for none. Row sums are the weights."""
    lit = np.flatnonzero(light_from >= 0)
    r = len(light_from)
    used = sparse.csr_array((np.ones(len(lit)), (lit, light_from[lit])), shape=(r, r))
    blocks: list[sparse.csr_array] = []
    for i, probe in enumerate(layout.probe):
        flat = probe.ravel()
        real = np.flatnonzero(flat >= 0)
        place = sparse.csr_array((np.ones(len(real)), (real, flat[real])), shape=(len(flat), r)) @ used
        blocks.append((place + _mixed(layout, i) @ (blocks[-1] if i else place)).tocsr())
    return sparse.vstack(blocks, format="csr")


def _mixed(layout: TileLayout, i: int) -> sparse.csr_array:
    """Weights of level i + 1's virtual texels on texels of the level above; for the root tile on its own corners."""
    flat = layout.probe[i].ravel()
    virtual = np.flatnonzero(flat < 0)
    tile, texel = virtual // TEXELS, virtual % TEXELS
    rows = PARENT_WEIGHTS[layout.octant[i][tile], texel] if i else ROOT_WEIGHTS[texel]
    at, source = np.nonzero(rows)
    above = layout.parent_tile[i][tile[at]].astype(np.int64) * TEXELS if i else 0
    shape = (len(flat), layout.probe[max(i - 1, 0)].size)
    return sparse.csr_array((rows[at, source].astype(np.float64), (virtual[at], above + source)), shape=shape)


@dataclass(frozen=True, eq=False)
class Reading:
    """What samples read: weights (N, R) on probes, summing to one, or to nothing where no valid probe is near."""

    weights: sparse.csr_array

    def irradiance(self, normal_weights: F64, coefficients: F64 | F32) -> F64:
        """(N, m) W·m⁻² for `sh.irradiance_weights` (N, 4) of the normals and radiance SH (R, 4, m) of the probes."""
        found = (self.weights @ coefficients.reshape(len(coefficients), -1)).reshape(-1, *coefficients.shape[1:])
        return np.asarray(np.einsum("nk,nkm->nm", normal_weights, found), dtype=np.float64)


def read(texture: VirtualTexture, texels: sparse.csr_array, positions: F64) -> Reading:
    """What samples at `positions` (N, 3) m read of the probes; texels: `texel_matrix` of the same layout. The texture's own texels are
    not looked at."""
    q = lattice_position(texture, positions)
    weight = np.asarray(texels.sum(axis=1)).ravel()
    active, ask = np.arange(len(q)), np.full(len(q), texture.level, dtype=np.int64)
    parts: list[tuple[I64, I64, F64]] = []
    while len(active):
        number, share, level = _corners(texture, q[active], ask)
        total = (share * weight[number]).sum(axis=1)
        good = total >= MIN_WEIGHT
        parts.append((np.repeat(active[good], 8), number[good].ravel(), (share[good] / total[good, None]).ravel()))
        rest = ~good & (level > 1)
        active, ask = active[rest], level[rest] - 1
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    mix = sparse.csr_array((value, (row, column)), shape=(len(q), texels.shape[0]))
    mix.eliminate_zeros()
    return Reading((mix @ texels).tocsr())


def _corners(texture: VirtualTexture, q: F64, ask: I64) -> tuple[I64, F64, I64]:
    """Numbers (N, 8) of the texels at the corners of the voxel that answers, their trilinear weights, and its level (N,)."""
    slot, level = locate(texture, q, ask)
    half = np.exp2(texture.level - level)[:, None]
    base = tile_cell(texture, q, level) * (2.0 * half)
    voxel = np.clip(np.floor((q - base) / half), 0, 1)
    f = np.clip((q - base) / half - voxel, 0.0, 1.0)
    first = (voxel @ np.array([9.0, 3.0, 1.0])).astype(np.int64)
    share = np.where(OCTANTS[None] == 1, f[:, None, :], 1.0 - f[:, None, :]).prod(axis=2)
    return slot[:, None] * TEXELS + first[:, None] + VOXEL_TEXELS, share, level
