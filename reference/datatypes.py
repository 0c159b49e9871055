"""The types that pass between rooms: frozen dataclasses of NumPy arrays.

Lengths are metres, radiometric values linear RGB (last axis 3), directions unit vectors, y up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .config import SceneSettings

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]
U32 = npt.NDArray[np.uint32]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Material:
    """Surface reflectance.

    albedo: (3,) f64, diffuse, what the radiosity uses where there is no texture.
    texture: (H, W, 3) f32 linear diffuse albedo, row 0 at v = 1, or None.
    two_sided: both faces reflect; otherwise the back is black.
    passes_light: glass and the like: absent from the bake, present in the ground truth.
    truth_bsdf: plugin dictionary for the ground truth where the material is not diffuse; None means diffuse. Numbers,
      strings, nested dictionaries only; the value "@texture" stands for this material's `texture`, "@opacity" for `opacity`.
    opacity: (H, W) f32 in 0..1 for masked materials, or None.
    emission_texture: (H, W, 3) f32, linear, not negative, row 0 at v = 1, or None. Meshes of this material
      emit Mesh.emission × this, W·m⁻²·sr⁻¹; they all have `uvs`, and none is lit by an area light, so none is `engine`.
    """

    name: str
    albedo: F64
    texture: F32 | None = None
    two_sided: bool = False
    passes_light: bool = False
    truth_bsdf: Mapping[str, Any] | None = None
    opacity: F32 | None = None
    emission_texture: F32 | None = None


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one material.

    vertices: (V, 3) f64 m. faces: (F, 3) i32, counter-clockwise seen from the front, none degenerate.
    uvs: (V, 2) f32 or None. material: index into Scene.materials. probe_size: voxel size asked for, m, or None.
    emission: (3,) f64 radiance, W·m⁻²·sr⁻¹, a factor where the material has an emission_texture. engine_lit: the emission
      is a light tagged `engine`.
    closed: watertight with consistent winding, so "inside" has a meaning.
    """

    name: str
    vertices: F64
    faces: I32
    uvs: F32 | None
    material: int
    static: bool
    lit_by_probes: bool
    probe_size: float | None
    emission: F64
    engine_lit: bool
    closed: bool


@dataclass(frozen=True, eq=False)
class Sky:
    """Light from outside. image: (H, W, 3) f32 radiance, row 0 at +y, already scaled; a constant sky is 1 × 1.

    Column u = 0..1 runs as Mitsuba's `envmap` does with its default orientation, then turned by `rotation_deg` about +y.
    """

    image: F32
    rotation_deg: float
    engine_lit: bool


@dataclass(frozen=True, eq=False)
class Mark:
    """Geometry that no light meets and that marks the voxel bitmap at voxel size `probe_size`, m, or the finest.

    vertices: (V, 3) f64 m. faces: (F, 3) i32, watertight if kind is "closed", none if it is "points".
    """

    name: str
    kind: Literal["surface", "closed", "points"]
    vertices: F64
    faces: I32
    probe_size: float | None


@dataclass(frozen=True, eq=False)
class BitmapLayer:
    """One layer of a voxel bitmap file: cubes of edge `size`, m; cell (i, j, k) has its lower corner at
    `origin` + `size` · (i, j, k), m.

    origin: (3,) f64 m. cells: (N, 3) i64, in any order. mode: "add" marks the cells at their size; "place" marks them and has
    them placed even where no surface is near; "remove" unmarks what earlier layers and the scene marked in them, at their
    size and finer.
    """

    origin: F64
    size: float
    cells: I64
    mode: Literal["add", "place", "remove"] = "add"


@dataclass(frozen=True, eq=False)
class Scene:
    """A validated scene. `settings` holds punctual lights, volumes, cameras and the controls of every stage.

    notes: what the loader converted or ignored, one sentence each. content_hash: SHA-256 over all that the result
    depends on (arrays and settings). marks: geometry that only marks the voxel bitmap. bitmap: layers of the file that
    `placement.bitmap` names, first to last.
    """

    name: str
    settings: SceneSettings
    meshes: tuple[Mesh, ...]
    materials: tuple[Material, ...]
    sky: Sky | None
    notes: tuple[str, ...]
    content_hash: str
    marks: tuple[Mark, ...] = ()
    bitmap: tuple[BitmapLayer, ...] = ()


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


Storage = Literal["float32", "half", "half16", "half8"]
WEIGHT = 12  # the channel of a texel that holds its weight


def pre_exposure(texels: F32) -> float:
    """`exposure_of` the brightest light in texels (..., 13 or 28)."""
    parts = (texels[..., :WEIGHT], texels[..., WEIGHT + 1 :])
    return exposure_of(max(max(float(p.max(initial=0.0)), -float(p.min(initial=0.0))) for p in parts))


def exposure_of(brightest: float) -> float:
    """Power of two by which light is divided before it is stored as half floats, from its largest absolute value: that then
    lies in 16,384 … 32,768, where nothing overflows and eight decades below keep their precision."""
    return 2.0 ** (math.ceil(math.log2(brightest)) - 15) if brightest > 0.0 else 1.0


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
