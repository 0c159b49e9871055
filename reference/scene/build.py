"""Document and overrides to a validated `Scene`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..config import (
    AreaLight,
    ConstantSky,
    DirectionalLight,
    ImageSky,
    MeshSettings,
    PointLight,
    SceneSettings,
    SpotLight,
)
from ..datatypes import Material, Mesh, Scene, Sky
from ..errors import InputError
from .checks import tidy
from .document import Document, MeshArrays
from .images import read_sky
from .names import clean
from .obj import obj_arrays
from .paths import resolve_inside
from .ply import read_ply
from .settings import settle
from .surfaces import make_material, plain_twin

MAX_FACES = 64_000_000


@dataclass
class _Parts:
    """What has been built so far."""

    document: Document
    settings: SceneSettings
    materials: list[Material] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: dict[Path, MeshArrays] = field(default_factory=dict)

    def where(self, path: str) -> str:
        return f"{self.document.source}: {path}"


def _check_references(settings: SceneSettings, source: str) -> None:
    """Names that point nowhere, and surfaces lit twice. Raises InputError."""
    for name, mesh in settings.meshes.items():
        if mesh.material not in settings.materials:
            known = ", ".join(list(settings.materials)[:8]) or "none"
            raise InputError(f"{source}: meshes.{name}.material: no material {mesh.material!r}; there are: {known}")
    lit: dict[str, str] = {}
    for name, light in settings.lights.items():
        if not isinstance(light, AreaLight):
            continue
        path = f"{source}: lights.{name}.mesh"
        if light.mesh not in settings.meshes:
            raise InputError(f"{path}: no mesh {light.mesh!r}; there are: {', '.join(list(settings.meshes)[:8])}")
        if light.mesh in lit:
            raise InputError(f"{path}: mesh {light.mesh!r} is lit by {lit[light.mesh]!r} already; keep one of them")
        material = settings.meshes[light.mesh].material
        if any(settings.materials[material].emission):
            raise InputError(f"{path}: material {material!r} emits too; remove its emission or this light")
        lit[light.mesh] = name


def _check_light(settings: SceneSettings, source: str) -> None:
    """Raises InputError if nothing shines."""
    values: list[Iterable[float]] = [settings.materials[m.material].emission for m in settings.meshes.values()]
    for light in settings.lights.values():
        if isinstance(light, ImageSky):
            values.append((light.scale,))
        elif isinstance(light, DirectionalLight):
            values.append(light.irradiance)
        else:
            values.append(light.intensity if isinstance(light, PointLight | SpotLight) else light.radiance)
    if not any(any(v) for v in values):
        raise InputError(
            f"{source}: lights: no light and no emission, everything is black; add a light, "
            'for example [lights.sky] type = "sky" radiance = [1, 1, 1]'
        )


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
    pictured = material.texture is not None or (material.opacity is not None and material.opacity.size > 1)
    if has_uvs or not pictured:
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


def _add_mesh(parts: _Parts, name: str, mesh: MeshSettings, area: Mapping[str, AreaLight]) -> None:
    arrays, closed, notes = tidy(_arrays(parts, name, mesh), parts.where(f"meshes.{name}"))
    parts.notes += notes
    light = area.get(name)
    emission = light.radiance if light else parts.settings.materials[mesh.material].emission
    parts.meshes.append(
        Mesh(
            name=name,
            vertices=arrays.vertices,
            faces=arrays.faces,
            uvs=arrays.uvs,
            material=_material_index(parts, name, mesh, arrays.uvs is not None),
            static=mesh.role == "static",
            lit_by_probes=mesh.lit_by == "probes",
            probe_size=mesh.probe_size,
            emission=np.array(emission, np.float64),
            engine_lit=light is not None and light.tag == "engine",
            closed=closed,
        )
    )


def _sky(parts: _Parts) -> Sky | None:
    found = {n: s for n, s in parts.settings.lights.items() if isinstance(s, ConstantSky | ImageSky)}
    if len(found) > 1:
        raise InputError(
            f"{parts.where('lights')}: only one sky is possible, got {', '.join(found)}; remove the others"
        )
    for name, light in found.items():
        engine = light.tag == "engine"
        if isinstance(light, ConstantSky):
            return Sky(np.array(light.radiance, np.float32).reshape(1, 1, 3), 0.0, engine)
        where = parts.where(f"lights.{name}.file")
        image = parts.document.textures.get(light.file)
        if image is None:
            image, notes = read_sky(resolve_inside(parts.document.folder, light.file, where), where)
            parts.notes += notes
        return Sky(image * np.float32(light.scale), light.rotation_deg, engine)
    return None


def _digest(scene: Scene) -> str:
    """SHA-256 over settings and arrays, each array with its name, type and shape in front."""
    sha = hashlib.sha256(scene.settings.model_dump_json().encode())

    def put(label: str, array: Any) -> None:
        a = np.ascontiguousarray(array)
        sha.update(f"{label} {a.dtype.str} {a.shape}".encode())
        sha.update(a.data)

    for mesh in scene.meshes:
        put(mesh.name, mesh.vertices)
        put("faces", mesh.faces)
        put(f"uvs of material {mesh.material}", np.zeros(0) if mesh.uvs is None else mesh.uvs)
        put("emission", mesh.emission)
    for m in scene.materials:
        flags = {"two": m.two_sided, "passes": m.passes_light, "truth": m.truth_bsdf}
        sha.update(json.dumps([m.name, flags], sort_keys=True).encode())
        put("albedo", m.albedo)
        put("texture", np.zeros(0) if m.texture is None else m.texture)
        put("opacity", np.zeros(0) if m.opacity is None else m.opacity)
    if scene.sky:
        put(f"sky {scene.sky.rotation_deg} {scene.sky.engine_lit}", scene.sky.image)
    return sha.hexdigest()


def scene_name(path: Path) -> str:
    """Name of a scene: its folder's for files called scene.*, else the file's own."""
    resolved = path.resolve()
    return clean(resolved.parent.name if resolved.stem == "scene" else resolved.stem, "scene")


def build_scene(document: Document, overrides: Mapping[str, Any]) -> Scene:
    """The scene of a document. Raises InputError naming file and element for anything that cannot be right."""
    settings = settle(document, overrides)
    source = str(document.source)
    if not settings.meshes:
        raise InputError(f"{source}: meshes: the scene is empty; add a mesh")
    if all(m.role == "moving" for m in settings.meshes.values()):
        raise InputError(f"{source}: meshes: all are moving, probes need static surfaces; make one static")
    _check_references(settings, source)
    _check_light(settings, source)
    parts = _Parts(document, settings, notes=list(document.notes))
    for name, material in settings.materials.items():
        made, notes = make_material(name, material, document, _overridden(overrides, name))
        parts.materials.append(made)
        parts.notes += notes
    area = {light.mesh: light for light in settings.lights.values() if isinstance(light, AreaLight)}
    for mesh_name, mesh in settings.meshes.items():
        _add_mesh(parts, mesh_name, mesh, area)
    scene = Scene(
        name=scene_name(document.source),
        settings=settings,
        meshes=tuple(parts.meshes),
        materials=tuple(parts.materials),
        sky=_sky(parts),
        notes=tuple(dict.fromkeys(parts.notes)),
        content_hash="",
    )
    return Scene(**{**vars(scene), "content_hash": _digest(scene)})
