"""The door: any scene file to a `Scene`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..datatypes import Scene
from ..errors import InputError
from .build import build_scene
from .document import Document
from .gltf import read_gltf
from .mitsuba_xml import read_mitsuba_xml
from .obj_ply import read_obj_scene, read_ply_scene
from .toml import read_toml

READERS = {
    ".toml": read_toml,
    ".xml": read_mitsuba_xml,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": read_obj_scene,
    ".ply": read_ply_scene,
}


def read_document(path: Path) -> Document:
    """A scene file, read by the loader for its ending. A folder stands for the scene.toml in it. Raises InputError."""
    if path.is_dir():
        path = path / "scene.toml"
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: cannot tell the format; expected a folder or one of {', '.join(READERS)}")
    return reader(path)


def load_scene(path: Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load, override and check a scene. overrides: nested tables as in scene.toml, lengths in metres.

    Raises InputError, whose message has one line without control characters and names the file, the element and the
    way out.
    """
    try:
        return build_scene(read_document(Path(path)), overrides or {})
    except InputError as error:
        raise InputError("".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(error))) from error
    except MemoryError as error:
        raise InputError(f"{path}: does not fit into memory; simplify the scene") from error
