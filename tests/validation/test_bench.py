"""What a bench is made of: repeats to rows, rows to JSON and exit codes, absent peers to notes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.progress import Progress, silent
from lightgauge.validation import cli
from lightgauge.validation.benchmarks import output, registry
from lightgauge.validation.benchmarks.curve_chart import curve_points, draw_curve
from lightgauge.validation.benchmarks.rows import CannotMeasure, Group, Row, Wanted, row_of
from lightgauge.validation.benchmarks.timing import interleaved, timed

Capture = pytest.CaptureFixture[str]
PROMISED = (
    "rays_vs_embree_2k", "rays_vs_embree_20k", "rays_time_exponent", "memory_vs_matrices", "relight_bandwidth_share",
    "relight_vs_scipy", "speed_vs_pyviewfactor", "error_vs_pyviewfactor", "boxinbox_hybrid_rms", "boxinbox_hybrid_s",
)  # fmt: skip


def test_median_and_half_the_interquartile_range() -> None:
    row = row_of("a", [1.0, 100.0, 3.0, 2.0, 4.0], "s", "lower", 2.5)
    assert (row.value, row.spread, row.n) == (3.0, 1.0, 5)  # quartiles 2 and 4: the outlier moves neither
    assert row_of("a", 7.0, "s", "lower").as_json() == {
        "name": "a", "value": 7.0, "unit": "s", "target": None, "better": "lower", "spread": 0.0, "n": 1,
    }  # fmt: skip


@pytest.mark.parametrize("bad", [[], [1.0, np.nan], [np.inf]])
def test_no_row_of_nothing(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="finite"):
        row_of("a", bad, "s", "lower")


@pytest.mark.parametrize(
    ("value", "better", "target", "missed"),
    [(0.8, "higher", 0.8, False), (0.79, "higher", 0.8, True), (1.1, "lower", 1.1, False), (1.2, "lower", 1.1, True),
     (9.0, "lower", None, False)],
)  # fmt: skip
def test_target(value: float, better: Any, target: float | None, missed: bool) -> None:
    assert Row("a", value, "", target, better, 0.0, 1).missed == missed


def test_interleaved() -> None:
    calls: list[tuple[str, int]] = []

    def task(name: str, repeat: int) -> float:
        calls.append((name, repeat))
        return 10.0 * repeat + len(name)

    tasks = {"a": lambda r: task("a", r), "bb": lambda r: task("bb", r)}
    found = interleaved(tasks, 3, silent, "stage")
    assert calls == [("a", -1), ("bb", -1), ("a", 0), ("bb", 0), ("bb", 1), ("a", 1), ("a", 2), ("bb", 2)]
    assert found["a"].tolist() == [1.0, 11.0, 21.0] and found["bb"].tolist() == [2.0, 12.0, 22.0]


def test_timed_runs_the_work() -> None:
    ran: list[int] = []
    assert timed(lambda: ran.append(1))(0) > 0.0 and ran == [1]


def good(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    progress("good", 1, 1)
    for name, target in (("fast", 0.5), ("exact", None), ("other", 0.5)):
        assert wanted <= {"fast", "exact", "other"}
        yield row_of(name, [0.6, 0.7, 0.8], "ratio", "higher", target, "a note")


def slow(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    yield row_of("slow", 0.4, "ratio", "higher", 0.5)


def absent(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    raise CannotMeasure("no \x1bpeer. To mend it: pip install peer")
    yield


@pytest.fixture
def benches(monkeypatch: pytest.MonkeyPatch) -> None:
    groups = (Group(("fast", "exact", "other"), good), Group(("slow",), slow), Group(("peer", "peer_error"), absent))
    monkeypatch.setattr(registry, "BENCHES", {"toy": lambda: groups})


@pytest.mark.usefixtures("benches")
def test_json(capsys: Capture) -> None:
    assert cli.main(["bench", "toy", "--json", "--quiet"]) == 1  # slow misses
    out, err = capsys.readouterr()
    made = json.loads(out)
    assert (made["schema"], made["bench"]) == (1, "toy")
    assert [row["name"] for row in made["rows"]] == ["fast", "exact", "other", "slow"]
    assert made["rows"][0] == {
        "name": "fast", "value": 0.7, "unit": "ratio", "target": 0.5, "better": "higher", "n": 3, "note": "a note",
        "spread": pytest.approx(0.05),
    }  # fmt: skip
    assert made["notes"] == ["not measured: peer, peer_error: no \x1bpeer. To mend it: pip install peer"]
    assert "not measured: peer, peer_error" in err and "\x1b" not in err


@pytest.mark.usefixtures("benches")
def test_exit_code_is_that_of_the_rows_asked_for(capsys: Capture) -> None:
    assert cli.main(["bench", "--row", "fast", "--row", "peer", "--json", "--quiet"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in made["rows"]] == ["fast"]
    assert [note.split(":")[1].strip() for note in made["notes"]] == ["peer"]
    assert cli.main(["bench", "--row", "slow", "--quiet"]) == 1


@pytest.mark.usefixtures("benches")
def test_table(capsys: Capture) -> None:
    assert cli.main(["bench", "--quiet"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["row", "value", "spread", "n", "target"]
    assert lines[1].split() == ["fast", "0.7", "ratio", "±", "0.05", "3", "≥", "0.5", "ok"]
    assert lines[2].split() == ["exact", "0.7", "ratio", "±", "0.05", "3", "-"]
    assert lines[4].split()[-1] == "MISS"
    assert "\x1b" not in "".join(lines) and any("peer_error: no ?peer" in line for line in lines)
    assert lines[-1] == "2 of 3 targets met"


@pytest.mark.usefixtures("benches")
@pytest.mark.parametrize(
    ("arguments", "says"), [(["nope"], "no bench 'nope'; known: toy"), (["toy", "--row", "fst"], "known: fast, exact")]
)
def test_unknown_names(arguments: list[str], says: str, capsys: Capture) -> None:
    assert cli.main(["bench", *arguments, "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err


def test_transport_has_the_promised_rows_once() -> None:
    names = [name for group in registry.transport() for name in group.names]
    assert set(PROMISED) <= set(names) and len(set(names)) == len(names)
    with pytest.raises(InputError, match="no bench"):
        registry.chosen(["transports"], [])


CURVE = [
    row_of("boxinbox_rays_256_rms", 3e-3, "per pair", "lower"), row_of("boxinbox_rays_256_s", 0.05, "s", "lower"),
    row_of("boxinbox_rays_1024_rms", 1e-3, "per pair", "lower"), row_of("boxinbox_rays_1024_s", 0.02, "s", "lower"),
    row_of("boxinbox_hybrid_1e-2_rms", 1e-4, "per pair", "lower"), row_of("boxinbox_hybrid_1e-2_s", 0.2, "s", "lower"),
    row_of("boxinbox_hybrid_rms", 1e-5, "per pair", "lower"), row_of("boxinbox_1920_rms", 5e-6, "per pair", "lower"),
    row_of("boxinbox_1920_s", 5.0, "s", "lower"),
    row_of("pyviewfactor_rms", 5e-4, "per pair", "lower"), row_of("pyviewfactor_pairs_per_s", 204**2 / 0.5, "1/s", "higher"),
]  # fmt: skip


def test_curve() -> None:
    points = curve_points([row.as_json() for row in CURVE])
    assert points["rays"] == [(0.02, 1e-3, "rays 1024"), (0.05, 3e-3, "rays 256")]
    assert points["hybrid"] == [
        (0.2, 1e-4, "hybrid 1e-2")
    ]  # the one without its time is no point, 1,920 quads are another scene
    assert points["pyviewfactor"] == [(pytest.approx(0.5), 5e-4, "pyviewfactor")]
    drawn = draw_curve([row.as_json() for row in CURVE])
    assert drawn == draw_curve([row.as_json() for row in CURVE]) and drawn.startswith("<svg ")
    assert "hybrid 1e-2: 0.0001 in 0.2 s" in drawn and "View3D 4.0: 5.5e-06 in 0.22 s" in drawn


@pytest.mark.usefixtures("benches")
def test_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    assert cli.main(["bench", "--row", "fast", "--out", str(tmp_path / "a"), "--quiet", "--json"]) == 0
    assert json.loads((tmp_path / "a" / "bench.json").read_text()) == json.loads(capsys.readouterr().out)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["bench.json"]  # no curve was measured
    written = output.write_files(tmp_path / "b", {"rows": [row.as_json() for row in CURVE]})
    assert [path.name for path in written] == ["bench.json", "boxinbox.svg"] and all(p.is_file() for p in written)
