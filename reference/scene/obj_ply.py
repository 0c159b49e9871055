"""Files that are only a mesh: OBJ with its MTL library, and PLY. Light and camera are added, and that is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .defaults import default_camera, default_lights
from .document import Document, MeshArrays
from .mtl import MtlMaterial, read_mtl
from .names import clean, unique
from .obj import ObjFile, read_obj
from .paths import resolve_inside
from .ply import read_ply
from .surfaces import clamp_albedo

GREY = [0.5, 0.5, 0.5]
TWO_SIDED_NOTE = "the format does not say which side of a face is the front: all materials reflect on both"


def _with_defaults(path: Path, raw: dict[str, Any], geometry: dict[str, MeshArrays], **more: Any) -> Document:
    lights, light_notes = default_lights()
    camera, camera_notes = default_camera(geometry.values())
    raw |= {"lights": lights, "cameras": {"view": camera}}
    notes = (*more.pop("notes", ()), *light_notes, *camera_notes)
    return Document(source=path, folder=path.parent, raw=raw, geometry=geometry, notes=notes, **more)


def read_ply_scene(path: Path) -> Document:
    """A PLY alone: one mesh, grey on both sides. Raises InputError."""
    name = clean(path.stem, "mesh")
    raw: dict[str, Any] = {
        "materials": {"grey": {"albedo": GREY, "two_sided": True}},
        "meshes": {name: {"material": "grey"}},
    }
    notes = ("the file brings no material: albedo 0.5 on both sides",)
    return _with_defaults(path, raw, {name: read_ply(path, str(path))}, notes=notes)


def _libraries(path: Path, read: ObjFile) -> dict[str, MtlMaterial]:
    found: dict[str, MtlMaterial] = {}
    for line in read.libraries:
        # One file name with spaces and several names are both in use; the file that exists decides.
        whole = (path.parent / line).exists() or len(line.split()) < 2
        for name in [line] if whole else line.split():
            where = f"{path}: mtllib"
            found |= read_mtl(resolve_inside(path.parent, name, where), where)
    return found


def _settings(mtl: MtlMaterial, where: str) -> tuple[dict[str, Any], list[str]]:
    albedo, notes = clamp_albedo(GREY if mtl.kd is None else mtl.kd, f"{where}.Kd")
    settings: dict[str, Any] = {"albedo": albedo, "emission": mtl.emission, "two_sided": True}
    pictures = {"texture": mtl.texture, "emission_texture": mtl.glow}
    settings |= {key: file for key, file in pictures.items() if file is not None}
    if mtl.masked:
        notes.append(f"{where}: map_d ignored, the surface counts as opaque")
    return settings, notes


def _split(read: ObjFile, material: int) -> MeshArrays:
    faces = read.faces[read.materials == material]
    used, inverse = np.unique(faces, return_inverse=True)
    uvs = None if read.uvs is None else read.uvs[used]
    return MeshArrays(read.vertices[used], inverse.reshape(-1, 3).astype(np.int32), uvs)


def read_obj_scene(path: Path) -> Document:
    """An OBJ with its library: one mesh a material, of the material's name. Raises InputError."""
    read = read_obj(path, str(path))
    library = _libraries(path, read)
    notes = [TWO_SIDED_NOTE]
    if not library:
        notes.append("the file names no material library: albedo 0.5 everywhere")
    materials: dict[str, Any] = {}
    meshes: dict[str, Any] = {}
    geometry: dict[str, MeshArrays] = {}
    truth: dict[str, Any] = {}
    for index, original in enumerate(read.names):
        if not np.any(read.materials == index):
            continue
        if library and original and original not in library:
            raise InputError(
                f"{path}: usemtl {original[:80]!r}: no such material in {', '.join(read.libraries)}; add it"
            )
        mtl = library.get(original, MtlMaterial())
        name = unique(original, materials, "grey")
        materials[name], more = _settings(mtl, f"{path}: material {name}")
        notes += more
        if mtl.opacity < 0.5:
            truth[name] = {"type": "thindielectric"}
            notes.append(
                f"{path}: material {name}: transparent, so the bake leaves it out and the truth sees thin glass"
            )
        meshes[name] = {"material": name}
        geometry[name] = _split(read, index)
    raw = {"materials": materials, "meshes": meshes}
    return _with_defaults(path, raw, geometry, notes=tuple(notes), truth_bsdfs=truth, passes_light=frozenset(truth))
