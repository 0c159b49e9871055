"""The types of the virtual texture, and the small laws that whoever stores or reads it must share: storage formats, anchors, levels.

Lengths are metres; arrays are NumPy's, with shapes as said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from .datatypes import F32, F64, I32, I64, U8, U32


@dataclass(frozen=True, eq=False)
class Indirection:
    """texels (N,) u32: LODs 1 … L one after the other, each in x-slowest order; first (L + 1,) i64; dims (L, 3) i64:
    size of each LOD, cut to the scene's extent. cache (3,) i64: tiles per axis of the tile cache."""

    texels: U32
    first: I64
    dims: I64
    cache: I64


@dataclass(frozen=True, eq=False)
class VirtualTexture:
    """A tile cache and its indirection: all that a sampler reads.

    origin (3,) f64 m and finest, m: corner and size of the finest voxel; level L; extent (3,) i64 finest voxels.
    texels (tiles, 27, 13) f32 in slot order, x slowest within a tile: 4 SH coefficients of red, of green, of blue,
    multiplied by the weight, and the weight; (tiles, 27, 28) where light is of order 2: then its 5 more of each colour.
    offset_voxel, m: the voxel that `sampling.normal_offset` counts in where it is not the finest (`Grid.wanted`).
    """

    origin: F64
    finest: float
    level: int
    extent: I64
    indirection: Indirection
    texels: F32
    offset_voxel: float | None = None


VIRTUAL, INVALID = -1, -2
MAX_OFFSET = 256  # tiles per axis that 8 bits of an indirection texel address


@dataclass(frozen=True, eq=False)
class TileTable:
    """All tiles of a world, T of them, the coarsest level first: what a tile cache streams.

    origin (3,) f64 m, finest, m, level L and extent (3,) i64 as in `VirtualTexture`. tile_level (T,) i32, 1 … L; cell (T, 3) i32: in
    tiles of its level (edge 2^(L - level + 1) finest voxels). parent (T,) i32: the tile of the level above that holds it, -1 for the
    root; octant (T,) i32: which of the parent's voxels it covers, 4 x + 2 y + z; children (T, 8) i32 by octant, -1 where there is none.
    sources (T, 27) i32: the probe whose light a texel takes, VIRTUAL where it is interpolated from the parent tile, INVALID where no
    light is known (weight 0). probes: how many numbers `sources` may name.
    """

    origin: F64
    finest: float
    level: int
    extent: I64
    tile_level: I32
    cell: I32
    parent: I32
    octant: I32
    children: I32
    sources: I32
    probes: int

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return len(self.parent)

    def used(self) -> I32:
        """Probes that some texel takes its light from, ascending."""
        named = np.zeros(self.probes, dtype=bool)
        named[self.sources[self.sources >= 0]] = True
        return np.flatnonzero(named).astype(np.int32)


Storage = Literal["float32", "half", "half16", "half8"]
WEIGHT = 12  # the channel of a texel that holds its weight


def pre_exposure(texels: F32) -> float:
    """`exposure_of` the brightest light in texels (..., 13 or 28)."""
    parts = (texels[..., :WEIGHT], texels[..., WEIGHT + 1 :])
    return exposure_of(max(max(float(p.max(initial=0.0)), -float(p.min(initial=0.0))) for p in parts))


def exposure_of(brightest: float) -> float:
    """Power of two by which light is divided before it is stored as half floats, from its largest absolute value: that then
    lies in 16,384 … 32,768, where nothing overflows and eight decades below keep their precision."""
    return 2.0 ** max(math.ceil(math.log2(brightest)) - 15, -126) if brightest > 0.0 else 1.0


def cache_shape(tiles: int) -> I64:
    """Tiles per axis (3,) of a cache for `tiles` tiles, each within the texel's bit budget: as near to a cube as can be.

    Raises ValueError for none, and above 256³ (failure-catalogue E6).
    """
    if not 1 <= tiles <= MAX_OFFSET**3:
        raise ValueError(f"a tile cache holds 1 … {MAX_OFFSET**3} tiles, got {tiles}")
    edge = min(MAX_OFFSET, max(1, math.ceil(tiles ** (1.0 / 3.0) - 1e-9)))
    z = -(-tiles // (edge * edge))
    return np.array([edge, edge, z], dtype=np.int64)


def stored_weight(weight: F32, storage: Storage) -> F32:
    """What a storage format keeps of weights 0 … 1: `half` the nearest half float, `half16` and `half8` the nearest of 65,536 or 256
    equal steps."""
    if storage == "float32":
        return weight.astype(np.float32)
    if storage == "half":
        return weight.astype(np.float16).astype(np.float32)
    steps = np.float32(65535 if storage == "half16" else 255)
    return (np.round(weight * steps) / steps).astype(np.float32)


def weight_ratio(stored: F32, exact: F32) -> F32:
    """What light is to be multiplied by where a weight is stored rounded: stored / exact, 1 where the weight is 0."""
    positive = exact > 0.0
    return np.where(positive, stored / np.where(positive, exact, np.float32(1.0)), np.float32(1.0)).astype(np.float32)


FARTHEST = 2.0**29  # finest voxels from the anchor: beyond it positions are held, as 32 bits would not count them


def anchor_cell(origin: F64, finest: float, anchor: F64) -> tuple[I64, F32]:
    """Finest voxel (3,) i64 that holds `anchor` (3,) m, and where in it (3,) f32, 0 … 1.

    Raises ValueError for an anchor that is not three finite numbers, or is too far for 32-bit cells.
    """
    at = np.asarray(anchor, dtype=np.float64)
    if at.shape != (3,) or not np.isfinite(at).all() or np.abs(at - origin).max() > FARTHEST * finest:
        raise ValueError(
            f"the anchor must be three finite numbers within 2^29 finest voxels of the origin, got {anchor}"
        )
    voxels = (at - origin) / finest
    cell = np.floor(voxels)
    return cell.astype(np.int64), (voxels - cell).astype(np.float32)


def check_lod(lod: int | I32 | None, levels: int, samples: int) -> None:
    """Raises ValueError unless `lod` is None, or within 1 … `levels`: one number, or one for each of `samples`."""
    if lod is None:
        return
    asked = np.asarray(lod)
    if asked.shape not in ((), (samples,)) or asked.dtype.kind not in "iu":
        raise ValueError(f"lod must be a whole number or ({samples},) of them, got {asked.dtype} {asked.shape}")
    if asked.size and (asked.min() < 1 or asked.max() > levels):
        outside = asked.min() if asked.min() < 1 else asked.max()
        raise ValueError(f"lod must be 1 … {levels}, got {outside}")


@dataclass(frozen=True, eq=False)
class Viewer:
    """Who looks, for levels of detail by distance: position (3,) f64 m; lod_distance, m: the finest level serves up to there, the
    next up to twice as far, and so on; blend, 0 … 1: in the last part of each ring, this share of it, the next coarser level is
    mixed in."""

    position: F64
    lod_distance: float
    blend: float = 0.0

    def __post_init__(self) -> None:
        """Raises ValueError for a distance not above 0, a blend outside 0 … 1, or a position that is not three finite numbers."""
        if not (self.lod_distance > 0.0 and 0.0 <= self.blend <= 1.0):
            raise ValueError(f"lod_distance must be above 0 and blend 0 … 1, got {self.lod_distance} and {self.blend}")
        if np.shape(self.position) != (3,) or not np.isfinite(self.position).all():
            raise ValueError(f"expected a position of three finite numbers, got {self.position}")


@dataclass(frozen=True, eq=False)
class Samples:
    """irradiance (N, 3) f32 W·m⁻²; level (N,) i32 that answered, 0 where no valid probe was near (irradiance 0);
    weight (N,) f32."""

    irradiance: F32
    level: I32
    weight: F32


@dataclass(frozen=True, eq=False)
class DistanceMaps:
    """How far probes see, for a texture of T tiles. moments (M, S, S, 2) f16: mean and mean squared distance by direction,
    octahedral maps with a border, in voxels of the level that a map serves; number (T, 27) i32: the map of each texel."""

    moments: npt.NDArray[np.float16]
    number: I32

    @property
    def bytes(self) -> int:
        """Size of the maps and of the numbers that find them."""
        return self.moments.nbytes + self.number.nbytes


@dataclass(frozen=True, eq=False)
class RatioTexels:
    """Light as L0 and the ratios of L1 to it, 16 bytes a texel. base (T · 27, 3) f16: L0 × weight / exposure; ratio (T · 27, 3, 3)
    u8: by colour, times the weight, 1 … 255 for -√3 … √3; weight (T · 27,) u8."""

    base: npt.NDArray[np.float16]
    ratio: U8
    weight: U8
    exposure: float

    @property
    def bytes(self) -> int:
        """Size of the texels."""
        return self.base.nbytes + self.ratio.nbytes + self.weight.nbytes
