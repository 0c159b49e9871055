"""scene.toml: the format of this project. Meshes name PLY or OBJ files beside it."""

from __future__ import annotations

import tomllib
from pathlib import Path

from ..errors import InputError
from .document import Document
from .paths import MAX_DOCUMENT_BYTES, read_bytes


def read_toml(path: Path) -> Document:
    """Tables of a scene.toml; its meshes and pictures are read when it is built. Raises InputError."""
    try:
        raw = tomllib.loads(read_bytes(path, str(path), MAX_DOCUMENT_BYTES).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    return Document(source=path, folder=path.parent, raw=raw, own_units=False)
