"""Small scene files for the tests of the loaders: each writer returns the path of the scene in `folder`."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image

SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
TOML = """
[materials.grey]
albedo = [0.5, 0.4, 0.3]
[meshes.wall]
file = "wall.ply"
material = "grey"
[lights.sky]
type = "sky"
radiance = [1, 1, 1]
[lights.sun]
type = "directional"
direction = [0, -1, 0]
irradiance = [2, 2, 2]
"""


def ply_text(vertices: list[Any], faces: list[Any], uvs: bool = False) -> str:
    """ASCII PLY; vertices may be longer than three where they carry more columns."""
    columns = ["x", "y", "z", "u", "v"][: 5 if uvs else 3]
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {c}" for c in columns)]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(str(x) for x in v) for v in vertices]
    return "\n".join([*head, *rows, *(" ".join(str(x) for x in (len(f), *f)) for f in faces)]) + "\n"


def ply_of(vertices: Any, faces: Any) -> str:
    """ASCII PLY of arrays, every digit kept."""
    text = ply_text([[repr(float(x)) for x in v] for v in vertices], [[int(i) for i in f] for f in faces])
    return text.replace("property float", "property double")


def write_toml(folder: Path, text: str = TOML, ply: str | None = None) -> Path:
    (folder / "wall.ply").write_text(ply if ply is not None else ply_text(SQUARE, [(0, 1, 2, 3)]))
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


def write_xml(folder: Path, body: str, version: str = "3.0.0") -> Path:
    """body stands inside <scene>; a constant sky and a rectangle are there already."""
    text = f'<scene version="{version}"><emitter type="constant"/><shape type="rectangle" id="floor"/>{body}</scene>'
    (folder / "scene.xml").write_text(text)
    return folder / "scene.xml"


def write_picture(path: Path, rgba: Any) -> None:
    """8-bit PNG of an (H, W, 3 or 4) array."""
    Image.fromarray(np.asarray(rgba, np.uint8)).save(path)


def write_exr(path: Path, image: Any) -> None:
    """OpenEXR of an (H, W, 3) array, single precision."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.asarray(image, np.float32)}) as file:
        file.write(str(path))


def gltf_tree(**changes: Any) -> tuple[dict[str, Any], bytes]:
    """A textured square with every extension we read, as JSON tree and binary part."""
    picture = io.BytesIO()
    Image.fromarray(np.full((2, 2, 4), 128, np.uint8)).save(picture, "PNG")
    parts = [
        np.array(SQUARE, "<f4").tobytes(),
        np.array(SQUARE, "<f4")[:, :2].tobytes(),
        np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes(),
        picture.getvalue(),
    ]
    views, blob = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(part)})
        blob += part + b"\0" * (-len(part) % 4)
    lights = [{"type": "spot", "name": "lamp", "intensity": 50, "color": [1, 0.5, 0], "spot": {"outerConeAngle": 0.5}}]
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [
            {"mesh": 0, "name": "square", "translation": [0, 0, 5], "scale": [2, 2, 2]},
            {"camera": 0, "translation": [0, 0, 9]},
            {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 3, 0]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
        "cameras": [{"type": "perspective", "name": "eye", "perspective": {"yfov": 1.0, "aspectRatio": 2.0}}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [
            {
                "name": "paint",
                "doubleSided": True,
                "emissiveFactor": [1, 0, 0],
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "baseColorFactor": [1, 0.5, 1, 1],
                    "metallicFactor": 0.5,
                    "roughnessFactor": 0.3,
                },
            }
        ],
        "extensions": {"KHR_lights_punctual": {"lights": lights}},
    }
    return tree | changes, blob


def write_glb(folder: Path, tree: Mapping[str, Any], blob: bytes) -> Path:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<2I", len(text), 0x4E4F534A) + text + struct.pack("<2I", len(blob), 0x004E4942) + blob
    path = folder / "scene.glb"
    path.write_bytes(struct.pack("<3I", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path
