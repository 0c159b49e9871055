"""The types that pass between rooms: frozen dataclasses of NumPy arrays.

Lengths are metres, radiometric values linear RGB (last axis 3), directions unit vectors, y up.
"""

from __future__ import annotations

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
