"""The bake file: what is written is read back, and nothing else is accepted: damage, lies and half-written files."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference import bake_file
from lightgauge.reference.bake_file import ALIGNMENT, DTYPES, MAGIC, MAX_HEADER, VERSION, read_bake, write_bake
from lightgauge.reference.errors import EnvironmentLacks, InputError

HEADER: dict[str, Any] = {
    "kind": "surfaces",
    "scene": "Größe \ud800 ☃",
    "scene_hash": "ab" * 32,
    "metadata": {"seed": 3, "größe": [0.1, -0.0, 1e300, None, True, {"": []}], "a": '\n\0"\\'},
}
PREFIX = struct.Struct("<8sIQ")
SHA256 = hashlib.sha256


def some_arrays() -> dict[str, np.ndarray]:
    """One of each type, empty, without axes, with odd sizes, big-endian, strided."""
    rng = np.random.default_rng(0)
    made = {name: (rng.random((3, 5)) * 2).astype(full) for name, full in DTYPES.items()}
    return made | {
        "empty": np.zeros((0, 4), np.float32),
        "no axes": np.float64(2.5).reshape(()),
        "one byte": np.ones(1, np.uint8),
        "big-endian": np.arange(7, dtype=">i4"),
        "strided": np.arange(24, dtype=np.int64).reshape(4, 6)[::2, ::-3],
        "long": rng.random(1000, dtype=np.float32),
        "nan": np.array([np.nan, np.inf, -0.0]),
        "last, empty": np.zeros(0, np.bool_),
    }


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A small whole bake, for what is done to every byte of it."""
    path = tmp_path / "scene.bake"
    arrays = {"a": np.arange(5, dtype=np.float32), "flags": np.array([True, False]), "b": np.arange(9.0)}
    write_bake(path, HEADER, arrays)
    return path


def refused(path: Path, match: str | None = None) -> str:
    """The one line with which `path` is refused: the file, what is wrong, the way out."""
    with pytest.raises(InputError, match=match) as found:
        read_bake(path)
    message = str(found.value)
    assert message.startswith(f"{path}: ") and message.endswith("; " + bake_file.WAY_OUT) and "\n" not in message
    return message


def test_round_trip(tmp_path: Path) -> None:
    path, arrays = tmp_path / "a.bake", some_arrays()
    write_bake(path, HEADER, arrays)
    header, found = read_bake(path)
    assert header == HEADER | {"version": VERSION}
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].shape == array.shape and found[name].dtype == array.dtype.newbyteorder("<")
        np.testing.assert_array_equal(found[name], array)
        assert found[name].flags.c_contiguous and not found[name].flags.writeable
        assert found[name].size == 0 or found[name].ctypes.data % ALIGNMENT == 0
    with pytest.raises(ValueError, match="read-only"):
        found["long"][0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        found["long"].setflags(write=True)


def test_arrays_outlive_the_file_and_their_neighbours(written: Path) -> None:
    array = read_bake(written)[1]["b"]
    written.unlink()
    np.testing.assert_array_equal(array, np.arange(9.0))


def test_no_arrays_and_no_metadata(tmp_path: Path) -> None:
    path = tmp_path / "a.bake"
    write_bake(path, HEADER | {"metadata": {}}, {})
    header, arrays = read_bake(path)
    assert header["metadata"] == {} and arrays == {}


def test_same_content_same_bytes(tmp_path: Path) -> None:
    """Whatever the order of the header's keys and the layout of the arrays in memory."""
    a, b = tmp_path / "a", tmp_path / "b"
    array = np.arange(12, dtype=np.float32).reshape(3, 4)
    write_bake(a, HEADER, {"x": array})
    write_bake(b, dict(reversed(HEADER.items())), {"x": np.asfortranarray(array)})
    assert a.read_bytes() == b.read_bytes()


def test_the_layout_is_the_one_that_is_documented(written: Path) -> None:
    """Read by hand, so that the file stays readable by others."""
    data = written.read_bytes()
    magic, version, length = PREFIX.unpack(data[:20])
    assert (magic, version) == (b"LGBAKE\n\0", 1)
    assert hashlib.sha256(data[: 20 + length]).digest() == data[20 + length : 52 + length]
    start = 52 + length
    assert start % 64 == 0 and hashlib.sha256(data[start:-32]).digest() == data[-32:]
    table = json.loads(data[20 : 20 + length])["arrays"]
    assert [entry["offset"] for entry in table] == [0, 64, 128]
    assert data[start + 128 : start + 200] == np.arange(9.0).tobytes()


def test_every_flipped_bit_is_found(written: Path) -> None:
    """Each byte, in one bit or all of them: no position is without a guard."""
    good = written.read_bytes()
    for position in range(len(good)):
        for mask in (1 << position % 8, 0xFF):
            bad = bytearray(good)
            bad[position] ^= mask
            written.write_bytes(bad)
            refused(written)
    written.write_bytes(good)
    read_bake(written)


def test_every_truncation_and_every_tail_is_found(written: Path) -> None:
    good = written.read_bytes()
    for length in range(len(good)):
        written.write_bytes(good[:length])
        refused(written)
    for tail in (b"\0", b"\0" * 64, good):
        written.write_bytes(good + tail)
        refused(written, "more than its arrays")


def test_random_damage_is_found(written: Path) -> None:
    """Blocks overwritten, removed, doubled, swapped."""
    good = written.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(500):
        a, b, c = np.sort(rng.integers(0, len(good) + 1, 3))
        for bad in (
            good[:a] + rng.bytes(b - a) + good[b:],
            good[:a] + good[b:],
            good[:b] + good[a:],
            good[:a] + good[b:c] + good[a:b] + good[c:],
        ):
            if bad != good:
                written.write_bytes(bad)
                refused(written)


def test_each_fault_is_named(written: Path) -> None:
    good = written.read_bytes()
    length = PREFIX.unpack(good[:20])[2]
    for bad, match in (
        (b"", "is empty"),
        (b"LGB", "is cut off after 3 bytes"),
        (b"PK\x03\x04" + good, "is not a bake"),
        (PREFIX.pack(MAGIC, 2, length) + good[20:], "has format version 2, this program reads version 1"),
        (PREFIX.pack(MAGIC, 1, MAX_HEADER + 1) + good[20:], "claims a header of 16777217 bytes"),
        (PREFIX.pack(MAGIC, 1, 2**64 - 1) + good[20:], "claims a header of 18446744073709551615 bytes"),
        (PREFIX.pack(MAGIC, 1, len(good)) + good[20:], "is cut off .* within its header"),
        (good[:30] + b"?" + good[31:], "checksum of its header"),
        (good[:-40] + b"????" + good[-36:], "checksum of its data"),
        (good[:-1] + bytes([good[-1] ^ 1]), "checksum of its data"),
        (good[:-80], "is cut off"),
    ):
        written.write_bytes(bad)
        refused(written, match)


def forged(path: Path, change: Callable[[dict[str, Any]], Any], data: bytes | None = None) -> None:
    """The file with a changed header (or any JSON text) and checksums that are right for it."""
    old = path.read_bytes()
    length = PREFIX.unpack(old[:20])[2]
    header = json.loads(old[20 : 20 + length])
    changed = change(header)
    text = changed if isinstance(changed, bytes) else json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    text += b" " * (-(52 + len(text)) % 64)
    head = PREFIX.pack(MAGIC, VERSION, len(text)) + text
    body = old[52 + length : -32] if data is None else data
    path.write_bytes(head + hashlib.sha256(head).digest() + body + hashlib.sha256(body).digest())


def entry(number: int, **values: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda header: header["arrays"][number].update(values)


def test_the_forger_makes_good_files(written: Path) -> None:
    """Or the tests below would show nothing."""
    good = written.read_bytes()
    forged(written, lambda header: None)
    assert written.read_bytes() == good
    forged(written, lambda header: header["metadata"].update(seed=4))
    assert read_bake(written)[0]["metadata"]["seed"] == 4


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (entry(0, offset=64), "'a' begins at byte 64 of the data, not 0"),
        (entry(1, offset=0), "'flags' begins at byte 0 of the data, not 64"),
        (entry(1, offset=-64), "begins at byte -64"),
        (entry(2, offset=10**30), "begins at byte 10000"),
        (entry(0, nbytes=-20), "'a' -20 bytes, its shape needs 20"),
        (entry(0, nbytes=24), "24 bytes, its shape needs 20"),
        (entry(0, shape=[6]), "20 bytes, its shape needs 24"),
        (entry(0, shape=[-5]), "the shape"),
        (entry(0, shape=[-5, -1]), "the shape"),
        (entry(0, shape=[5.0]), "the shape"),
        (entry(0, shape=[True] * 5), "the shape"),
        (entry(0, shape=[1] * 9), "the shape"),
        (entry(0, shape=[2**62]), "more than any machine holds"),
        (entry(0, shape=[2**62, 0], nbytes=0), "more than any machine holds"),
        (entry(0, shape=[2**31, 2**31, 2**31]), "more than any machine holds"),
        (
            entry(2, shape=[10**9], nbytes=8 * 10**9),
            "is cut off: array 'b' needs 8000000128 bytes of data, there are 200",
        ),
        (entry(2, shape=[8], nbytes=64), "holds 8 bytes more than its arrays"),
        (entry(1, name="a"), "two arrays named 'a'"),
        (entry(1, name=""), "type"),
        (entry(1, name=3), "describes an array"),
        (entry(0, dtype="O"), "type 'O'"),
        (entry(0, dtype="<f4"), "type '<f4'"),
        (entry(0, dtype="f2"), "type 'f2'"),
        (entry(0, dtype=["f4"]), "describes an array"),
        (entry(0, offset=False), "describes an array"),
        (entry(0, extra=1), "describes an array"),
        (lambda h: h["arrays"][0].pop("nbytes") and None, "describes an array"),
        (lambda h: h["arrays"].insert(0, None), "describes an array by None"),
        (lambda h: h["arrays"].clear(), "holds 200 bytes more"),
        (lambda h: h["arrays"].reverse(), "begins at byte 128"),
        (lambda h: h.update(arrays={}), "arrays is {}"),
        (lambda h: h.update(metadata=[]), "metadata is"),
        (lambda h: h.update(kind=None), "kind is None"),
        (lambda h: h.update(version=2), "another version"),
        (lambda h: h.update(version=1.0), r"version is 1\.0"),
        (lambda h: h.update(version=True), "version is True"),
        (lambda h: h.update(more=1), "exactly"),
        (lambda h: h.pop("scene") and None, "exactly"),
        (lambda h: b"[]", "exactly"),
        (lambda h: b"null", "exactly"),
        (lambda h: b"", "not JSON"),
        (lambda h: b"{", "not JSON"),
        (lambda h: b"\xff\xfe", "not JSON"),
        (lambda h: b"[" * 200_000, "not JSON"),
        (lambda h: b"1" * 10_000, "not JSON"),
        (lambda h: b'{"a":NaN}', "not JSON"),
        (lambda h: b'{"a":1e999}', "not JSON"),
        (lambda h: b'{"a":1,"a":1}', "canonical"),
        (lambda h: b'{"a": 1}', "canonical"),
        (lambda h: json.dumps(h).encode(), "canonical"),
    ],
)
def test_lies_under_a_right_checksum(written: Path, change: Callable[[dict[str, Any]], Any], match: str) -> None:
    forged(written, change)
    refused(written, match)


def test_padding_must_be_the_least(written: Path) -> None:
    forged(written, lambda header: json.dumps(header, sort_keys=True, separators=(",", ":")).encode() + b" " * 64)
    refused(written, "canonical")


def test_a_truth_value_must_be_one(written: Path) -> None:
    """NumPy computes nonsense with a bool that holds 2."""
    body = bytearray(written.read_bytes()[-232:-32])
    assert body[64:66] == b"\1\0"
    body[65] = 2
    forged(written, lambda header: None, bytes(body))
    refused(written, "neither true nor false in array 'flags'")


def test_what_is_no_file(tmp_path: Path) -> None:
    refused(tmp_path, "is a folder")
    refused(tmp_path / "absent.bake", "No such file")
    refused(tmp_path / ("x" * 300), "File name too long")
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", "not a regular file")  # and does not wait for a writer
    (tmp_path / "loop").symlink_to("loop")
    refused(tmp_path / "loop", "cannot be read")


@pytest.mark.parametrize(
    ("header", "match"),
    [
        ({}, "texts kind, scene, scene_hash"),
        (HEADER | {"extra": 1}, "texts"),
        (HEADER | {"kind": 3}, "texts"),
        (HEADER | {"metadata": []}, "object"),
        (HEADER | {"metadata": {"a": float("nan")}}, "finite JSON"),
        (HEADER | {"metadata": {"a": float("inf")}}, "finite JSON"),
        (HEADER | {"metadata": {"a": object()}}, "finite JSON"),
        (HEADER | {"metadata": {"a": np.float32(1)}}, "finite JSON"),
        (HEADER | {"metadata": {"a": 1, 2: 3}}, "finite JSON"),
        (HEADER | {"metadata": {2: 0, 10: 0}}, "texts as keys"),
        (HEADER | {"metadata": {"a": "x" * MAX_HEADER}}, "under 16777216 bytes"),
    ],
)
def test_headers_that_would_not_come_back(tmp_path: Path, header: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        write_bake(tmp_path / "a.bake", header, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dtype", ["f2", "i2", "u8", "c8", "O", "U3", "S4", "M8[s]", "i4,i4"])
def test_types_outside_the_list(tmp_path: Path, dtype: str) -> None:
    with pytest.raises(ValueError, match="array 'x' must be one of f4, f8, i4, i8, u1, u4, bool"):
        write_bake(tmp_path / "a.bake", HEADER, {"x": np.zeros(2, dtype)})
    assert not list(tmp_path.iterdir())


def test_names_and_axes_outside_the_limits(tmp_path: Path) -> None:
    for arrays in ({"": np.zeros(1)}, {3: np.zeros(1)}, {"x": np.zeros((1,) * 9)}):
        with pytest.raises(ValueError, match="with at most 8 axes and a name"):
            write_bake(tmp_path / "a.bake", HEADER, arrays)  # type: ignore[arg-type]


class Interrupting:
    """SHA-256 whose n-th update raises, as Ctrl-C or a full disk would at that point of the file."""

    def __init__(self, after: int, error: BaseException) -> None:
        self.left, self.error = after, error

    def __call__(self, data: bytes = b"") -> Any:
        real, outer = SHA256(data), self

        class Digest:
            def update(self, part: Any) -> None:
                outer.left -= 1
                if outer.left < 0:
                    raise outer.error
                real.update(part)

            def digest(self) -> bytes:
                return real.digest()

        return Digest()


@pytest.mark.parametrize("after", [0, 1, 5, 13])
@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device"), MemoryError()]
)
def test_an_interrupted_write_leaves_what_was_there(
    written: Path, monkeypatch: pytest.MonkeyPatch, after: int, error: BaseException
) -> None:
    old = written.read_bytes()
    kind = EnvironmentLacks if isinstance(error, OSError) else type(error)
    with monkeypatch.context() as patched:
        for name in (written.name, "new.bake"):
            patched.setattr(bake_file.hashlib, "sha256", Interrupting(after, error))
            with pytest.raises(kind):
                write_bake(written.with_name(name), HEADER, some_arrays())
    assert [p.name for p in written.parent.iterdir()] == [written.name] and written.read_bytes() == old


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_interrupted_at_the_end(written: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    old = written.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(bake_file.os if call == "fsync" else Path, call, interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_bake(written, HEADER, some_arrays())
    assert [p.name for p in written.parent.iterdir()] == [written.name] and written.read_bytes() == old


def test_synced_before_it_is_renamed(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rename that reaches the disk before its data leaves an empty file after a power cut."""
    order: list[str] = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(bake_file.os, "fsync", lambda handle: order.append("sync") or fsync(handle))
    monkeypatch.setattr(Path, "replace", lambda path, to: order.append("rename") or replace(path, to))
    write_bake(written, HEADER, some_arrays())
    assert order == ["sync", "rename", "sync"]  # the file, then its folder
    read_bake(written)


_ENDLESS = """
import signal
import sys
import numpy as np
from pathlib import Path
from lightgauge.reference.bake_file import write_bake
header = {"kind": "k", "scene": "s", "scene_hash": "h", "metadata": {}}
arrays = {str(i): np.full(1 << 16, i, np.float32) for i in range(16)}
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever starts tests in the background has it ignored
print("ready", flush=True)
while True:
    write_bake(Path(sys.argv[1]), header, arrays)
"""


@pytest.mark.parametrize("wait", [0.05, 0.083, 0.131])
def test_ctrl_c_at_any_moment(tmp_path: Path, wait: float) -> None:
    """A real SIGINT to a process that does nothing but write: a whole file, no other file."""
    path = tmp_path / "a.bake"
    write_bake(path, HEADER, {})
    command = [sys.executable, "-c", _ENDLESS, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None and child.stdout.readline() == b"ready\n"
            time.sleep(wait)
            child.send_signal(signal.SIGINT)
            error = child.communicate(timeout=60)[1]
        finally:
            child.kill()
    assert b"KeyboardInterrupt" in error
    assert [p.name for p in tmp_path.iterdir()] == ["a.bake"]
    read_bake(path)


def test_where_a_bake_cannot_be_written(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_text("mine")
    for path, match in (
        (tmp_path, "is not a file"),
        (plain / "a.bake", "cannot be written"),
        (tmp_path / ("x" * 300), "cannot be written .File name too long"),
        (Path(os.devnull), "is not a file"),
    ):
        with pytest.raises(InputError, match=match) as found:
            write_bake(path, HEADER, {})
        assert str(found.value).startswith(f"{path}: ") and "--out FILE" in str(found.value)
    assert plain.read_text() == "mine" and not Path(os.devnull).is_file()
    assert [p.name for p in tmp_path.iterdir()] == ["plain"]


def test_a_folder_is_made_and_a_link_followed(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.bake"
    write_bake(path, HEADER, {})
    link = tmp_path / "link.bake"
    link.symlink_to(path)
    write_bake(link, HEADER, {"x": np.arange(3.0)})
    assert link.is_symlink() and list(read_bake(path)[1]) == ["x"]


def test_others_may_read_it(written: Path) -> None:
    """As the umask says, not the 0600 of a private temporary file."""
    mask = os.umask(0)
    os.umask(mask)
    assert written.stat().st_mode & 0o777 == 0o666 & ~mask
