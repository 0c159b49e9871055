"""Numbers out of the JSON of a glTF file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from .gltf_buffers import Gltf

LIMIT = 1e12


def vector(gltf: Gltf, entry: Mapping[str, Any], key: str, default: list[float], path: str) -> list[float]:
    """`entry[key]` as finite numbers, as many as in `default`. Raises InputError."""
    value = entry.get(key, default)
    good = isinstance(value, list) and len(value) == len(default)
    if not good or not all(type(x) in (int, float) and math.isfinite(x) and abs(x) < LIMIT for x in value):
        raise gltf.fail(path, f"{key}: expected {len(default)} finite numbers, got {str(value)[:60]}")
    return [float(x) for x in value]


def number(gltf: Gltf, entry: Mapping[str, Any], key: str, default: float, path: str) -> float:
    """`entry[key]` as one finite number. Raises InputError."""
    return vector(gltf, {key: [entry.get(key, default)]}, key, [default], path)[0]


def table(gltf: Gltf, entry: Mapping[str, Any], key: str, path: str) -> dict[str, Any]:
    """`entry[key]` as an object, empty if absent. Raises InputError."""
    value = entry.get(key, {})
    if not isinstance(value, dict):
        raise gltf.fail(path, f"{key}: expected an object")
    return value


def extension(gltf: Gltf, entry: Mapping[str, Any], name: str, path: str) -> dict[str, Any]:
    """An extension of an entry, empty if absent. Raises InputError."""
    return table(gltf, table(gltf, entry, "extensions", path), name, path)
