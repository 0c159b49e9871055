"""Tile values: real probes written where they stand, virtual probes interpolated coarse to fine from the parent voxel.

A texel holds 12 SH coefficients *times* its weight, and the weight: 1 valid, 0 invalid, fractional where a virtual
probe mixes both. Only so is the interpolated quotient the same from both sides of a border (failure-catalogue D3).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..datatypes import F32, I32, I64, Bool, pre_exposure, weight_ratio
from ..lattice import OCTANTS
from .layout import TEXEL_OFFSETS, TEXELS, TileLayout

CHANNELS = 13  # 3 colours × 4 SH coefficients, then the weight
Storage = Literal["float32", "half16", "half8"]


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
    """Texels (R, 13) of real probes: radiance SH (R, 4, 3) of valid ones colour by colour, and the weight."""
    light = coefficients.transpose(0, 2, 1).reshape(-1, 12)
    return np.concatenate([np.where(valid[:, None], light, 0.0), valid[:, None]], axis=1).astype(np.float32)


def with_copies(coefficients: F32, light_from: I32) -> tuple[F32, Bool]:
    """Radiance SH (R, 4, 3) that each probe uses, and whether it uses any. light_from (R,): number of the probe whose light it
    is, -1 for none (see placement/dead_edges.py)."""
    return coefficients[np.maximum(light_from, 0)], light_from >= 0


def fill_tiles(layout: TileLayout, probes: F32) -> F32:
    """All texels (tiles, 27, 13) f32 in slot order, from real probes' texels (R, 13)."""
    out = np.zeros((layout.tiles, TEXELS, CHANNELS), dtype=np.float32)
    table = np.concatenate([probes, np.zeros((1, CHANNELS), dtype=np.float32)])
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
        out[begin:end] = np.where((probe >= 0)[..., None], real, virtual)
    return out


def stored(texels: F32, storage: Storage) -> F32:
    """What survives a storage format, as f32: `float32` all, `half16` half light and 16-bit unorm weight, `half8` half
    light and 8-bit unorm weight (the talk's 25 bytes). Half floats hold light divided by `pre_exposure`. Light goes with
    the weight that is stored, so that their quotient, the probe's own light, does not suffer from the weight's rounding."""
    if storage == "float32":
        return texels
    steps = np.float32(65535 if storage == "half16" else 255)
    exposure = np.float32(pre_exposure(texels))
    weight = (np.round(texels[..., 12:] * steps) / steps).astype(np.float32)
    light = texels[..., :12] * weight_ratio(weight, texels[..., 12:])
    light = (light / exposure).astype(np.float16).astype(np.float32) * exposure
    return np.concatenate([light, weight], axis=-1)
