"""Which real probes a sample reads, and how much of each: the sampler's interpolation taken apart.

    light(x) = Σ_p w_p light_p,   weight(x) = Σ_p w_p   over real probes p

Texels of virtual probes are replaced by those of their parent voxel they are interpolated from, level by level, until only
real probes are left. A probe that uses another's light (reference/placement/dead_edges.py) counts as that other; what reaches
probes without light is dropped, as their weight is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F64, I32, I64, Bool
from ...reference.lattice import OCTANTS, Octree, index_of, keys
from ...reference.texture_types import VirtualTexture
from ...reference.volume.layout import TEXELS, TileLayout
from ...reference.volume.sampler import MIN_WEIGHT, lattice_position, locate, resolve, tile_cell
from ...reference.volume.tiles import PARENT_WEIGHTS, ROOT_WEIGHTS

VOXEL_TEXELS = OCTANTS @ np.array([9, 3, 1])  # a voxel's corners from its first texel on, within a tile


def sums(number: npt.NDArray[np.integer], values: npt.NDArray[Any], count: int) -> F64:
    """(count,) sums of `values` (N,) by their `number` (N,)."""
    return np.asarray(np.bincount(number, values, count), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ProbeWeights:
    """Pairs sorted by sample: sample (M,) i64, probe (M,) i64, weight (M,) f64 > 0. level (N,) i32 that answers each
    sample, 0 where no valid probe is near."""

    sample: I64
    probe: I64
    weight: F64
    level: I32


@dataclass(frozen=True, eq=False)
class _Texels:
    """Weighted texels of one level: sample, slot and texel (K,), weight (K,)."""

    sample: I64
    slot: I64
    texel: I64
    weight: F64

    def merged(self) -> _Texels:
        """The same with the weights of equal texels added up."""
        slots = int(self.slot.max(initial=0)) + 1
        key, back = np.unique((self.sample * slots + self.slot) * TEXELS + self.texel, return_inverse=True)
        weight = sums(back, self.weight, len(key))
        return _Texels(key // TEXELS // slots, key // TEXELS % slots, key % TEXELS, weight)


def probe_weights(texture: VirtualTexture, layout: TileLayout, source: I32, positions: F64) -> ProbeWeights:
    """Weights of the real probes at `positions` (N, 3) m; source (R,): whose light each probe that filled the texture uses,
    -1 for none."""
    q = lattice_position(texture, positions)
    _, _, level = resolve(texture, q, q, texture.level)
    found: list[tuple[I64, I64, F64]] = []
    carried = _nothing()
    for depth in range(texture.level, 0, -1):
        here = _joined(carried, _corner_texels(texture, q, np.flatnonzero(level == depth), depth)).merged()
        tile = here.slot - layout.first_slot[depth - 1]
        probe = layout.probe[depth - 1][tile, here.texel].astype(np.int64)
        real = probe >= 0
        found.append((here.sample[real], probe[real], here.weight[real]))
        carried = _parents(layout, depth, here, tile, ~real)
    root = layout.probe[0][0][carried.texel].astype(np.int64)  # the root's corners are real
    sample, probe, weight = (
        np.concatenate(column) for column in zip(*found, (carried.sample, root, carried.weight), strict=True)
    )
    return _lit_pairs(sample, probe, weight, source, level)


def _lit_pairs(sample: I64, probe: I64, weight: F64, source: I32, level: I32) -> ProbeWeights:
    keep = (source[probe] >= 0) & (weight > 0.0)
    count = max(len(source), 1)
    key, back = np.unique(sample[keep] * count + source[probe[keep]], return_inverse=True)
    return ProbeWeights(key // count, key % count, sums(back, weight[keep], len(key)), level)


def voxel_weights(
    octree: Octree, texture: VirtualTexture, source: I32, positions: F64, level: int
) -> tuple[ProbeWeights, I64]:
    """What the voxels of one `level` alone would say at `positions` (N, 3) m, whatever is finer: the weights of their own eight
    corners, none and level 0 where these are too small to count; and the corners' numbers (N, 8), -1 where no probe stands."""
    q = lattice_position(texture, positions) / 2.0 ** (texture.level - level)
    cell = np.minimum(np.floor(q), np.ceil(texture.extent / 2.0 ** (texture.level - level)) - 1.0).astype(np.int64)
    f = (q - cell)[:, None, :]
    share = np.where(OCTANTS[None] == 1, f, 1.0 - f).prod(axis=2)
    at = (cell[:, None, :] + OCTANTS).reshape(-1, 3) << (texture.level - level)
    corner = index_of(keys(octree.corners), keys(at)).reshape(-1, len(OCTANTS))
    there = (corner >= 0).all(axis=1)
    lit = (share * (source[corner] >= 0)).sum(axis=1)
    answers = np.where(there & (lit >= MIN_WEIGHT), level, 0).astype(np.int32)
    chosen = np.flatnonzero(answers > 0)
    sample = np.repeat(chosen, len(OCTANTS))
    return _lit_pairs(sample, corner[chosen].ravel(), share[chosen].ravel(), source, answers), corner


def _corner_texels(texture: VirtualTexture, q: np.ndarray, chosen: I64, level: int) -> _Texels:
    """The eight texels that each of the `chosen` samples (K,) reads at `level`, as the sampler does."""
    if len(chosen) == 0:
        return _nothing()
    at, asked = q[chosen], np.full(len(chosen), level, dtype=np.int64)
    slot, found = locate(texture, at, asked)
    half = np.float32(2.0 ** (texture.level - level))
    base = tile_cell(texture, at, found).astype(np.float32) * (2 * half)
    voxel = np.clip(np.floor((at - base) / half), 0, 1)
    f = np.clip((at - base) / half - voxel, np.float32(0.0), np.float32(1.0)).astype(np.float64)
    first = (voxel @ np.array([9.0, 3.0, 1.0])).astype(np.int64)
    weight = np.where(OCTANTS[None] == 1, f[:, None, :], 1.0 - f[:, None, :]).prod(axis=2)
    texel = first[:, None] + VOXEL_TEXELS
    return _Texels(np.repeat(chosen, 8), np.repeat(slot, 8), texel.ravel(), weight.ravel())


def _parents(layout: TileLayout, depth: int, here: _Texels, tile: I64, virtual: Bool) -> _Texels:
    """What virtual texels of level `depth` are interpolated from: texels one level up; for level 1 the root's own corners."""
    sample, texel, weight, tile = here.sample[virtual], here.texel[virtual], here.weight[virtual], tile[virtual]
    if depth == 1:
        rows, slot = ROOT_WEIGHTS[texel], here.slot[virtual]
    else:
        rows = PARENT_WEIGHTS[layout.octant[depth - 1][tile], texel]
        slot = layout.first_slot[depth - 2] + layout.parent_tile[depth - 1][tile].astype(np.int64)
    at, source = np.nonzero(rows)
    return _Texels(sample[at], slot[at], source.astype(np.int64), weight[at] * rows[at, source])


def _joined(a: _Texels, b: _Texels) -> _Texels:
    return _Texels(*(np.concatenate([getattr(a, f), getattr(b, f)]) for f in ("sample", "slot", "texel", "weight")))


def _nothing() -> _Texels:
    none = np.zeros(0, dtype=np.int64)
    return _Texels(none, none, none, np.zeros(0))
