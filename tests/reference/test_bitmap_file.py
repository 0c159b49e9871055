"""The voxel bitmap file: what goes out comes back bit for bit, and hostile files are refused by name and element."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference import bitmap_file
from lightgauge.reference.bitmap_file import FORMAT, read_bitmap, write_bitmap
from lightgauge.reference.datatypes import BitmapLayer
from lightgauge.reference.errors import InputError


def layers() -> tuple[BitmapLayer, ...]:
    rng = np.random.default_rng(0)
    cells = rng.integers(-(2**31), 2**31, (200, 3))
    return (
        BitmapLayer(rng.normal(size=3) * 1e3, float(rng.random()), cells),
        BitmapLayer(np.array([-0.0, 5e-324, 1e9]), 0.1 + 0.2, cells[:1], "remove"),
        BitmapLayer(np.full(3, 0.1), 0.25, cells[5:7], "place"),
        BitmapLayer(np.zeros(3), 1e-6, np.zeros((0, 3), np.int64)),
    )


def test_round_trip_is_exact(tmp_path: Path) -> None:
    write_bitmap(tmp_path / "a.json", layers())
    found = read_bitmap(tmp_path / "a.json")
    for a, b in zip(layers(), found, strict=True):
        assert a.origin.tobytes() == b.origin.tobytes() and a.size == b.size and a.mode == b.mode
        assert a.cells.dtype == b.cells.dtype == np.int64 and np.array_equal(a.cells, b.cells)
    write_bitmap(tmp_path / "b.json", found)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_an_engine_may_write_it_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    path.write_text(
        f'{{"version": 1, "format": "{FORMAT}", "layers": [\n'
        '  {"size": 1, "origin": [0, 1, 2.5], "cells": [[0, 0, 1]], "mode": "add"}]}'
    )
    (layer,) = read_bitmap(path)
    assert layer.size == 1.0 and layer.origin.tolist() == [0.0, 1.0, 2.5] and layer.cells.tolist() == [[0, 0, 1]]


LAYER: dict[str, Any] = {"mode": "add", "origin": [0, 0, 0], "size": 1.0, "cells": [[0, 0, 0]]}
BROKEN: dict[str, tuple[Any, str]] = {
    "empty": (b"", "not valid JSON"),
    "text": (b"hello", "not valid JSON"),
    "binary": (b"\xff\xfe\0", "not valid JSON"),
    "half": (b'{"format": "' + FORMAT.encode(), "not valid JSON"),
    "list": ([], "not a voxel bitmap"),
    "another format": ({"format": "x", "version": 1, "layers": []}, "not a voxel bitmap"),
    "another version": ({"format": FORMAT, "version": 2, "layers": []}, "version: this program reads 1, got 2"),
    "true for 1": ({"format": FORMAT, "version": True, "layers": []}, "version"),
    "no layers": ({"format": FORMAT, "version": 1}, "layers: expected a list"),
    "unknown key": ({"format": FORMAT, "version": 1, "layers": [], "unit": "cm"}, "unknown key 'unit'"),
    "layer is no object": ([3], "layers[0]: expected an object"),
    "key missing": ([{k: v for k, v in LAYER.items() if k != "size"}], "layers[0].size: missing"),
    "key too many": ([LAYER, LAYER | {"sizes": 3}], "layers[1]: unknown key 'sizes'"),
    "mode": ([LAYER | {"mode": "limit"}], "layers[0].mode: expected one of add, place, remove, got 'limit'"),
    "mode is a list": ([LAYER | {"mode": []}], "layers[0].mode"),
    "size 0": ([LAYER | {"size": 0}], "layers[0].size: expected 1e-06 m or more, got 0"),
    "size negative": ([LAYER | {"size": -2.0}], "layers[0].size"),
    "size text": ([LAYER | {"size": "1"}], "layers[0].size: expected a number"),
    "size true": ([LAYER | {"size": True}], "layers[0].size: expected a number"),
    "size huge": ([LAYER | {"size": 1e300}], "layers[0].size: expected at most 1e+09 m"),
    "origin short": ([LAYER | {"origin": [0, 0]}], "layers[0].origin: expected three numbers"),
    "origin far": ([LAYER | {"origin": [0, 0, 10**400]}], "layers[0].origin: expected at most"),
    "NaN": (b'{"format": "' + FORMAT.encode() + b'", "version": 1, "layers": [NaN]}', "holds NaN"),
    "infinity": (b'{"format": "' + FORMAT.encode() + b'", "version": -Infinity}', "holds -Infinity"),
    "overflow": (json.dumps([LAYER]).replace("1.0", "1e999").encode(), "layers[0].size: expected at most"),
    "cells no list": ([LAYER | {"cells": {}}], "layers[0].cells: expected a list"),
    "cell of two": ([LAYER, LAYER | {"cells": [[0, 0, 0], [1, 2]]}], "layers[1].cells[1]: expected three integers"),
    "cell of fractions": ([LAYER | {"cells": [[0, 0.5, 0]]}], "layers[0].cells[0]"),
    "cell of truths": ([LAYER | {"cells": [[0, 0, 0], [0, True, 0]]}], "layers[0].cells[1]"),
    "cell too far": ([LAYER | {"cells": [[0, 0, 2**31]]}], "layers[0].cells[0]"),
    "cell of many digits": ([LAYER | {"cells": [[0, 0, 10**60]]}], "layers[0].cells[0]"),
    "cell nested": ([LAYER | {"cells": [[[0], [0], [0]]]}], "layers[0].cells[0]"),
    "cell of texts": ([LAYER | {"cells": ["abc"]}], "layers[0].cells[0]"),
    "deep": (b"[" * 200_000, "nested too deeply"),
    "too many digits": (b"[" + b"9" * 5000 + b"]", "not valid JSON"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_hostile_files_are_refused(tmp_path: Path, name: str) -> None:
    content, words = BROKEN[name]
    if isinstance(content, list) and name != "list":
        content = {"format": FORMAT, "version": 1, "layers": content}
    if name == "overflow":
        content = b'{"format": "%s", "version": 1, "layers": %s}' % (FORMAT.encode(), content)
    path = tmp_path / "edit.json"
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    with pytest.raises(InputError) as caught:
        read_bitmap(path, "placement.bitmap")
    assert str(caught.value).startswith(f"placement.bitmap: {path}: ") and words in str(caught.value)


def test_sizes_are_judged_before_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(bitmap_file.MAX_BYTES + 1)
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail("read"))
    with pytest.raises(InputError, match=r"large\.json: has 67108865 bytes, the limit is 67108864"):
        read_bitmap(large)
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path / "pipe", "not a regular file"),
        (tmp_path, "not a regular file"),
        (tmp_path / "no", "cannot be read"),
    ):
        with pytest.raises(InputError, match=words):
            read_bitmap(path)


def test_counts_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "many.json"
    write_bitmap(path, [BitmapLayer(np.zeros(3), 1.0, np.zeros((60, 3), np.int64))] * 2)
    monkeypatch.setattr(bitmap_file, "MAX_CELLS", 100)
    with pytest.raises(InputError, match=r"layers\[1\]\.cells: over 100 cells"):
        read_bitmap(path)
    monkeypatch.setattr(bitmap_file, "MAX_LAYERS", 1)
    with pytest.raises(InputError, match="layers: 2, at most 1"):
        read_bitmap(path)


@pytest.mark.parametrize(
    "layer",
    [
        BitmapLayer(np.zeros(3), 0.0, np.zeros((1, 3), np.int64)),
        BitmapLayer(np.full(3, np.nan), 1.0, np.zeros((1, 3), np.int64)),
        BitmapLayer(np.zeros(3), 1.0, np.full((1, 3), 1 << 40)),
        BitmapLayer(np.zeros(3), 1.0, np.zeros((1, 3))),  # type: ignore[arg-type]
        BitmapLayer(np.zeros(2), 1.0, np.zeros((1, 3), np.int64)),
        BitmapLayer(np.zeros(3), 1.0, np.zeros((1, 3), np.int64), "limit"),  # type: ignore[arg-type]
    ],
)
def test_what_could_not_be_read_is_not_written(tmp_path: Path, layer: BitmapLayer) -> None:
    path = tmp_path / "a.json"
    write_bitmap(path, layers())
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"not a voxel bitmap: layers\[1\]"):
        write_bitmap(path, [layers()[0], layer])
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    write_bitmap(path, layers())
    before = path.read_bytes()

    def full(handle: int) -> None:
        raise OSError(5, "input/output error")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"a\.json: cannot be written"):
        write_bitmap(path, layers()[:1])
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.json"]
