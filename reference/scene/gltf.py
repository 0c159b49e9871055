"""glTF 2.0 and GLB: nodes, meshes, metallic-roughness materials, perspective cameras and KHR_lights_punctual.

Read here because trimesh gives neither lights nor emissive strength, and trusts the lengths in the file. Photometric
values are taken as radiometric ones, one to one (candela as W·sr⁻¹, lux as W·m⁻²): ratios are kept, and the
notes say it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..datatypes import F64, I64
from ..errors import InputError
from .defaults import HEIGHT, WIDTH, default_camera, default_lights
from .document import Document, MeshArrays
from .gltf_buffers import Gltf, accessor, open_gltf
from .gltf_materials import GltfMaterials
from .gltf_values import extension, number, table, vector
from .names import unique

# What the file may require of a reader. Compression is not among it.
KNOWN_EXTENSIONS = frozenset({
    "KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_transmission", "KHR_mesh_quantization",
    "KHR_texture_transform", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_volume",
})  # fmt: skip
MAX_NODES = 100_000
TURN_V = np.array([[1, -1], [0, 1]], np.float32)  # v ↦ 1 − v, as scale and offset
TRIANGLES, STRIP, FAN = 4, 5, 6


@dataclass
class _Reader:
    gltf: Gltf
    materials: GltfMaterials
    meshes: dict[str, Any] = field(default_factory=dict)
    lights: dict[str, Any] = field(default_factory=dict)
    cameras: dict[str, Any] = field(default_factory=dict)
    geometry: dict[str, MeshArrays] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        self.notes.append(f"{self.gltf.source}: {text}")


def local_matrix(gltf: Gltf, node: dict[str, Any], path: str) -> F64:
    """(4, 4) f64 of a node: its matrix (columns first), or translation · rotation (x, y, z, w) · scale."""
    if "matrix" in node:
        return np.array(vector(gltf, node, "matrix", np.eye(4).ravel().tolist(), path)).reshape(4, 4).T
    x, y, z, w = vector(gltf, node, "rotation", [0.0, 0.0, 0.0, 1.0], path)
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if length == 0.0:
        raise gltf.fail(path, "rotation: the quaternion is zero")
    x, y, z, w = x / length, y / length, z / length, w / length
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.eye(4)
    out[:3, :3] = turn * np.array(vector(gltf, node, "scale", [1.0, 1.0, 1.0], path))
    out[:3, 3] = vector(gltf, node, "translation", [0.0, 0.0, 0.0], path)
    return out


def triangles(indices: I64, mode: int) -> I64:
    """(T, 3) of a list, strip or fan; in strips every second triangle is turned, as the standard says."""
    if mode == TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(indices) - 2, 0))
    if mode == FAN:
        return np.stack([indices[i + 1], indices[i + 2], np.broadcast_to(indices[:1], i.shape)], axis=1)
    return np.stack([indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]], axis=1)


def _primitive(gltf: Gltf, primitive: dict[str, Any], matrix: F64, path: str) -> MeshArrays:
    attributes = table(gltf, primitive, "attributes", path)
    if "POSITION" not in attributes:
        raise gltf.fail(path, "has no POSITION; the mesh is empty")
    vertices = accessor(gltf, attributes["POSITION"], "VEC3").astype(np.float64)
    indices = np.arange(len(vertices), dtype=np.int64)
    if "indices" in primitive:
        indices = accessor(gltf, primitive["indices"], "SCALAR").ravel().astype(np.int64)
    faces = np.clip(triangles(indices, primitive.get("mode", TRIANGLES)), -1, 2**31 - 1).astype(np.int32)
    if np.linalg.det(matrix[:3, :3]) < 0.0:  # the standard turns the winding of mirrored nodes
        faces = faces[:, ::-1].copy()
    uvs = None
    if "TEXCOORD_0" in attributes:
        uvs = accessor(gltf, attributes["TEXCOORD_0"], "VEC2").astype(np.float32)
        if len(uvs) != len(vertices):
            raise gltf.fail(path, f"has {len(vertices)} positions and {len(uvs)} texture coordinates")
        uvs = uvs * TURN_V[0] + TURN_V[1]  # v runs down in glTF
    with np.errstate(invalid="ignore", over="ignore"):  # broken vertices are refused later, by mesh and number
        return MeshArrays(vertices @ matrix[:3, :3].T + matrix[:3, 3], faces, uvs)


def _add_mesh(reader: _Reader, index: Any, node_name: str, matrix: F64) -> None:
    gltf = reader.gltf
    mesh = gltf.item("meshes", index)
    primitives = mesh.get("primitives")
    if not isinstance(primitives, list) or not all(isinstance(p, dict) for p in primitives):
        raise gltf.fail(f"meshes[{index}]", "expected primitives")
    for k, primitive in enumerate(primitives):
        path = f"meshes[{index}].primitives[{k}]"
        if primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN):
            reader.note(f"{path}: points and lines ignored")
            continue
        if "KHR_draco_mesh_compression" in table(gltf, primitive, "extensions", path):
            raise gltf.fail(path, "is compressed with Draco; export without compression")
        material = primitive.get("material")
        name = unique(node_name or mesh.get("name", "mesh"), reader.meshes, "mesh")
        reader.geometry[name] = _primitive(gltf, primitive, matrix, path)
        reader.meshes[name] = {"material": reader.materials.name(material)}


def _add_light(reader: _Reader, index: Any, matrix: F64) -> None:
    gltf, path = reader.gltf, f"extensions.KHR_lights_punctual.lights[{str(index)[:20]}]"
    lights = extension(gltf, gltf.json, "KHR_lights_punctual", "extensions").get("lights")
    if not isinstance(lights, list) or type(index) is not int or not 0 <= index < len(lights):
        raise gltf.fail(path, "no such light")
    entry = lights[index]
    if not isinstance(entry, dict) or entry.get("type") not in ("point", "spot", "directional"):
        raise gltf.fail(path, "type must be point, spot or directional")
    colour = np.array(vector(gltf, entry, "color", [1.0, 1.0, 1.0], path))
    value = np.maximum(colour * number(gltf, entry, "intensity", 1.0, path), 0.0).tolist()
    position, direction = matrix[:3, 3].tolist(), (-matrix[:3, 2]).tolist()
    light: dict[str, Any] = {"type": entry["type"], "tag": "engine"}
    if entry["type"] == "directional":
        light |= {"direction": direction, "irradiance": value}
    else:
        light |= {"position": position, "intensity": value}
    if entry["type"] == "spot":
        spot = table(gltf, entry, "spot", path)
        outer = math.degrees(number(gltf, spot, "outerConeAngle", math.pi / 4, path))
        inner = math.degrees(number(gltf, spot, "innerConeAngle", 0.0, path))
        cutoff = min(max(outer, 0.1), 89.9)
        light |= {"direction": direction, "cutoff_deg": cutoff, "beam_deg": min(max(inner, 0.0), cutoff * 0.999)}
    if "range" in entry:
        reader.note(f"{path}: range ignored, light falls off with the square of the distance")
    reader.lights[unique(entry.get("name", entry["type"]), reader.lights, "light")] = light


def _add_camera(reader: _Reader, index: Any, matrix: F64) -> None:
    gltf, path = reader.gltf, f"cameras[{index}]"
    entry = gltf.item("cameras", index)
    if entry.get("type") != "perspective":
        reader.note(f"{path}: only perspective cameras are read, this one is ignored")
        return
    lens = table(gltf, entry, "perspective", path)
    aspect = min(max(number(gltf, lens, "aspectRatio", WIDTH / HEIGHT, path), 0.1), 10.0)
    yfov = number(gltf, lens, "yfov", 0.8, path)
    if not 0.0 < yfov < math.pi:
        raise gltf.fail(path, f"yfov must be between 0 and π, got {yfov}")
    origin, forward = matrix[:3, 3], -matrix[:3, 2]
    reader.cameras[unique(entry.get("name", "camera"), reader.cameras, "camera")] = {
        "origin": origin.tolist(),
        "target": (origin + forward / (np.linalg.norm(forward) or 1.0)).tolist(),
        "up": matrix[:3, 1].tolist(),
        "fov_deg": math.degrees(2 * math.atan(math.tan(yfov / 2) * aspect)),
        "width": WIDTH,
        "height": max(8, round(WIDTH / aspect)),
    }


def _roots(gltf: Gltf) -> list[Any]:
    if gltf.table("scenes"):
        return list(gltf.item("scenes", gltf.json.get("scene", 0)).get("nodes", []))
    return list(range(len(gltf.table("nodes"))))


def _walk(reader: _Reader) -> None:
    """Visit the nodes of the scene; each node may have one parent, so a circle shows as too many visits."""
    gltf = reader.gltf
    stack: list[tuple[Any, F64]] = [(index, np.eye(4)) for index in reversed(_roots(gltf))]
    visits, most = 0, min(len(gltf.table("nodes")), MAX_NODES)
    while stack:
        index, parent = stack.pop()
        node, path = gltf.item("nodes", index), f"nodes[{index}]"
        visits += 1
        if visits > most:
            raise gltf.fail(
                path, f"nodes form a circle, share children, or are over {MAX_NODES}; export the file again"
            )
        matrix = parent @ local_matrix(gltf, node, path)
        name = str(node.get("name", ""))
        if "mesh" in node:
            _add_mesh(reader, node["mesh"], name, matrix)
        if "camera" in node:
            _add_camera(reader, node["camera"], matrix)
        light = extension(gltf, node, "KHR_lights_punctual", path)
        if light:
            _add_light(reader, light.get("light"), matrix)
        children = node.get("children", [])
        if not isinstance(children, list):
            raise gltf.fail(path, "children: expected an array")
        stack += [(child, matrix) for child in reversed(children)]


def _check_required(gltf: Gltf) -> None:
    unknown = [str(e)[:60] for e in gltf.table("extensionsRequired") if e not in KNOWN_EXTENSIONS]
    if unknown:
        raise gltf.fail("extensionsRequired", f"cannot read {', '.join(unknown)}; export without it")


def read_gltf(path: Path) -> Document:
    """A glTF or GLB file. Raises InputError naming the file and the element of its tree."""
    gltf = open_gltf(path)
    _check_required(gltf)
    reader = _Reader(gltf, GltfMaterials(gltf))
    _walk(reader)
    if not reader.meshes:
        raise InputError(f"{path}: meshes: the scene is empty; export it with meshes")
    notes = [*reader.notes, *reader.materials.notes]
    emits = any(any(m.get("emission", ())) for m in reader.materials.settings.values())
    if reader.lights:
        notes.append(f"{path}: candela and lux are taken as W/sr and W/m² one to one; ratios are kept")
    elif not emits:
        reader.lights, more = default_lights()
        notes += more
    if not reader.cameras:
        reader.cameras["view"], more = default_camera(reader.geometry.values())
        notes += more
    raw = {
        "materials": reader.materials.settings,
        "meshes": reader.meshes,
        "lights": reader.lights,
        "cameras": reader.cameras,
    }
    return Document(
        source=path,
        folder=path.parent,
        raw=raw,
        geometry=reader.geometry,
        textures=reader.materials.textures,
        opacity=reader.materials.opacity,
        truth_bsdfs=reader.materials.truth,
        passes_light=frozenset(reader.materials.passes_light),
        notes=tuple(notes),
    )
