"""The voxel bitmap file: plain JSON that an engine or a script can write, laid over what a scene marks by itself.

    {"format": "lightgauge voxel bitmap", "version": 1,
     "layers": [{"mode": "add", "origin": [0.0, 0.0, 0.0], "size": 0.25, "cells": [[12, 0, 7], [12, 1, 7]]},
                {"mode": "remove", "origin": [0.0, 0.0, 0.0], "size": 2.0, "cells": [[0, 0, 0]]}]}

Cell [i, j, k] of a layer is the cube of edge `size`, m, whose lower corner lies at `origin` + `size` · [i, j, k], m, in the scene's
own axes (y up), after `unit_m` and `scene.rotation`. Layers count from the first to the last: "add" marks its cells at
their size; "place" does too, and the octree has voxels there even where no surface is near; "remove" unmarks what was marked
in them, at their size and finer. Cells finer than `placement.min_voxel` make the octree deeper there, and only there. How
cells meet the octree's lattice: placement/bitmap_layers.py. Numbers are finite; indices are integers under 2^31 in magnitude.

Floats are written so that they read back bit for bit: `read_bitmap(path)` is exactly what `write_bitmap` got.
"""

from __future__ import annotations

import json
import math
import stat
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np

from .datatypes import F64, I64, BitmapLayer
from .errors import InputError
from .whole_file import whole_file

FORMAT = "lightgauge voxel bitmap"
VERSION = 1
MAX_BYTES = 64 << 20
MAX_LAYERS = 4096
MAX_CELLS = 1 << 22  # of all layers
MAX_INDEX = 1 << 31
MIN_SIZE, MAX_METRES = 1e-6, 1e9
MODES: tuple[Literal["add", "place", "remove"], ...] = ("add", "place", "remove")
KEYS = {"mode", "origin", "size", "cells"}


class _Wrong(Exception):
    """What is wrong, without the file's name."""


def write_bitmap(path: Path, layers: Sequence[BitmapLayer]) -> None:
    """Write `layers` to `path`, whole or not at all.

    Raises ValueError for layers that `read_bitmap` would refuse, InputError where the path cannot be written.
    """
    tables = [
        {
            "mode": layer.mode,
            "origin": np.asarray(layer.origin, np.float64).tolist(),
            "size": float(layer.size),
            "cells": np.asarray(layer.cells).tolist(),
        }
        for layer in layers
    ]
    try:
        _layers(tables)
        text = ",\n".join(json.dumps(table, allow_nan=False, separators=(",", ":")) for table in tables)
    except _Wrong as error:
        raise ValueError(f"not a voxel bitmap: {error}") from None
    data = f'{{"format": "{FORMAT}", "version": {VERSION}, "layers": [\n{text}\n]}}\n'.encode()
    if len(data) > MAX_BYTES:
        raise ValueError(f"not a voxel bitmap: {len(data)} bytes, at most {MAX_BYTES}; use larger cells")
    with whole_file(path, "voxel bitmap") as file:
        file.write(data)


def read_bitmap(path: Path, where: str = "") -> tuple[BitmapLayer, ...]:
    """The layers of a file. where: the setting that names it, for messages.

    Raises InputError that names the file and the element: missing, too large, not this format, numbers out of range.
    """
    named = f"{where}: {path}" if where else str(path)
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise _Wrong("is not a regular file; name a voxel bitmap (JSON)")
        if found.st_size > MAX_BYTES:
            raise _Wrong(f"has {found.st_size} bytes, the limit is {MAX_BYTES}; use larger cells or fewer of them")
        value = json.loads(path.read_bytes().decode("utf-8"), parse_constant=_refuse_constant)
        return _layers(_header(value))
    except OSError as error:
        raise InputError(f"{named}: cannot be read ({error.strerror or error}); correct the name") from None
    except RecursionError:
        raise InputError(f"{named}: nested too deeply, not a voxel bitmap") from None
    except _Wrong as error:
        raise InputError(f"{named}: {error}") from None
    except ValueError as error:  # of JSON and UTF-8
        raise InputError(f"{named}: not valid JSON: {error}") from None


def _refuse_constant(name: str) -> NoReturn:
    raise _Wrong(f"holds {name}; numbers must be finite")


def _header(value: Any) -> Sequence[Any]:
    """The list of layers of a document. Raises _Wrong."""
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise _Wrong(f'not a voxel bitmap: expected an object with "format": "{FORMAT}"')
    version = value.get("version")
    if type(version) is not int or version != VERSION:
        raise _Wrong(f"version: this program reads {VERSION}, got {str(version)[:40]}; write the file again")
    extra = sorted(set(value) - {"format", "version", "layers"})
    if extra:
        raise _Wrong(f"unknown key {extra[0][:40]!r}; remove it")
    layers = value.get("layers")
    if not isinstance(layers, list):
        raise _Wrong("layers: expected a list")
    return layers


def _layers(tables: Sequence[Any]) -> tuple[BitmapLayer, ...]:
    if len(tables) > MAX_LAYERS:
        raise _Wrong(f"layers: {len(tables)}, at most {MAX_LAYERS} are allowed; join those of one size and mode")
    layers = []
    total = 0
    for i, table in enumerate(tables):
        layers.append(_layer(table, f"layers[{i}]"))
        total += len(layers[-1].cells)
        if total > MAX_CELLS:
            raise _Wrong(f"layers[{i}].cells: over {MAX_CELLS} cells with those before; use larger cells")
    return tuple(layers)


def _layer(table: Any, at: str) -> BitmapLayer:
    if not isinstance(table, Mapping):
        raise _Wrong(f"{at}: expected an object with {', '.join(sorted(KEYS))}")
    if set(table) != KEYS:
        missing, extra = sorted(KEYS - set(table)), sorted(set(table) - KEYS)
        raise _Wrong(f"{at}.{missing[0]}: missing" if missing else f"{at}: unknown key {extra[0][:40]!r}; remove it")
    mode = next((m for m in MODES if m == table["mode"]), None)
    if mode is None:
        raise _Wrong(f"{at}.mode: expected one of {', '.join(MODES)}, got {str(table['mode'])[:40]!r}")
    origin = table["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise _Wrong(f"{at}.origin: expected three numbers, m")
    corner: F64 = np.array([_number(x, f"{at}.origin") for x in origin], np.float64)
    size = _number(table["size"], f"{at}.size")
    if size < MIN_SIZE:
        raise _Wrong(f"{at}.size: expected {MIN_SIZE:g} m or more, got {size:g}; check the unit")
    return BitmapLayer(corner, size, _cells(table["cells"], f"{at}.cells"), mode)


def _number(value: Any, at: str) -> float:
    """A finite float of bearable size. Raises _Wrong."""
    if type(value) not in (int, float):
        raise _Wrong(f"{at}: expected a number, m, got {str(value)[:40]!r}")
    if not (abs(value) <= MAX_METRES and math.isfinite(value)):
        raise _Wrong(f"{at}: expected at most {MAX_METRES:g} m in magnitude, got {str(value)[:40]}; check the unit")
    return float(value)


def _cells(value: Any, at: str) -> I64:
    """(N, 3) i64. Raises _Wrong naming the first cell that is not three integers in range."""
    if not isinstance(value, list):
        raise _Wrong(f"{at}: expected a list of [i, j, k]")
    if len(value) > MAX_CELLS:
        raise _Wrong(f"{at}: {len(value)} cells, at most {MAX_CELLS} are allowed; use larger cells")
    if set(map(type, value)) <= {list} and set(map(len, value)) <= {3}:
        flat = list(chain.from_iterable(value))
        # By type, since JSON's true would pass for 1.
        if set(map(type, flat)) <= {int} and (not flat or (min(flat) >= -MAX_INDEX and max(flat) < MAX_INDEX)):
            return np.array(flat, np.int64).reshape(-1, 3)
    for n, cell in enumerate(value):
        good = isinstance(cell, list) and len(cell) == 3 and all(type(x) is int for x in cell)
        if not good or not all(-MAX_INDEX <= x < MAX_INDEX for x in cell):
            raise _Wrong(f"{at}[{n}]: expected three integers under 2^31 in magnitude, got {str(cell)[:60]}")
    raise _Wrong(f"{at}: expected a list of [i, j, k]")
