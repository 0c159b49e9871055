"""Tile values: real probes written where they stand, virtual probes interpolated coarse to fine from the parent voxel.

A texel holds 12 SH coefficients *times* its weight, and the weight: 1 valid, 0 invalid, fractional where a virtual
probe mixes both. Only so is the interpolated quotient the same from both sides of a border (failure-catalogue D3).
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F32, I32, I64, Bool
from ..lattice import OCTANTS
from ..texture_types import WEIGHT, Storage, pre_exposure, stored_weight, weight_ratio
from .layout import TEXEL_OFFSETS, TEXELS, TileLayout


def _corner_weights(first: I64, step: int) -> F32:
    """Trilinear weights (27, 27) of a tile's texels on the texels first + step · {0, 1}³ of the tile above."""
    weights = np.zeros((TEXELS, TEXELS), dtype=np.float32)
    for t, texel in enumerate(TEXEL_OFFSETS):
        for corner in OCTANTS:
            x, y, z = first + step * corner
            weights[t, (x * 3 + y) * 3 + z] += np.prod(np.where(corner == 1, texel / 2.0, 1.0 - texel / 2.0))
    return weights


PARENT_WEIGHTS = np.stack([_corner_weights(octant, 1) for octant in OCTANTS])  # (8 octants, 27, 27)
ROOT_WEIGHTS = _corner_weights(np.zeros(3, dtype=np.int64), 2)


def probe_texels(coefficients: F32, valid: Bool) -> F32:
    """Texels (R, 13 or 28) of real probes: radiance SH (R, 4 or 9, 3) of valid ones colour by colour, and the weight after the first
    four of each."""
    n = len(coefficients)
    light = coefficients[:, :4].transpose(0, 2, 1).reshape(n, 12)
    band2 = coefficients[:, 4:].transpose(0, 2, 1).reshape(n, 3 * (coefficients.shape[1] - 4))
    mask = valid[:, None]
    return np.concatenate([np.where(mask, light, 0.0), mask, np.where(mask, band2, 0.0)], axis=1).astype(np.float32)


def with_copies(coefficients: F32, light_from: I32) -> tuple[F32, Bool]:
    """Radiance SH (R, 4, 3) that each probe uses, and whether it uses any. light_from (R,): number of the probe whose light it
    is, -1 for none (see placement/dead_edges.py)."""
    return coefficients[np.maximum(light_from, 0)], light_from >= 0


def fill_tiles(layout: TileLayout, probes: F32, storage: Storage = "float32", exposure: float | None = None) -> F32:
    """All texels (tiles, 27, C) f32 in slot order, from real probes' texels (R, C).

    In another storage than float32 each level is rounded before the next is interpolated from it, as a tile cache that is filled in
    place does it: a fine voxel's border then agrees with what its coarse neighbour *holds*.
    """
    channels = probes.shape[1]
    out = np.zeros((layout.tiles, TEXELS, channels), dtype=np.float32)
    table = np.concatenate([probes, np.zeros((1, channels), dtype=np.float32)])
    exposure = pre_exposure(probes) if exposure is None else exposure
    for i, probe in enumerate(layout.probe):
        begin, end = layout.first_slot[i], layout.first_slot[i + 1]
        real = table[probe]
        if i == 0:  # the root: its eight corners are the tile's own
            virtual = np.einsum("tp,npc->ntc", ROOT_WEIGHTS, real)
        else:
            above = out[layout.first_slot[i - 1] : begin][layout.parent_tile[i]]
            virtual = np.empty_like(real)
            for octant in range(8):
                mine = layout.octant[i] == octant
                virtual[mine] = np.einsum("tp,npc->ntc", PARENT_WEIGHTS[octant], above[mine])
        out[begin:end] = rounded(np.where((probe >= 0)[..., None], real, virtual), storage, exposure)
    return out


def stored(texels: F32, storage: Storage) -> F32:
    """What survives a storage format, as f32, of texels (..., C): see `rounded`; half floats hold light divided by `pre_exposure`."""
    return rounded(texels, storage, pre_exposure(texels))


def rounded(texels: F32, storage: Storage, exposure: float) -> F32:
    """Texels (..., C) f32 as a storage format keeps them: light as half floats after division by `exposure`, weights as `stored_weight`
    has them. Light goes with the weight that is stored, so that their quotient, the probe's own light, does not suffer from the
    weight's rounding."""
    if storage == "float32":
        return texels
    weight = stored_weight(texels[..., WEIGHT], storage)
    divided = texels * (weight_ratio(weight, texels[..., WEIGHT]) / np.float32(exposure))[..., None]
    divided[..., WEIGHT] = 0.0
    out = divided.astype(np.float16).astype(np.float32) * np.float32(exposure)
    out[..., WEIGHT] = weight
    return out
