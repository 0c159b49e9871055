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
from ...reference.volume.layout import TileLayout
from ...reference.volume.sampler import MIN_WEIGHT, lattice_position, locate, resolve, tile_cell
from ...reference.volume.tiles import PARENT_WEIGHTS, ROOT_WEIGHTS

VOXEL_TEXELS = OCTANTS @ np.array([9, 3, 1])  # a voxel's corners from its first texel on, within a tile
FIRST_TEXEL = VOXEL_TEXELS  # of a tile's eight voxels: texel (1, 1, 1) is the first of the last one
# Shares of the eight texels of a tile's voxel on the eight corners of the voxel above, by octant of that one in its own tile, and of
# the voxel in the tile: (8, 8, 8, 8); for tiles of level 1 on the root's corners, by octant: (8, 8, 8).
_READ = FIRST_TEXEL[:, None] + VOXEL_TEXELS
_SHARES = np.stack([above[_READ][..., corners] for above, corners in zip(PARENT_WEIGHTS, _READ, strict=True)])
_ROOT_SHARES = ROOT_WEIGHTS[_READ][..., 2 * VOXEL_TEXELS]


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
class _Voxels:
    """What samples read of one level: each the eight texels of one voxel. sample (K,), ascending; slot (K,) of the tile; octant (K,)
    of the voxel in it; weight (K, 8) of the texels."""

    sample: I64
    slot: I64
    octant: I64
    weight: F64


def probe_weights(
    texture: VirtualTexture, layout: TileLayout, source: I32, positions: F64, lod: int | None = None
) -> ProbeWeights:
    """Weights of the real probes at `positions` (N, 3) m; source (R,): whose light each probe that filled the texture uses,
    -1 for none. lod: finest level to use, all without it."""
    q = lattice_position(texture, positions)
    _, _, level = resolve(texture, q, q, texture.level if lod is None else lod)
    found: list[tuple[I64, I64, F64]] = []
    carried = _nothing()
    for depth in range(texture.level, 0, -1):
        here = _joined(carried, _read(texture, q, np.flatnonzero(level == depth), depth))
        tile = here.slot - layout.first_slot[depth - 1]
        probe = layout.probe[depth - 1][tile[:, None], FIRST_TEXEL[here.octant][:, None] + VOXEL_TEXELS].astype(
            np.int64
        )
        found.append(_flat(here.sample, probe, here.weight))
        carried = _parents(layout, depth, here, tile, probe < 0)
    root = layout.probe[0][0][2 * VOXEL_TEXELS].astype(np.int64)  # the root's corners are real
    found.append(_flat(carried.sample, np.broadcast_to(root, carried.weight.shape), carried.weight))
    sample, probe, weight = (np.concatenate(column) for column in zip(*found, strict=True))
    return _lit_pairs(sample, probe, weight, source, level)


def _flat(sample: I64, probe: I64, weight: F64) -> tuple[I64, I64, F64]:
    """Sample, probe and weight (M,) of the real ones of probes (K, 8), with any weight (K, 8), of samples (K,)."""
    row, corner = np.nonzero((probe >= 0) & (weight > 0.0))
    return sample[row], probe[row, corner], weight[row, corner]


def _lit_pairs(sample: I64, probe: I64, weight: F64, source: I32, level: I32) -> ProbeWeights:
    """Pairs with light, weights (M,) > 0 of equal ones added up in the order given."""
    mine = source[probe]
    keep = np.flatnonzero(mine >= 0)
    count = max(len(source), 1)
    key = sample[keep] * count + mine[keep]
    order = np.argsort(key, kind="stable")  # a voxel's corners ascend as their probes do: long runs, which it merges
    key, first = key[order], np.ones(len(key), dtype=np.bool_)
    np.not_equal(key[1:], key[:-1], out=first[1:])
    total = sums(np.cumsum(first) - 1, weight[keep][order], int(first.sum()))
    return ProbeWeights(key[first] // count, key[first] % count, total, level)


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
    return _lit_pairs(*_flat(chosen, corner[chosen], share[chosen]), source, answers), corner


def _read(texture: VirtualTexture, q: np.ndarray, chosen: I64, level: int) -> _Voxels:
    """The eight texels that each of the `chosen` samples (K,) reads at `level`, as the sampler does."""
    if len(chosen) == 0:
        return _nothing()
    at, asked = q[chosen], np.full(len(chosen), level, dtype=np.int64)
    slot, found = locate(texture, at, asked)
    half = np.float32(2.0 ** (texture.level - level))
    base = tile_cell(texture, at, found).astype(np.float32) * (2 * half)
    voxel = np.clip(np.floor((at - base) / half), 0, 1)
    f = np.clip((at - base) / half - voxel, np.float32(0.0), np.float32(1.0)).astype(np.float64)
    weight = np.where(OCTANTS[None] == 1, f[:, None, :], 1.0 - f[:, None, :]).prod(axis=2)
    return _Voxels(chosen, slot, (voxel @ np.array([4.0, 2.0, 1.0])).astype(np.int64), weight)


def _parents(layout: TileLayout, depth: int, here: _Voxels, tile: I64, virtual: Bool) -> _Voxels:
    """What `virtual` texels (K, 8) of level `depth` are interpolated from: the voxel one level up that the tile covers; for level 1
    the root's own corners."""
    chosen = np.flatnonzero(virtual.any(axis=1))
    own, tile = here.octant[chosen], tile[chosen]
    if depth == 1:
        slot, octant, shares = here.slot[chosen], np.zeros_like(own), _ROOT_SHARES[own]
    else:
        octant = layout.octant[depth - 1][tile].astype(np.int64)
        slot = layout.first_slot[depth - 2] + layout.parent_tile[depth - 1][tile].astype(np.int64)
        shares = _SHARES[octant, own]
    given, weight = here.weight[chosen] * virtual[chosen], np.zeros((len(chosen), len(OCTANTS)))
    for corner in range(len(OCTANTS)):  # one after the other: the sum is then the same whoever else is asked
        weight += given[:, corner, None] * shares[:, corner]
    return _Voxels(here.sample[chosen], slot, octant, weight)


def _joined(a: _Voxels, b: _Voxels) -> _Voxels:
    """Both, by sample; none is in both."""
    if len(a.sample) == 0 or len(b.sample) == 0:
        return a if len(a.sample) else b
    order = np.argsort(np.concatenate([a.sample, b.sample]), kind="stable")
    return _Voxels(
        *(np.concatenate([getattr(a, f), getattr(b, f)])[order] for f in ("sample", "slot", "octant", "weight"))
    )


def _nothing() -> _Voxels:
    none = np.zeros(0, dtype=np.int64)
    return _Voxels(none, none, none, np.zeros((0, len(OCTANTS))))
