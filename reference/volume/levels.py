"""Levels of detail: each level of the octree with all coarser ones is a complete set of probes, and distance from the viewer
decides which set is sampled (talk, "Levels of detail", "Per-pixel LOD").

    lod(d) = L                    for d ≤ d₀
    lod(d) = L - k                for 2^(k-1) d₀ < d ≤ 2^k d₀, but never under 1

A voxel of each set then fills about the same part of the picture, as in a clipmap, whose levels cover twice the width each.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F32, F64, I32, I64
from ..lattice import Octree
from ..texture_types import Viewer


def lod_of_distance(distance: F32 | F64, d0: float, levels: int) -> I32:
    """Level of detail (N,) i32, 1 … `levels`, at `distance` (N,) m from the viewer; the finest up to `d0`, m.

    NaN gives 1. Raises ValueError for a negative distance, `d0` not above 0, or no level.
    """
    if not (d0 > 0.0 and levels >= 1):
        raise ValueError(f"d0 must be above 0 and levels at least 1, got {d0} and {levels}")
    away = np.asarray(distance, dtype=np.float64)
    if (away < 0.0).any():
        raise ValueError(f"distances must not be negative, got {np.nanmin(away)}")
    ends = d0 * np.exp2(np.arange(levels - 1))
    return (levels - np.searchsorted(ends, away, side="left")).astype(np.int32)


def complete_sets(tree: Octree) -> I64:
    """Probes of the complete set of each level 1 … L, (L,) i64: all that stand at a corner of a voxel of it or a coarser one.

    Its tiles read no other: a probe on the lattice of level l that some voxel has as a corner is a corner of that voxel's
    ancestor at level l too, since a voxel exists only if its parent does.
    """
    return np.cumsum(np.bincount(tree.corner_level, minlength=tree.grid.level + 1))[1:].astype(np.int64)


def ring_lod(positions: F32, viewer: Viewer, anchor: F64, levels: int) -> tuple[I32, F32]:
    """Level of detail (N,) i32 by distance from the viewer, and the share (N,) f32 of the next coarser one (0 without a blend band).

    positions (N, 3) f32: m from `anchor` (3,) f64. In single precision, and by the exponent of the squared distance, as a kernel
    does it: at a ring's very edge `lod_of_distance` may differ. NaN gives 1.
    """
    one = np.float32(1.0)
    d = positions - (viewer.position - anchor).astype(np.float32)
    inverse = np.float32(1.0 / viewer.lod_distance**2)
    square = ((d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2]) * inverse
    bits = square.view(np.int32)
    above = (bits >> 23) - 127 + ((bits & 0x7FFFFF) != 0)
    ring = np.where(above > 0, (above + 1) >> 1, 0)
    lod = np.maximum(levels - ring, 1).astype(np.int32)
    if viewer.blend == 0.0:
        return lod, np.zeros(len(lod), dtype=np.float32)
    band = np.float32(viewer.blend)
    along = np.sqrt(square) * np.exp2(-ring.astype(np.float32))
    share = np.clip((along - (one - band)) * (one / band), np.float32(0.0), one)
    return lod, np.where(lod > 1, share, np.float32(0.0)).astype(np.float32)
