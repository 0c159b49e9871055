"""The record: what may be in it, that it is written whole or not at all, and what a corrupt one is answered with."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.validation import record


def minimal(**scene: object) -> record.JsonObject:
    return {"schema": 1, "provenance": {}, "scenes": [{"name": "a", "status": "ok", **scene}]}


def test_metric_refuses_what_could_not_be_measured() -> None:
    assert record.metric(0.5, 0.1, 7, unit="m") == {"value": 0.5, "se": 0.1, "n": 7, "unit": "m"}
    assert record.metric(0.5, None, 7) == {"value": 0.5, "n": 7}
    for value, se in ((np.nan, 0.1), (np.inf, 0.1), (0.5, np.nan), (0.5, np.inf), (0.5, -1.0)):
        assert record.metric(value, se, 7) is None


def test_the_schema_file_is_that_of_the_models() -> None:
    written = json.loads(record.SCHEMA_FILE.read_text(encoding="utf-8"))
    assert written == record.results_json_schema(), "run: python -m lightgauge.validation.record"
    jsonschema.Draft202012Validator.check_schema(written)
    jsonschema.validate(minimal(metrics={"x": record.metric(1.0, None, 3)}), written)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(minimal(metrics={"x": {"value": "1"}}), written)


def test_a_record_comes_back_as_it_was(tmp_path: Path) -> None:
    made = minimal(cost={"tiles": np.int64(4), "bake_s": np.float32(0.5)}, files={"page": Path("index.html")})
    record.write_json_atomic(tmp_path / "run" / "results.json", made)
    expected = minimal(cost={"tiles": 4, "bake_s": 0.5}, files={"page": "index.html"})
    assert record.load_results(tmp_path / "run") == expected
    assert record.load_results(tmp_path / "run" / "results.json") == expected


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, np.float32("nan")])
def test_nan_leaves_the_old_file_and_names_its_place(tmp_path: Path, bad: float) -> None:
    path = tmp_path / "results.json"
    record.write_json_atomic(path, minimal())
    with pytest.raises(ValueError, match=r"scenes\[0\]\.cost\.bake_s is NaN or infinite"):
        record.write_json_atomic(path, minimal(cost={"bake_s": bad}))
    assert record.load_results(path) == minimal()


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    record.write_bytes_atomic(path, b"old")
    with pytest.raises(KeyError), record.atomic_path(path) as temporary:
        temporary.write_bytes(b"half of the n")
        raise KeyError
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_new_files_are_as_readable_as_any_other(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"")
    record.write_bytes_atomic(tmp_path / "atomic", b"")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "Expecting value"),
        ('{"schema": 1, "scenes": [', "Expecting"),
        ("[1, 2]", "should be an object"),
        ('{"schema": 2, "provenance": {}, "scenes": []}', "schema 2, this version reads schema 1"),
        ('{"schema": 1, "provenance": {}}', "scenes"),
        (json.dumps(minimal(status="fine")), "scenes.0.status"),
        (json.dumps(minimal(metrics={"x": {"value": "1", "n": 1}})), "scenes.0.metrics.x.value"),
        (json.dumps(minimal(metrics={"x": {"value": float("nan"), "n": 1}})), "scenes.0.metrics.x.value"),
        (json.dumps(minimal(metrics={"x": {"value": 1e999, "n": 1}})), "scenes.0.metrics.x.value"),
        ("[" * 200_000, "nested too deeply"),
    ],
)
def test_a_corrupt_file_is_an_input_error_that_names_it(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "results.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        record.load_results(path)
    assert str(path) in str(caught.value) and said in str(caught.value)


def test_what_is_no_file_of_text_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x93")
    for path in (tmp_path / "missing.json", tmp_path, tmp_path / "binary.json"):
        with pytest.raises(InputError, match=str(tmp_path)):
            record.load_results(path)


def test_terminal_escapes_stay_text() -> None:
    assert "\x1b" not in record.dumps(minimal(error="\x1b[2J")) and "\\u001b" in record.dumps({"a": "\x1b"})


def test_a_process_that_dies_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    record.write_json_atomic(path, minimal())
    code = (
        "import os, sys; from pathlib import Path; from lightgauge.validation import record\n"
        "with record.atomic_path(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_bytes(b'half of the n')\n"
        "    os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False, timeout=60).returncode == 9
    assert record.load_results(path) == minimal()
    record.write_json_atomic(path, minimal(error="next"))
    assert record.load_results(path) == minimal(error="next")


def test_a_synced_file_is_renamed_only_when_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full when the data is synced: the old file stays, the half one goes."""
    path = tmp_path / "results.json"
    record.write_bytes_atomic(path, b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        record.write_bytes_atomic(path, b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
