"""The record of a run, `results.json`: its shape, and how it is made, checked, written and read.

The models below are the one description of the file; `results.schema.json` is generated from them
(`python -m lightgauge.validation.record`) and a test holds the two together. Files appear whole or not at all:
temporary file, fsync, rename (failure-catalogue G7). NaN and infinity never appear (G9).
"""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..reference.errors import InputError
from .record_models import JsonObject, Results

SCHEMA_VERSION = 1
SCHEMA_FILE = Path(__file__).with_name("results.schema.json")
MAX_BYTES = 256 << 20


def results_json_schema() -> JsonObject:
    """JSON Schema of `results.json`."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Results.model_json_schema(by_alias=True)}


def metric(value: float, se: float | None, n: int, **extra: Any) -> JsonObject | None:
    """One metric of the record, or None if it could not be measured (NaN or infinite): the caller notes the reason.

    se: standard error, in the unit of `value`; None where none applies. n: samples behind it.
    """
    if not math.isfinite(value) or (se is not None and not (math.isfinite(se) and se >= 0.0)):
        return None
    made: JsonObject = {"value": float(value)}
    if se is not None:
        made["se"] = float(se)
    return {**made, "n": int(n), **extra}


def plain(value: object) -> Any:
    """What `json` cannot write itself: NumPy numbers and arrays, paths."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record holds numbers, text, lists and dictionaries, got {type(value).__name__}")


def non_finite_path(value: Any, path: str = "") -> str | None:
    """Path of the first NaN or infinity in nested containers, such as `scenes[0].metrics.leak.value`."""
    if isinstance(value, float):
        return None if math.isfinite(value) else path
    if isinstance(value, Mapping):
        inside = ((v, f"{path}.{k}" if path else str(k)) for k, v in value.items())
    elif isinstance(value, list | tuple):
        inside = ((v, f"{path}[{i}]") for i, v in enumerate(value))
    elif isinstance(value, np.ndarray | np.generic):
        return non_finite_path(value.tolist(), path)
    else:
        return None
    return next((found for v, p in inside if (found := non_finite_path(v, p)) is not None), None)


def dumps(obj: Any) -> str:
    """JSON text: plain ASCII (terminal escapes become \\u001b), NumPy accepted, ValueError on NaN or infinity."""
    bad = non_finite_path(obj)
    if bad is not None:
        raise ValueError(f"{bad} is NaN or infinite, expected a finite number or the metric's absence")
    return json.dumps(obj, indent=1, allow_nan=False, default=plain) + "\n"


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to; on leaving it is synced and renamed to `path`, on error removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.tmp")
    try:
        yield temporary
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_bytes_atomic(path: Path, data: bytes) -> None:
    """Write `data`: the old file or the new one, never half."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_json_atomic(path: Path, obj: Any) -> None:
    """Write `obj` as JSON, whole or not at all; ValueError on NaN or infinity, which leaves the old file."""
    write_bytes_atomic(path, dumps(obj).encode())


def validate_results(obj: Any) -> None:
    """ValueError that names the path of the first thing wrong with a record."""
    _validate_text(dumps(obj))


def _validate_text(text: str) -> None:
    try:
        Results.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ValueError(f"{where}: {first['msg']}") from None


def load_results(path: Path) -> JsonObject:
    """Read and check `results.json` (or the folder that holds one); InputError names the file and what is wrong."""
    path = path / "results.json" if path.is_dir() else path
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: larger than {MAX_BYTES >> 20} MiB, not a results.json of this program")
        text = path.read_bytes().decode()
        found = json.loads(text)
        if isinstance(found, dict) and isinstance(found.get("schema"), int) and found["schema"] != SCHEMA_VERSION:
            raise InputError(f"{path}: schema {found['schema']}, this version reads schema {SCHEMA_VERSION}; run again")
        _validate_text(text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a results.json or a run's folder") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply, not a results.json of this program") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: not a valid results.json: {error}") from None
    result: JsonObject = found
    return result


def write_schema() -> None:
    """Regenerate `results.schema.json` from the models."""
    write_json_atomic(SCHEMA_FILE, results_json_schema())


if __name__ == "__main__":
    write_schema()
