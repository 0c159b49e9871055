"""What every loader hands to `build`: the settings as plain tables, and the arrays that cannot stand in tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..datatypes import F32, F64, I32


@dataclass(frozen=True, eq=False)
class MeshArrays:
    """Triangles as read. vertices: (V, 3) f64, file units. faces: (F, 3) i32. uvs: (V, 2) f32, v up, or None."""

    vertices: F64
    faces: I32
    uvs: F32 | None = None


@dataclass(frozen=True, eq=False)
class Document:
    """A scene file, read but not yet judged.

    source: the file. folder: where every other path must lie. raw: what `SceneSettings` will validate.
    geometry: arrays of the meshes that have no `file`. textures: (H, W, 3) f32 linear, by the key that
    `materials.*.texture` names, for pictures that are not files. opacity: (H, W) f32 by material name.
    truth_bsdfs: see `Material.truth_bsdf`. passes_light: names of materials that the bake leaves out.
    own_units: cameras and lights of the file are in its own unit, so `unit_m` scales them too.
    notes: what the loader converted or ignored.
    """

    source: Path
    folder: Path
    raw: Mapping[str, Any]
    geometry: Mapping[str, MeshArrays] = field(default_factory=dict)
    textures: Mapping[str, F32] = field(default_factory=dict)
    opacity: Mapping[str, F32] = field(default_factory=dict)
    truth_bsdfs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    passes_light: frozenset[str] = frozenset()
    own_units: bool = True
    notes: tuple[str, ...] = ()
