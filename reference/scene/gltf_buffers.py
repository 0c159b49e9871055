"""glTF 2.0 containers and accessors: JSON and binary data to arrays, every length checked before it is believed."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ..errors import InputError
from .paths import MAX_FILE_BYTES, read_bytes, resolve_inside

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MAX_COUNT = 200_000_000
GLB_MAGIC, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


@dataclass
class Gltf:
    """A parsed file. json: its tree. binary: the BIN chunk of a GLB. buffers: content by index, as far as read."""

    source: Path
    json: dict[str, Any]
    binary: bytes
    buffers: dict[int, bytes]

    def fail(self, path: str, text: str) -> InputError:
        """The error to raise about the element at `path` of the tree."""
        return InputError(f"{self.source}: {path}: {text}")

    def item(self, table: str, index: Any) -> dict[str, Any]:
        """Entry of a top-level array. Raises InputError if there is none."""
        entries = self.json.get(table)
        path = f"{table}[{str(index)[:20]}]"
        if not isinstance(entries, list) or type(index) is not int or not 0 <= index < len(entries):
            raise self.fail(path, "no such entry; export the file again")
        if not isinstance(entries[index], dict):
            raise self.fail(path, "expected an object; export the file again")
        return dict(entries[index])

    def table(self, table: str) -> list[Any]:
        """A top-level array, empty if it is absent."""
        entries = self.json.get(table, [])
        if not isinstance(entries, list):
            raise self.fail(table, "expected an array")
        return entries


def _chunks(data: bytes, path: Path) -> tuple[bytes, bytes]:
    """JSON and BIN chunk of a GLB."""
    magic, version, length = struct.unpack_from("<3I", data) if len(data) >= 12 else (0, 0, 0)
    if magic != GLB_MAGIC or version != 2:
        raise InputError(f"{path}: not a GLB of version 2; export it again as glTF 2.0")
    if length != len(data):
        raise InputError(f"{path}: the GLB header promises {length} bytes, the file has {len(data)}; export it again")
    at, found = 12, dict[int, bytes]()
    while at + 8 <= length:
        size, kind = struct.unpack_from("<2I", data, at)
        if at + 8 + size > length:
            raise InputError(f"{path}: a GLB chunk promises {size} bytes, {length - at - 8} are left; export it again")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON_CHUNK not in found:
        raise InputError(f"{path}: the GLB has no JSON chunk; export it again")
    return found[JSON_CHUNK], found.get(BIN_CHUNK, b"")


def open_gltf(path: Path) -> Gltf:
    """Read a .glb or .gltf file. Raises InputError if it is not one."""
    data = read_bytes(path, str(path))
    text, binary = _chunks(data, path) if data[:4] == b"glTF" or path.suffix.lower() == ".glb" else (data, b"")
    try:
        tree = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its JSON cannot be read: {error}; export it again") from error
    if not isinstance(tree, dict) or not str(tree.get("asset", {}).get("version", "")).startswith("2"):
        raise InputError(f"{path}: asset.version: expected glTF 2.x; export it again as glTF 2.0")
    return Gltf(path, tree, binary, {})


def from_uri(gltf: Gltf, uri: Any, path: str) -> bytes:
    """Content of a data: URI, or of a file under the scene's folder. Raises InputError."""
    if not isinstance(uri, str):
        raise gltf.fail(path, "expected a uri")
    if uri.startswith("data:"):
        head, _, body = uri.partition(",")
        if not head.endswith(";base64"):
            raise gltf.fail(path, "expected a base64 data: uri")
        try:
            return base64.b64decode(body, validate=True)
        except (binascii.Error, ValueError) as error:
            raise gltf.fail(path, f"broken data: uri: {error}") from error
    return read_bytes(
        resolve_inside(gltf.source.parent, unquote(uri), f"{gltf.source}: {path}"), f"{gltf.source}: {path}"
    )


def _whole(gltf: Gltf, entry: dict[str, Any], key: str, path: str, default: int | None = 0) -> int:
    value = entry.get(key, default)
    if type(value) is not int or not 0 <= value <= MAX_FILE_BYTES:
        raise gltf.fail(path, f"{key}: expected a whole number from 0 to {MAX_FILE_BYTES}, got {str(value)[:40]}")
    return value


def _buffer(gltf: Gltf, index: Any) -> bytes:
    entry, path = gltf.item("buffers", index), f"buffers[{index}]"
    if index not in gltf.buffers:
        if "uri" in entry:
            gltf.buffers[index] = from_uri(gltf, entry["uri"], path)
        elif index == 0:
            gltf.buffers[index] = gltf.binary
        else:
            raise gltf.fail(path, "has neither a uri nor a BIN chunk")
    data, length = gltf.buffers[index], _whole(gltf, entry, "byteLength", path, None)
    if length > len(data):
        raise gltf.fail(path, f"promises {length} bytes, {len(data)} are there; export it again")
    return data


def view_bytes(gltf: Gltf, index: Any) -> bytes:
    """Bytes of a bufferView. Raises InputError if it reaches past its buffer."""
    entry, path = gltf.item("bufferViews", index), f"bufferViews[{index}]"
    data = _buffer(gltf, entry.get("buffer"))
    start, length = _whole(gltf, entry, "byteOffset", path), _whole(gltf, entry, "byteLength", path, None)
    if start + length > len(data):
        raise gltf.fail(path, f"reaches to byte {start + length}, its buffer has {len(data)}; export it again")
    return data[start : start + length]


def accessor(gltf: Gltf, index: Any, kind: str) -> npt.NDArray[Any]:
    """(count, width) array of an accessor of type `kind`, normalised integers as f64 in their range. InputError."""
    entry, path = gltf.item("accessors", index), f"accessors[{index}]"
    if entry.get("type") != kind or entry.get("componentType") not in COMPONENTS:
        raise gltf.fail(path, f"expected {kind} of a known componentType, got {str(entry.get('type'))[:20]}")
    if "sparse" in entry or "bufferView" not in entry:
        raise gltf.fail(path, "sparse accessors are not supported; export without them")
    component = np.dtype(COMPONENTS[entry["componentType"]])
    count, width = _whole(gltf, entry, "count", path, None), WIDTHS[kind]
    if count > MAX_COUNT:
        raise gltf.fail(path, f"count {count} is over {MAX_COUNT}")
    data, start = view_bytes(gltf, entry["bufferView"]), _whole(gltf, entry, "byteOffset", path)
    packed = component.itemsize * width
    stride = _whole(gltf, gltf.item("bufferViews", entry["bufferView"]), "byteStride", path, packed) or packed
    if count and (stride < packed or start + stride * (count - 1) + packed > len(data)):
        raise gltf.fail(
            path, f"promises {count} × {kind}, its bufferView of {len(data)} bytes holds fewer; export again"
        )
    if not count:
        return np.zeros((0, width), component)
    values = np.ndarray((count, width), component, data, start, (stride, component.itemsize)).copy()
    if entry.get("normalized") and component.kind != "f":
        return np.maximum(values / float(np.iinfo(component).max), -1.0)
    return values
