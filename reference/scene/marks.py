"""What marks the voxel bitmap without being lit: the geometry of `marks`, and the file that `placement.bitmap` names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..bitmap_file import read_bitmap
from ..config import SceneSettings
from ..config_placement import MarkSettings
from ..datatypes import F64, BitmapLayer, Mark
from ..errors import InputError
from ..turned import rotation_matrix, turned
from .checks import refuse_vertices
from .document import Document, MeshArrays
from .mesh_repair import repair
from .obj import obj_arrays, read_obj_points
from .paths import resolve_inside
from .ply import read_ply, read_ply_points

MESH_READERS = {".ply": read_ply, ".obj": obj_arrays}
POINT_READERS = {".ply": read_ply_points, ".obj": read_obj_points}


def make_marks(document: Document, settings: SceneSettings) -> tuple[tuple[Mark, ...], list[str]]:
    """All marks of a scene in metres, turned as the scene is, and what was mended.

    Raises InputError naming the mark and its file: not a PLY or OBJ inside the scene's folder, broken, or "closed" but open.
    """
    matrix = rotation_matrix(settings.scene.rotation)
    marks, notes = [], list[str]()
    for name, mark in settings.marks.items():
        where = f"{document.source}: marks.{name}"
        arrays, found = _arrays(document.folder, mark, settings.unit_m, where)
        marks.append(Mark(name, mark.kind, turned(arrays.vertices, matrix), arrays.faces, mark.probe_size))
        notes += found
    return tuple(marks), notes


def _arrays(folder: Path, mark: MarkSettings, unit_m: float, where: str) -> tuple[MeshArrays, tuple[str, ...]]:
    """Vertices in metres and mended faces, none for points; notes."""
    path = resolve_inside(folder, mark.file, f"{where}.file")
    suffix = path.suffix.lower()
    if suffix not in MESH_READERS:
        raise InputError(f"{where}.file: expected a .ply or .obj file, got {mark.file!r}")
    if mark.kind == "points":
        points: F64 = POINT_READERS[suffix](path, f"{where}.file") * unit_m
        refuse_vertices(points, f"{where} ({mark.file})")
        return MeshArrays(points, np.zeros((0, 3), np.int32)), ()
    read = MESH_READERS[suffix](path, f"{where}.file")
    mended = repair(
        MeshArrays(read.vertices * unit_m, read.faces), f"{where} ({mark.file})", has_front=mark.kind == "closed"
    )
    if mark.kind == "closed" and not mended.closed:
        raise InputError(
            f'{where} ({mark.file}): kind = "closed" needs a watertight mesh and this one has open edges; close it, or mark its '
            'surface only with kind = "surface"'
        )
    return mended.mesh, mended.notes


def load_layers(document: Document, settings: SceneSettings, overrides: Mapping[str, Any]) -> tuple[BitmapLayer, ...]:
    """Layers of `placement.bitmap`: a file inside the scene's folder, or where the command line gave it, any file, its path as
    typed. Without a name, or with an empty one, there are none. Raises InputError."""
    name = settings.placement.bitmap
    if not name:
        return ()
    where = f"{document.source}: placement.bitmap"
    given = overrides.get("placement")
    if isinstance(given, Mapping) and "bitmap" in given:
        return read_bitmap(Path(name).expanduser(), "placement.bitmap")
    return read_bitmap(resolve_inside(document.folder, name, where), where)
