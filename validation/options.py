"""Settings from the command line: `--config FILE` and `--set a.b=value`, merged into one nested dictionary."""

from __future__ import annotations

import datetime
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..reference.errors import InputError


def read_overrides(config: Path | None, assignments: Sequence[str], bitmap: Path | None = None) -> dict[str, Any]:
    """The table of `config` (if any) with every `--set` laid over it, in order, and `--bitmap` last. Raises InputError."""
    merged = {} if config is None else read_toml(config)
    for assignment in assignments:
        merged = merge(merged, parse_assignment(assignment), f"--set {assignment}")
    if bitmap is not None:
        merged = merge(merged, {"placement": {"bitmap": str(bitmap)}}, f"--bitmap {bitmap}")
    return merged


def read_toml(path: Path) -> dict[str, Any]:
    """The file's table. Raises InputError naming the file (and the line, where it is not TOML)."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not TOML: {error}") from error


def parse_assignment(text: str) -> dict[str, Any]:
    """`a.b.c=value` as {"a": {"b": {"c": value}}}. The value is TOML; what is not TOML is taken as a string."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or "\n" in key:
        raise InputError(f"--set wants KEY=VALUE, as in placement.min_voxel=0.25; got {text!r}")
    try:
        table = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"--set {text!r}: {key.strip()!r} is not a dotted key") from error
    return _with_leaf(table, parse_value(value.strip()))


def parse_value(text: str) -> Any:
    """TOML value, or the text itself. Dates stay text: no setting is one."""
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    dated = isinstance(table["value"], datetime.date | datetime.time)
    return text if dated or len(table) != 1 else table["value"]


def _with_leaf(table: Mapping[str, Any], leaf: Any) -> dict[str, Any]:
    """A chain of one-key tables with its innermost value replaced."""
    return {key: _with_leaf(value, leaf) if isinstance(value, dict) else leaf for key, value in table.items()}


def merge(below: Mapping[str, Any], above: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """`above` laid over `below`, table by table. Raises InputError where one has a table and the other a value."""
    result = dict(below)
    for key, value in above.items():
        old = result.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            result[key] = merge(old, value, origin)
        elif key in result and isinstance(old, dict) != isinstance(value, dict):
            raise InputError(f"{origin}: {key!r} is a table in one place and a value in another")
        else:
            result[key] = value
    return result
