"""Finished work, kept by the hash of all that it depends on.

A file is a line with its format, a line with the SHA-256 of the rest, and an uncompressed NumPy archive without
pickles. A file that does not match its checksum is rebuilt, and that is said (failure-catalogue G8).
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
import zipfile
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .machine import cache_folder
from .record import write_bytes_atomic

Arrays = dict[str, npt.NDArray[Any]]
_FORMAT = b"lightgauge cache 1\n"
_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "pyopencl")


def key(*parts: Any) -> str:
    """SHA-256 of the JSON of `parts`."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


@cache
def code_hash(*folders: str) -> str:
    """Hash of our own source under `folders` ("a/*": only the files right in a; "a/b.py": that file) and of the versions of what
    computes. Raises ValueError for one without source: it was renamed, and the hash would not cover it."""
    digest = hashlib.sha256()
    root = Path(__file__).parent.parent
    for name in _PACKAGES:
        digest.update(f"{name}=={metadata.version(name)};".encode())
    for folder in folders:
        named = root / folder
        found = root.glob(folder) if folder.endswith("*") else [named] if named.is_file() else named.rglob("*")
        source = sorted(path for path in found if path.suffix in {".py", ".cl", ".clh"})
        if not source:
            raise ValueError(f"no source under {folder}")
        for path in source:
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def array_hash(arrays: Iterable[npt.NDArray[Any] | None]) -> str:
    """Hash of shapes, types and contents."""
    digest = hashlib.sha256()
    for a in arrays:
        digest.update(b"none" if a is None else f"{a.shape}{a.dtype}".encode() + np.ascontiguousarray(a).tobytes())
    return digest.hexdigest()


def load(kind: str, name: str) -> Arrays | None:
    """What was kept under this kind and key, or None."""
    path = cache_folder() / kind / f"{name}.npz"
    try:
        data = path.read_bytes()
    except OSError:
        return None
    body = data[len(_FORMAT) + 65 :]
    good = data.startswith(_FORMAT) and data[len(_FORMAT) :][:64] == hashlib.sha256(body).hexdigest().encode()
    if good:
        try:
            with np.load(io.BytesIO(body), allow_pickle=False) as archive:
                return {n: archive[n] for n in archive.files}
        except (ValueError, zipfile.BadZipFile, KeyError):
            pass
    print(f"lightgauge: {path} is damaged; computing again", file=sys.stderr)
    return None


def store(kind: str, name: str, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Keep `arrays`. A cache that cannot be written is said, not fatal."""
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    body = buffer.getvalue()
    path = cache_folder() / kind / f"{name}.npz"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes_atomic(path, _FORMAT + hashlib.sha256(body).hexdigest().encode() + b"\n" + body)
    except OSError as error:
        print(f"lightgauge: cannot keep {path}: {error.strerror}", file=sys.stderr)


def pack_json(value: Any) -> npt.NDArray[np.uint8]:
    """A JSON value as an array that `store` takes."""
    return np.frombuffer(json.dumps(value, allow_nan=False).encode(), dtype=np.uint8)


def unpack_json(array: npt.NDArray[Any]) -> Any:
    """Inverse of `pack_json`."""
    return json.loads(array.astype(np.uint8).tobytes())
