"""One file for a bake: named arrays and a JSON header, checksummed, versioned, written whole or not at all. No pickle.

    magic      8 bytes, "LGBAKE\\n\\0"
    version    u32; all numbers are little-endian
    length     u64, bytes of the header
    header     canonical JSON (ASCII, sorted keys, no blanks) of kind, scene, scene_hash, metadata, version and arrays, a list
               of {name, dtype, shape, offset, nbytes}; then blanks, so that the data begin at a multiple of 64
    checksum   SHA-256 of all that precedes it
    data       the arrays, C order, each at the next multiple of 64 bytes; offsets count from the first
    checksum   SHA-256 of the data

Every byte is under a checksum or part of one. The place of each array follows from the sizes before it, and a header that
says otherwise is refused: arrays cannot overlap, leave gaps or end outside the file.
"""

from __future__ import annotations

import hashlib
import json
import math
import mmap
import os
import stat
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from .errors import InputError
from .whole_file import whole_file

MAGIC = b"LGBAKE\n\0"
VERSION = 1  # to be raised whenever the layout of the file or the meaning of an array changes
ALIGNMENT = 64
MAX_HEADER = 16 << 20
MAX_AXES = 8
MAX_ARRAY = 1 << 62  # bytes, with empty axes counted as one: what NumPy can index
DTYPES = {"f4": "<f4", "f8": "<f8", "i4": "<i4", "i8": "<i8", "u1": "|u1", "u4": "<u4", "bool": "|b1"}
TEXTS = ("kind", "scene", "scene_hash")  # of the header, beside the object "metadata"
WAY_OUT = "bake it again: lightgauge bake SCENE --out FILE"

_PREFIX = struct.Struct("<8sIQ")
_DIGEST = hashlib.sha256().digest_size
_ENTRY = {"name": str, "dtype": str, "shape": list, "offset": int, "nbytes": int}
_NAMES = {np.dtype(full): name for name, full in DTYPES.items()}

Array = npt.NDArray[Any]


class _Wrong(Exception):
    """What is wrong with a file, without its name and the way out."""


def write_bake(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write `arrays` under `header`: the texts kind, scene, scene_hash, and metadata, an object of finite JSON values.

    The file appears whole, or what was there stays. Raises ValueError on another header or an array type outside DTYPES,
    InputError where the path cannot be written, EnvironmentLacks where the disk is full.
    """
    packed = {name: _packed(name, array) for name, array in arrays.items()}
    raw = _header(header, packed)
    head = _PREFIX.pack(MAGIC, VERSION, len(raw)) + raw
    with whole_file(path, "bake") as file:
        file.write(head + hashlib.sha256(head).digest())
        digest, at = hashlib.sha256(), 0
        for array in packed.values():
            for part in (bytes(-at % ALIGNMENT), array.reshape(-1).view(np.uint8).data):
                digest.update(part)
                at += file.write(part)
        file.write(digest.digest())


def read_bake(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The header (kind, scene, scene_hash, metadata, version) and the arrays, read-only and mapped from the file.

    Both checksums are verified first. Raises InputError that names the file, what is wrong with it, and the way out.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # asked before it is opened: a pipe would wait for ever
            raise _Wrong("is a folder, not a bake" if path.is_dir() else "is not a regular file")
        with path.open("rb") as file:
            header, start = _read_header(file)
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return header, _read_arrays(header.pop("arrays"), mapped, start)
    except _Wrong as error:
        raise InputError(f"{path}: {error}; {WAY_OUT}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {WAY_OUT}") from None


def _packed(name: str, array: Array) -> Array:
    """`array` little-endian in C order. Raises ValueError if its type is not in DTYPES."""
    little = array.dtype.newbyteorder("<")
    if little not in _NAMES or array.ndim > MAX_AXES or not isinstance(name, str) or not name:
        allowed = f"{', '.join(DTYPES)}, with at most {MAX_AXES} axes and a name"
        raise ValueError(f"array {name!r} must be one of {allowed}, got {array.dtype} {array.shape}")
    return np.asarray(array, dtype=little, order="C")


def _canonical(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")


def _blanks(raw: bytes) -> bytes:
    """What follows the header `raw` so that the data begin at a multiple of ALIGNMENT."""
    return b" " * (-(_PREFIX.size + len(raw) + _DIGEST) % ALIGNMENT)


def _header(header: Mapping[str, Any], packed: Mapping[str, Array]) -> bytes:
    """The header with its table of arrays and its blanks. Raises ValueError if it would not be read back the same."""
    if set(header) != {*TEXTS, "metadata"} or not all(isinstance(header[text], str) for text in TEXTS):
        raise ValueError(f"a bake's header has the texts {', '.join(TEXTS)} and metadata, got {dict(header)!r:.200}")
    table, at = [], 0
    for name, array in packed.items():
        at += -at % ALIGNMENT
        shape = {"dtype": _NAMES[array.dtype], "shape": list(array.shape)}
        table.append(shape | {"name": name, "offset": at, "nbytes": array.nbytes})
        at += array.nbytes
    try:
        raw = _canonical({**header, "version": VERSION, "arrays": table})
        same = _canonical(json.loads(raw)) == raw  # keys that are numbers come back as texts, in another order
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"metadata must be finite JSON values: {error}") from None
    if not (same and isinstance(header["metadata"], dict) and len(raw) <= MAX_HEADER - ALIGNMENT):
        raise ValueError(f"metadata must be an object with texts as keys, all in all under {MAX_HEADER} bytes")
    return raw + _blanks(raw)


def _read_header(file: IO[bytes]) -> tuple[dict[str, Any], int]:
    """The checked header, and where the data begin."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(_PREFIX.size)
    if not head or head[: len(MAGIC)] != MAGIC[: len(head)]:
        raise _Wrong("is not a bake" if head else "is empty")
    if len(head) < _PREFIX.size:
        raise _Wrong(f"is cut off after {size} bytes")
    _, version, length = _PREFIX.unpack(head)
    if version != VERSION:
        raise _Wrong(f"has format version {version}, this program reads version {VERSION}")
    if length > MAX_HEADER:
        raise _Wrong(f"claims a header of {length} bytes, {MAX_HEADER} at most are allowed")
    if size < _PREFIX.size + length + 2 * _DIGEST:
        raise _Wrong(f"is cut off after {size} bytes, within its header")
    raw = file.read(length)
    if hashlib.sha256(head + raw).digest() != file.read(_DIGEST):
        raise _Wrong("is damaged: the checksum of its header is wrong")
    return _parsed(raw), file.tell()


def _parsed(raw: bytes) -> dict[str, Any]:
    """The JSON header, of which everything but the table is checked here."""
    text = raw.rstrip(b" ")
    try:
        header = json.loads(text)
        canonical = _canonical(header)
    except (ValueError, RecursionError) as error:
        raise _Wrong(f"has a header that is not JSON ({error!s:.80})") from None
    if raw != canonical + _blanks(canonical):
        raise _Wrong("has a header that is not in canonical form")
    keys = {*TEXTS, "metadata", "version", "arrays"}
    if type(header) is not dict or set(header) != keys or header["version"] != VERSION:
        raise _Wrong(f"has a header without exactly {', '.join(sorted(keys))}, or of another version")
    kinds = {**dict.fromkeys(TEXTS, str), "metadata": dict, "version": int, "arrays": list}
    for key, kind in kinds.items():
        if type(header[key]) is not kind:
            raise _Wrong(f"has a header in which {key} is {header[key]!r:.60}")
    return header


def _read_arrays(table: list[Any], mapped: mmap.mmap, start: int) -> dict[str, Array]:
    """The arrays of a header whose checksum is right, once the table and the data are found right too."""
    places, at, end = {}, 0, len(mapped) - start - _DIGEST
    for entry in table:
        name, dtype, shape, count = _checked(entry)
        if name in places:
            raise _Wrong(f"holds two arrays named {name!r:.60}")
        at += -at % ALIGNMENT
        if entry["offset"] != at:
            raise _Wrong(f"says that array {name!r:.60} begins at byte {entry['offset']!s:.60} of the data, not {at}")
        at += count
        if at > end:
            raise _Wrong(f"is cut off: array {name!r:.60} needs {at!s:.60} bytes of data, there are {end}")
        places[name] = dtype, shape, start + at - count
    if at != end:
        raise _Wrong(f"holds {end - at} bytes more than its arrays")
    if hashlib.sha256(memoryview(mapped)[start : start + end]).digest() != mapped[start + end :]:
        raise _Wrong("is damaged: the checksum of its data is wrong")
    arrays = {name: np.ndarray(s, dtype, mapped, offset) for name, (dtype, s, offset) in places.items()}
    for name, array in arrays.items():
        if array.dtype == np.bool_ and array.view(np.uint8).max(initial=0) > 1:
            raise _Wrong(f"holds neither true nor false in array {name!r:.60}")
    return arrays


def _checked(entry: Any) -> tuple[str, np.dtype[Any], tuple[int, ...], int]:
    """Name, dtype, shape and bytes of one entry of the table; offsets are judged by its reader."""
    if type(entry) is not dict or set(entry) != set(_ENTRY) or any(type(entry[k]) is not t for k, t in _ENTRY.items()):
        raise _Wrong(f"describes an array by {entry!r:.120}, not by {', '.join(_ENTRY)}")
    name, shape = entry["name"], entry["shape"]
    if not name or entry["dtype"] not in DTYPES:
        raise _Wrong(f"gives array {name!r:.60} the type {entry['dtype']!r:.60}, not one of {', '.join(DTYPES)}")
    if len(shape) > MAX_AXES or not all(type(n) is int and n >= 0 for n in shape):
        raise _Wrong(f"gives array {name!r:.60} the shape {shape!r:.120}")
    dtype = np.dtype(DTYPES[entry["dtype"]])
    if math.prod(max(n, 1) for n in shape) * dtype.itemsize > MAX_ARRAY:
        raise _Wrong(f"gives array {name!r:.60} the shape {shape!r:.120}, more than any machine holds")
    count = math.prod(shape) * dtype.itemsize
    if entry["nbytes"] != count:
        raise _Wrong(f"gives array {name!r:.60} {entry['nbytes']!s:.60} bytes, its shape needs {count}")
    return name, dtype, tuple(shape), count
