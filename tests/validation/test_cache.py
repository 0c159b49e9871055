"""Kept results: round trip, damage, no pickles, keys (failure-catalogue G8)."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
import pytest
from lightgauge.validation import cache


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


ARRAYS = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b.c": np.array(5),
    "text": cache.pack_json({"x": [1, "é"]}),
}


def test_round_trip(folder: Path) -> None:
    assert cache.load("truth", "k") is None
    cache.store("truth", "k", ARRAYS)
    found = cache.load("truth", "k")
    assert found is not None and set(found) == set(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert cache.unpack_json(found["text"]) == {"x": [1, "é"]}
    assert [p.name for p in (folder / "truth").iterdir()] == ["k.npz"], "no temporary file stays"
    assert cache.load("result", "k") is None


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "header", "grow"])
def test_damage_is_said_and_not_used(folder: Path, capsys: pytest.CaptureFixture[str], damage: str) -> None:
    cache.store("truth", "k", ARRAYS)
    path = folder / "truth" / "k.npz"
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[len(data) // 2] ^= 1
    elif damage == "header":
        data[0] ^= 1
    elif damage == "grow":
        data += b"x"
    path.write_bytes(b"" if damage == "empty" else bytes(data[: len(data) // 2] if damage == "cut" else data))
    assert cache.load("truth", "k") is None
    assert "is damaged; computing again" in capsys.readouterr().err
    cache.store("truth", "k", ARRAYS)
    assert cache.load("truth", "k") is not None


def test_pickles_are_never_opened(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Even with a right checksum."""
    buffer = io.BytesIO()
    np.savez(buffer, a=np.array([{"x": 1}], dtype=object))
    body = buffer.getvalue()
    (folder / "truth").mkdir(parents=True)
    checksum = hashlib.sha256(body).hexdigest().encode()
    (folder / "truth" / "k.npz").write_bytes(b"lightgauge cache 1\n" + checksum + b"\n" + body)
    assert cache.load("truth", "k") is None
    assert "damaged" in capsys.readouterr().err


def test_a_cache_that_cannot_be_written_is_said_not_fatal(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder.write_text("a file where a folder should be")
    cache.store("truth", "k", ARRAYS)
    assert "cannot keep" in capsys.readouterr().err


def test_keys_depend_on_every_part() -> None:
    keys = {cache.key(*p) for p in (("a", 1), ("a", 2), ("b", 1), ("a", "1"), ("a", 1, None), (["a", 1],), ({"a": 1},))}
    assert len(keys) == 7
    assert cache.key({"a": 1, "b": 2}) == cache.key({"b": 2, "a": 1})


def test_array_hash_depends_on_shape_type_and_content() -> None:
    a = np.arange(6, dtype=np.float32)
    kinds = [[a], [a.reshape(2, 3)], [a.astype(np.float64)], [a + 1], [None], [a, None], [a[::-1]]]
    assert len({cache.array_hash(k) for k in kinds}) == 7
    assert cache.array_hash([a[::2]]) == cache.array_hash([a[::2].copy()])


def test_code_hash_differs_by_folder() -> None:
    assert cache.code_hash("reference") == cache.code_hash("reference") != cache.code_hash("fastpath")


def test_nan_does_not_enter_json() -> None:
    with pytest.raises(ValueError, match="JSON"):
        cache.pack_json({"x": float("nan")})
