"""Where the windows of a clipmap are: one per level of detail, all of the same number of texels, each covering twice the last one's
width (talk, "Indirection texture clipmap"; Pantaleev 2015, "3D clipmaps").

    e_l = 2^(L - l + 1) h                       edge of a texel of LOD l, which is that of a tile of level l
    N / 2 - 1/2 ≥ d₀ / e_L                      texels that LOD L must have on each side of its viewer, wherever in a texel he stands
    first_l = ⌊v / e_l + 1/2⌋ - N / 2           first cell of the window, v: viewer in the same units

LOD L - k serves up to 2^k d₀ and its texels are 2^k as wide: the same N does for all. For N ≥ 8 windows nest.

Windows stay at the world: a viewer outside has them where he would stand at its border. Whatever he samples is no further from
there than from him, and positions outside are sampled at the border too: what is within reach stays so, and LOD 1 always has the
root.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F64, I32, I64
from ..reference.errors import InputError
from ..reference.texture_types import FARTHEST, MAX_OFFSET

_LEAST_LOG2 = 3  # windows of fewer texels do not nest
_SLACK = 1e-4  # share of d₀; kernels decide on distance in single precision
MAX_LEVEL = 255  # an indirection texel has 8 bits for it
_LARGEST = 1 << 31  # texels of all windows: they are numbered in 32 bits
MEMORY_SHARE = 4  # windows take up to one part in so many of a device's memory


def check_bits(shape: npt.NDArray[np.integer], level: int) -> None:
    """Raises InputError for a cache with more tiles along an axis, or a world of more levels, than an indirection texel's 8 bits
    say (failure-catalogue E6)."""
    if max(shape) > MAX_OFFSET:
        raise InputError(
            f"tile budget: a tile cache of {' x '.join(str(int(n)) for n in shape)} tiles does not fit the indirection texel, whose "
            f"8 bits per axis address {MAX_OFFSET}; use at most {MAX_OFFSET}^3 tiles"
        )
    if level > MAX_LEVEL:
        raise InputError(
            f"the world has {level} levels, the 8 bits of an indirection texel say up to {MAX_LEVEL}; raise placement.min_voxel"
        )


def window_log2(lod_distance: float, finest: float, extent: I64, memory: int, level: int) -> int:
    """log2 of the texels per axis that windows must have for `lod_distance`, m (d₀), with finest voxels of `finest` m.

    A window never needs to be wider than twice a world of `extent` (3,) finest voxels. Raises InputError where the windows of `level`
    LODs take more than their share of `memory`, bytes.
    """
    if not (lod_distance > 0.0 and math.isfinite(lod_distance)):
        raise InputError(f"lod_distance must be above 0 m and finite, got {lod_distance:g}")
    wanted = lod_distance / finest * (1.0 + _SLACK) + 1.0
    whole = float(extent.max()) + 3.0  # twice the world's tiles along an axis, and the half texel on each side
    log2 = max(_LEAST_LOG2, math.ceil(math.log2(min(wanted, whole))))

    def fits(n: int) -> bool:
        return window_bytes(n, level) <= memory // MEMORY_SHARE and level << (3 * n) < _LARGEST

    if not fits(log2):
        most = max((n for n in range(_LEAST_LOG2, log2) if fits(n)), default=_LEAST_LOG2)
        metres = ((1 << most) - 1) * finest / (1.0 + _SLACK)
        raise InputError(
            f"lod_distance {lod_distance:g} m asks for clipmap windows of {1 << log2}^3 texels for {level} levels of detail, "
            f"{window_bytes(log2, level) / 2**20:.0f} MiB, more than a quarter of the device's memory or than 2^31 texels; "
            f"use at most {metres:.6g} m"
        )
    return log2


def window_bytes(log2: int, level: int) -> int:
    """Bytes of all windows: a texel and a page of 32 bits each per cell."""
    return 8 * level << (3 * log2)


def in_voxels(viewer: F64, origin: F64, finest: float) -> F64:
    """Viewer (3,) m in finest voxels from `origin` (3,). Raises ValueError unless it is three finite numbers."""
    at = np.asarray(viewer, dtype=np.float64)
    if at.shape != (3,) or not np.isfinite(at).all() or np.abs(at - origin).max() > FARTHEST * finest:
        raise ValueError(
            f"expected a viewer of three finite numbers within 2^29 finest voxels of the origin, got {viewer}"
        )
    return np.asarray((at - origin) / finest)


def tile_edges(level: int) -> F64:
    """Edge of the tiles of each level 1 … `level`, (L,) finest voxels."""
    return np.exp2(np.arange(level, 0, -1))


def first_cells(viewer: F64, extent: I64, level: int, log2: int) -> I32:
    """First cell (L, 3) i32 of each LOD's window around a viewer at `viewer` (3,) finest voxels in a world of `extent` (3,)."""
    held = np.clip(viewer, 0.0, extent.astype(np.float64))
    at = np.floor(held / tile_edges(level)[:, None] + 0.5)
    return (at - (1 << log2) // 2).astype(np.int32)
