"""Document and overrides to a validated `Scene`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import AreaLight, MeshSettings, SceneSettings
from ..datatypes import F64, Material, Mesh, Scene
from ..errors import InputError
from ..turned import rotation_matrix, turned
from .buried_lights import refuse_buried
from .digest import digest
from .document import Document, MeshArrays
from .doors import check_area_lights, check_light, check_lit_twice, check_meshes, check_surfaces, check_values
from .marks import load_layers, make_marks
from .mesh_repair import repair
from .names import clean
from .obj import obj_arrays
from .paths import resolve_inside
from .ply import read_ply
from .settings import settle
from .skies import make_sky
from .surfaces import make_material, plain_twin
from .turn import turned_settings

MAX_FACES = 64_000_000


@dataclass
class _Parts:
    """What has been built so far. loose: how many vertices of each mesh stood twice or were not used."""

    document: Document
    settings: SceneSettings
    materials: list[Material] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: dict[Path, MeshArrays] = field(default_factory=dict)
    loose: dict[str, int] = field(default_factory=dict)

    def where(self, path: str) -> str:
        return f"{self.document.source}: {path}"


def _overridden(overrides: Mapping[str, Any], material: str) -> bool:
    table = overrides.get("materials")
    entry = table.get(material) if isinstance(table, Mapping) else None
    return isinstance(entry, Mapping) and bool({"albedo", "texture"} & set(entry))


def _arrays(parts: _Parts, name: str, mesh: MeshSettings) -> MeshArrays:
    """Arrays of a mesh in metres: from its file, or from what the loader brought."""
    where = parts.where(f"meshes.{name}")
    read = parts.document.geometry.get(name)
    if mesh.file is not None:
        path = resolve_inside(parts.document.folder, mesh.file, f"{where}.file")
        reader = {".ply": read_ply, ".obj": obj_arrays}.get(path.suffix.lower())
        if reader is None:
            raise InputError(f"{where}.file: expected a .ply or .obj file, got {mesh.file!r}")
        read = parts.files.get(path) or reader(path, f"{where}.file")
        parts.files[path] = read
    if read is None:
        raise InputError(f"{where}.file: missing; name a PLY or OBJ file")
    if len(read.faces) > MAX_FACES:
        raise InputError(f"{where}: {len(read.faces)} triangles, at most {MAX_FACES} are allowed; simplify it")
    return MeshArrays(read.vertices * parts.settings.unit_m, read.faces, read.uvs)


def _material_index(parts: _Parts, name: str, mesh: MeshSettings, has_uvs: bool) -> int:
    """Index of the mesh's material; of its plain twin if pictures have no coordinates to hold on to."""
    index = list(parts.settings.materials).index(mesh.material)
    material = parts.materials[index]
    masked = material.opacity is not None and material.opacity.size > 1
    if has_uvs or not (masked or material.texture is not None or material.emission_texture is not None):
        return index
    where = parts.where(f"meshes.{name}")
    if not parts.document.own_units:
        raise InputError(
            f"{where}: material {mesh.material!r} has a texture, the mesh no texture coordinates; add them"
        )
    parts.notes.append(f"{where}: no texture coordinates, so {mesh.material!r} is its mean colour there")
    twin = plain_twin(material)
    known = [m.name for m in parts.materials]
    if twin.name not in known:
        parts.materials.append(twin)
        return len(known)
    return known.index(twin.name)


def _emission(parts: _Parts, mesh: MeshSettings, material: Material, light: AreaLight | None) -> F64:
    """(3,) radiance, or the factor of the material's emission picture; the mean of a picture that its twin lost."""
    if light is not None:
        return np.array(light.radiance, np.float64)
    factor = np.array(parts.settings.materials[mesh.material].emission, np.float64)
    picture = parts.materials[list(parts.settings.materials).index(mesh.material)].emission_texture
    if picture is None or material.emission_texture is not None:
        return factor
    return factor * picture.mean(axis=(0, 1), dtype=np.float64)


def _add_mesh(parts: _Parts, name: str, mesh: MeshSettings, light: AreaLight | None) -> None:
    arrays = _arrays(parts, name, mesh)
    index = _material_index(parts, name, mesh, arrays.uvs is not None)
    material = parts.materials[index]
    emission = _emission(parts, mesh, material, light)
    has_front = not material.two_sided or bool(emission.any())
    file = f" ({mesh.file})" if mesh.file else ""
    repaired = repair(arrays, parts.where(f"meshes.{name}{file}"), has_front)
    parts.notes += repaired.notes
    parts.loose[name] = repaired.loose
    parts.meshes.append(
        Mesh(
            name=name,
            vertices=turned(repaired.mesh.vertices, rotation_matrix(parts.settings.scene.rotation)),
            faces=repaired.mesh.faces,
            uvs=repaired.mesh.uvs,
            material=index,
            static=mesh.role == "static",
            lit_by_probes=mesh.lit_by == "probes",
            probe_size=mesh.probe_size,
            emission=emission,
            engine_lit=light is not None and light.tag == "engine",
            closed=repaired.closed,
        )
    )


def _loose_note(parts: _Parts) -> list[str]:
    loose = {name: count for name, count in parts.loose.items() if count}
    if not loose:
        return []
    return [
        f"{parts.document.source}: meshes: {sum(loose.values())} vertices were there twice or unused, and are merged or "
        f"removed; meshes with some: {len(loose)}, first {next(iter(loose))!r}"
    ]


def scene_name(path: Path) -> str:
    """Name of a scene: its folder's for files called scene.*, else the file's own."""
    resolved = path.resolve()
    return clean(resolved.parent.name if resolved.stem == "scene" else resolved.stem, "scene")


def build_scene(document: Document, overrides: Mapping[str, Any]) -> Scene:
    """The scene of a document. Raises InputError naming file and element for anything that cannot be right."""
    source = str(document.source)
    settings = turned_settings(settle(document, overrides), source)
    check_meshes(settings, source)
    check_area_lights(settings.lights, settings.meshes, source)
    check_lit_twice(settings, source)
    check_values(settings.lights, settings.materials, source)
    parts = _Parts(document, settings, notes=list(document.notes))
    for name, material in settings.materials.items():
        made, notes = make_material(name, material, document, _overridden(overrides, name))
        parts.materials.append(made)
        parts.notes += notes
    area = {light.mesh: light for light in settings.lights.values() if isinstance(light, AreaLight)}
    for mesh_name, mesh in settings.meshes.items():
        _add_mesh(parts, mesh_name, mesh, area.get(mesh_name))
    sky, notes = make_sky(settings.lights, document.folder, document.textures, source)
    check_surfaces(parts.meshes, parts.materials, source)
    check_light(settings.lights, parts.meshes, parts.materials, sky, source)
    refuse_buried(settings.lights, parts.meshes, parts.materials, source)
    marks, mark_notes = make_marks(document, settings)
    scene = Scene(
        name=scene_name(document.source),
        settings=settings,
        meshes=tuple(parts.meshes),
        materials=tuple(parts.materials),
        sky=sky,
        notes=tuple(dict.fromkeys([*parts.notes, *_loose_note(parts), *notes, *mark_notes])),
        content_hash="",
        marks=marks,
        bitmap=load_layers(document, settings, overrides),
    )
    return replace(scene, content_hash=digest(scene))
