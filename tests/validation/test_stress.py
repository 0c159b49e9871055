"""The stress framework: verdicts, points of failure, workers that crash, hang or overeat, resuming, the record and its page."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.validation.cli import main
from lightgauge.validation.stress import catalogue, judge, record, system_cache, system_doors, text
from lightgauge.validation.stress.bisect import breaking
from lightgauge.validation.stress.case import Case, Curve, Reading, at_least, at_most, within
from lightgauge.validation.stress.catalogue import IDS, Entry
from lightgauge.validation.stress.heat_map import (
    BELOW_NOISE,
    MOST_COLUMNS,
    bands,
    cell_fill,
    draw_heat_map,
    error_words,
    figure_words,
    fill_of,
)
from lightgauge.validation.stress.on_scenes import cell, negative_share, of_record, rounding
from lightgauge.validation.stress.page import render
from lightgauge.validation.stress.runner import Runner

HOSTILE = """
import os, sys, time
from pathlib import Path
from lightgauge.validation.stress.case import Case, Curve, Reading, at_most

def counted(value, seed):
    path = Path(__file__).with_name("count")
    path.write_text((path.read_text() if path.exists() else "") + "x")
    print("chatter on standard output")
    return {"x": Reading(value * value, 0.01, 10)}

def aborts(value, seed):
    if value > 2:
        os.abort()
    return {"x": Reading(value)}

def hangs(value, seed):
    time.sleep(60)

def overeats(value, seed):
    bytearray(1 << 40)

def lies(value, seed):
    return {"y": Reading(value)}

def empty(value, seed):
    return {"x": Reading(float("nan"))}

def make(name, measure, **more):
    return Case(name, "t", "s", "p", "m", (1.0, 2.0, 3.0, 4.0), "x", (Curve("x", at_most(20.0), "why"),), measure, **more)

CASES = (make("X1", counted, breaks="x", limit=5.0), make("X2", aborts), make("X3", hangs, minutes=0.02), make("X4", overeats),
         make("X5", lies), make("X6", empty))
"""


def case(*curves: Curve, **more: Any) -> Case:
    """A case that is never run."""
    given: dict[str, Any] = {"values": (1.0, 2.0, 3.0), "measure": lambda value, seed: {}} | more
    return Case("A1", "t", "s", "p", "", given.pop("values"), "m", curves, given.pop("measure"), **given)


def status(curve: Curve, *readings: Reading) -> tuple[str, bool]:
    at = {float(i + 1): {curve.name: r} for i, r in enumerate(readings)}
    found = judge.judge(case(curve, values=tuple(at)), at)
    return found.status, found.as_stated


@pytest.mark.parametrize(
    ("reading", "expected"),
    [
        (Reading(0.9), "pass"),
        (Reading(1.1), "fail"),
        (Reading(1.1, 0.05, 100), "pass"),  # two standard errors over the edge prove nothing
        (Reading(1.5, 0.05, 100), "fail"),
        (Reading(0.9, 0.5, 100), "below noise"),
        (Reading(1.5, 0.5, 100), "below noise"),
        (Reading(float("nan")), "fail"),
        (Reading(0.5, float("inf")), "fail"),
    ],
)
def test_a_reading_against_a_limit(reading: Reading, expected: str) -> None:
    assert status(Curve("x", at_most(1.0), "why"), reading) == (expected, False)


def test_samples_that_would_tell() -> None:
    """z·se must shrink to the room, which is 1 here."""
    found = judge.judge(case(Curve("x", at_most(1.0), "why"), values=(1.0,)), {1.0: {"x": Reading(0.9, 0.5, 100)}})
    z = judge.sigmas(1)
    assert found.points[0].samples == pytest.approx(100 * (z * 0.5) ** 2, abs=1) and "samples would tell" in found.why
    better = Reading(0.9, 0.5 * (100 / (found.points[0].samples or 0)) ** 0.5, found.points[0].samples or 0)
    assert status(Curve("x", at_most(1.0), "why"), better)[0] == "pass"


def test_no_number_of_samples_tells_a_reading_on_an_edge_without_room() -> None:
    found = judge.judge(case(Curve("x", at_most(0.0), "why"), values=(1.0,)), {1.0: {"x": Reading(0.0, 0.1, 10)}})
    assert found.status == "below noise" and found.points[0].samples is None and "no number" in found.why


def test_failing_as_stated() -> None:
    curve = Curve("x", at_most(1.0), "why", stated=within(4.0, 6.0))
    assert status(curve, Reading(5.0)) == ("fail", True)
    assert status(curve, Reading(0.5)) == ("pass", False)
    assert status(curve, Reading(5.0), Reading(8.0)) == ("fail", False)
    assert status(curve, Reading(5.0), Reading(0.9, 0.5, 9)) == ("below noise", False)


def test_a_provocation_must_provoke() -> None:
    """A curve without `good` shows the failure without its fix."""
    curve = Curve("x", None, "why", stated=at_least(4.0))
    assert status(curve, Reading(5.0)) == ("pass", False) and status(curve, Reading(1.0)) == ("fail", False)


def test_a_judged_curve_that_is_never_read_fails() -> None:
    silent = case(Curve("x", at_most(1.0), "why"), Curve("y", None, "shown"))
    assert judge.judge(silent, {1.0: {"y": Reading(1.0)}}).status == "fail"


def test_readings_between_the_swept_values_are_not_judged() -> None:
    one = case(Curve("x", at_most(1.0), "why"), values=(1.0,))
    found = judge.judge(one, {1.0: {"x": Reading(0.5)}, 1.5: {"x": Reading(9.0)}})
    assert found.status == "pass" and [p.status for p in found.points] == ["pass", "shown"]


def test_more_points_need_more_sigmas() -> None:
    assert judge.sigmas(1) == pytest.approx(3.29, abs=0.01) and judge.sigmas(40) > 4.2


CURVE = Curve("x", at_most(1.0), "why")


@pytest.mark.parametrize(("log", "at"), [(False, 37.3), (True, 37.3), (True, 2.2)])
def test_the_point_of_failure_is_bracketed_to_a_twentieth_of_the_axis(log: bool, at: float) -> None:
    swept = case(CURVE, values=(1.0, 10.0, 100.0), log=log, breaks="x", limit=0.0)
    known = {v: Reading(v - at) for v in swept.values}
    found = breaking(swept, known, lambda v: Reading(v - at))
    assert found.low is not None and found.high is not None and found.low <= at <= found.high
    wide = found.high / found.low if log else found.high - found.low
    assert wide <= (100.0**0.05 if log else 0.05 * 99.0) * (1 + 1e-9) and 0 < len(found.looks) < 8


def test_without_a_bracket_a_sentence_says_so() -> None:
    swept = case(CURVE, breaks="x", limit=5.0)
    below = breaking(swept, {v: Reading(v) for v in swept.values}, lambda v: None)
    assert below.at is None and "never crosses 5 within p 1 to 3; it is not over" in below.said
    above = breaking(swept, {v: Reading(v + 9) for v in swept.values}, lambda v: None)
    assert "it is over it throughout" in above.said


def test_bisection_stops_where_noise_hides_the_limit_and_at_neighbours() -> None:
    swept = case(CURVE, values=(1.0, 100.0), breaks="x", limit=50.0)
    noisy = breaking(swept, {1.0: Reading(1.0), 100.0: Reading(100.0)}, lambda v: Reading(v, 5.0, 64))
    assert "noise hides the limit" in noisy.said and "n = 64" in noisy.said and len(noisy.looks) == 1
    whole = replace(swept, values=(1.0, 4.0), limit=2.5, whole=True)
    found = breaking(whole, {1.0: Reading(1.0), 4.0: Reading(4.0)}, Reading)
    assert (found.low, found.high) == (2.0, 3.0) and "neighbours" in found.said


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Entry]]:
    """Entries of a module that workers find, and a cache of its own."""
    (tmp_path / "hostile_cases.py").write_text(HOSTILE, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path / "cache"))
    space: dict[str, Any] = {"__file__": str(tmp_path / "hostile_cases.py"), "__name__": "hostile_cases"}
    exec(compile(HOSTILE, "hostile_cases.py", "exec"), space)

    def entries(*names: str) -> list[Entry]:
        return [Entry(c, f"hostile_cases:{c.id}") for c in space["CASES"] if c.id in names]

    return entries


def test_workers_that_crash_hang_or_overeat_fail_alone(hostile: Callable[..., list[Entry]], tmp_path: Path) -> None:
    entries = hostile("X1", "X2", "X3", "X4", "X5", "X6")
    finished: list[str] = []
    outcomes = Runner(0, jobs=2).run(entries, lambda entry, _: finished.append(entry.case.id))
    cases = {entry.case.id: record.case_record(entry.case, outcomes[entry.case.id]) for entry in entries}
    assert sorted(finished) == sorted(cases)
    assert cases["X1"]["status"] == "pass" and cases["X1"]["breaking"]["low"] < 5**0.5 < cases["X1"]["breaking"]["high"]
    assert {name for name, c in cases.items() if c["status"] == "crashed"} == {"X2", "X3", "X4", "X5"}
    assert cases["X2"]["crash"]["parameter"] == 3.0 and "Abort" in cases["X2"]["why"]
    assert [p["parameter"] for p in cases["X2"]["curves"][0]["points"]] == [1.0, 2.0]
    assert "time limit" in cases["X3"]["why"] and "MiB of memory" in cases["X4"]["why"]
    assert "none of its curves" in cases["X5"]["why"] and cases["X6"]["status"] == "fail"
    # What is finished is recalled, also by a run that was stopped; what crashed is tried again.
    count = (tmp_path / "count").read_text()
    again = Runner(0, jobs=1).run(hostile("X1", "X2"), lambda entry, outcome: None)
    assert (tmp_path / "count").read_text() == count and again["X1"]["recalled"] and not again["X2"]["recalled"]
    assert again["X1"]["readings"] == outcomes["X1"]["readings"]


def test_ctrl_c_kills_the_workers_and_keeps_what_is_finished(hostile: Callable[..., list[Entry]]) -> None:
    entries = [*hostile("X1"), *(replace(e, case=replace(e.case, minutes=0.5)) for e in hostile("X3"))]

    def stop(entry: Entry, outcome: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Runner(0, jobs=2).run(entries, stop)
    assert Runner(0, jobs=1).run(entries[:1], lambda entry, outcome: None)["X1"]["recalled"]
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=False).stdout
    assert "hostile_cases:X3" not in listed


def test_the_catalogue_holds_exactly_its_ids(request: pytest.FixtureRequest) -> None:
    there = catalogue.catalogue()
    assert tuple(there) == catalogue.IDS
    path = Path(__file__).resolve().parents[2] / ".." / "shared" / "failure-catalogue.md"
    if path.is_file():
        rows = re.findall(r"^\| ([A-G]\d+) \|", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert rows == [name for name in there if name[0] != "R"]


def test_the_catalogue_is_cheap() -> None:
    """Ids are checked before anything heavy is imported."""
    code = (
        "import sys\nfrom lightgauge.validation.stress.catalogue import catalogue\ncatalogue()\n"
        "sys.exit(bool({'mitsuba', 'drjit', 'pyopencl'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    "broken",
    [{"values": (2.0, 1.0)}, {"values": ()}, {"log": True, "values": (0.0, 1.0)}, {"breaks": "z"}, {"values": tuple(range(9))}],
)  # fmt: skip
def test_a_case_that_cannot_be_run_is_refused(broken: dict[str, Any]) -> None:
    catalogue.check_case(case(CURVE))
    with pytest.raises(ValueError, match="stress case A1"):
        catalogue.check_case(case(CURVE, **broken))


def test_a_case_that_cannot_fail_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot fail"):
        catalogue.check_case(case(Curve("x", None, "shown")))


def test_unknown_ids_name_near_ones(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["stress", "G11", "--out", str(tmp_path / "o")]) == 2
    assert "near: G1" in capsys.readouterr().err and not (tmp_path / "o").exists()
    assert main(["stress", "A1", "--faults", "--out", str(tmp_path / "o")]) == 2
    with pytest.raises(InputError, match="known: A1 to A11"):
        catalogue.chosen(["zzz"])
    assert [e.case.id for e in catalogue.chosen(["g"])] == [f"G{n}" for n in range(1, 11)]
    assert [e.case.id for e in catalogue.chosen(["g3", "G1", "G3"])] == ["G1", "G3"]


@pytest.fixture
def made() -> Iterator[dict[str, Any]]:
    """A record with every status, hostile words, and a scene."""
    outcome = {
        "readings": [],
        "breaking": None,
        "crash": None,
        "seconds": 1.0,
        "cpu_s": 1.0,
        "peak_mib": 9.0,
        "recalled": False,
    }
    curves = (Curve("x", at_most(1.0), "<b>why", stated=within(4.0, 6.0)), Curve("y", None, "free"))
    bad = "</script><script>alert(1)</script>\x1b[31m"
    cases = []
    for name, value, se in (("A1", 0.5, 0.0), ("A2", 5.0, 0.1), ("A3", 0.9, 0.5), ("A4", 9.0, 0.0)):
        readings = [{"value": v, "readings": {"x": {"value": value, "se": se, "n": 4}, "y": {"value": None, "se": None, "n": 1}}}
                    for v in (1.0, 2.0)]  # fmt: skip
        one = replace(case(*curves, values=(1.0, 2.0), log=True), id=name, title=bad, breaks="x")
        at = {"low": 1.0, "high": 2.0, "at": 1.5, "said": bad, "looks": []}
        cases.append(record.case_record(one, {**outcome, "readings": readings, "breaking": at}))
    crash = {"value": 1.0, "why": bad, "stderr": bad}
    cases.append(record.case_record(replace(case(CURVE), id="A5"), {**outcome, "crash": crash}))
    cases.append(record.case_record(replace(case(CURVE), id="A6", out_of_scope=bad), outcome))
    scenes = [{"name": bad, "cells": {"A3": cell(2.0, 0.1, 1.0, bad)}}, {"name": "s", "cells": {}, "error": bad}]
    yield record.stress_record({"command": bad}, cases, scenes)


def test_the_record_fits_its_schema(made: dict[str, Any]) -> None:
    schema = json.loads(record.SCHEMA_FILE.read_text(encoding="utf-8"))
    assert schema == json.loads(json.dumps(record.stress_json_schema())), (
        "run python -m lightgauge.validation.stress.record"
    )
    jsonschema.validate(made, schema)
    statuses = ["pass", "fails as stated", "below noise", "fail", "crashed", "out of scope"]
    assert made["summary"] == dict.fromkeys(statuses, 1)
    assert not made["good"]


def test_the_page_shows_every_case_and_is_harmless(made: dict[str, Any]) -> None:
    html = render(made)
    page = system_doors.Elements(html)
    assert page.scripts == page.active == 0 and "\x1b" not in html and "default-src 'none'" in page.policy
    for name in ("A1", "A2", "A3", "A4", "A5", "A6"):
        assert f'id="{name}"' in html
    assert html.count("<svg") > 6 and draw_heat_map(made) == draw_heat_map(made)


def test_cells_show_their_noise() -> None:
    """The share of the limit, its standard error beneath, and grey where the figure is under twice that."""
    clear, lost = cell(2.0, 0.1, 4.0, "x"), cell(2.0, 1.1, 4.0, "x")
    assert cell_fill(clear) == fill_of(0.5) and cell_fill(lost) == BELOW_NOISE != cell_fill(clear)
    assert error_words(clear) == "±.03" and error_words(cell(2.0, None, 4.0, "x")) == ""
    assert "± 0.1" in figure_words(clear) and figure_words(lost).endswith("below the noise")
    share = cell(0.999, 0.01, 0.99, "x", "higher")  # what is missing from 1 is what noise may hide
    assert cell_fill(share) == BELOW_NOISE and error_words(share) == "±1.00"
    assert error_words(cell(2.0, 1e-3, 4.0, "x")) == ""  # nothing that could be written


def test_the_heat_map_fits_the_page(made: dict[str, Any]) -> None:
    """All failures there are in bands of whole groups, none wider than the page; each case and each figure once."""
    rows = bands(IDS)
    assert [name for row in rows for name in row] == list(IDS) and max(map(len, rows)) <= MOST_COLUMNS
    assert all(a[-1][0] != b[0][0] for a, b in pairwise(rows))
    all_of_them = [{**made["cases"][0], "id": name} for name in IDS]
    figures = {name: cell(0.123, None, 1.0, "x") for name in IDS}
    drawn = draw_heat_map({"cases": all_of_them, "scenes": [{"name": "room", "cells": figures}]})
    assert drawn.count("<title>") == 2 * len(IDS) and drawn.count(">.12<") == len(IDS)
    assert float(drawn.split(' width="')[1].split('"')[0]) <= 1216.0  # page.css: 1280 px less its padding


def test_a_case_is_told_by_the_curve_that_decides_it(made: dict[str, Any]) -> None:
    sound, bad = Curve("a", at_most(1.0), "why"), Curve("b", within(1.0, 1.0 + 1e-9), "why", stated=at_least(2.0))
    readings = {v: {"a": Reading(0.5), "b": Reading(b)} for v, b in ((1.0, 1.0), (2.0, 3.0))}
    found = judge.judge(case(sound, bad, values=(1.0, 2.0)), readings)
    told = {"curves": [record._curve(c.name, c.reason, True, found.points) for c in (sound, bad)], "unit": "m"}
    assert text.measured_words(told) == "b: 1 … 3" and text.expected_words(told) == "1 ± 5e-10"
    assert text.breaks_words({**told, "breaking": {"low": 16.0, "high": 17.0, "at": 16.5, "said": "x"}}) == "16 to 17 m"
    assert text.breaks_words({**told, "breaking": {"said": "no bracket: why"}}) == "no bracket"
    assert "good ≤ 1; where the method fails 4 to 6" in render(made)


def test_figures_of_a_record() -> None:
    given = {
        "metrics": {"leak": {"value": 2e-3, "n": 9}, "validity_auc": {"value": 0.97, "se": 0.01, "n": 9}},
        "cost": {},
    }
    found = dict(of_record(given))
    assert (
        found["C7"]["ratio"] == pytest.approx(2.0)
        and found["C4"]["ratio"] == pytest.approx(3.0)
        and set(found) == {"C4", "C7"}
    )


def test_what_is_read_off_probes() -> None:
    import numpy as np

    light = np.zeros((4, 4, 3))
    light[:, 0] = 1.0
    light[0, 1, 2] = 0.87  # |A1 Y1| / (A0 Y0) = 1.1547: negative over 0.866
    light[1, 1, 2] = 0.86
    assert negative_share(light)[0] == 0.25
    assert rounding(np.array([1.0, 3.0]), 1e-6) == 0.0
    assert 0.0 < rounding(1.0 + np.random.default_rng(0).random(100), 1e-6) <= 2.0**-11


def verdict(name: str, *values: float) -> str:
    """The status of a case of this catalogue at some of its values."""
    one = replace(catalogue.group(name[0])[name].case, values=values)
    return judge.judge(one, {v: dict(one.measure(v, 0)) for v in values}).status


def test_hostile_paths_and_names() -> None:
    assert verdict("G9", 100.0) == "pass" and verdict("G3", 2.0) == "pass"


def test_page_that_does_not_escape_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    from jinja2 import Environment
    from lightgauge.validation.report import page

    def careless() -> Environment:
        made = original()
        made.autoescape = False
        return made

    original = page.environment
    monkeypatch.setattr(page, "environment", careless)
    assert verdict("G9", 100.0) == "fail"


def test_checksums_that_are_not_looked_at_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict("G8", 1.0) == "pass"
    monkeypatch.setattr("lightgauge.validation.cache.load", lambda kind, name: {"light": None})
    monkeypatch.setattr(system_cache, "stale", lambda: 0)
    assert verdict("G8", 1.0) == "fail"


def test_an_old_llvm_that_is_taken_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict("G10", 16.0, 17.0) == "pass", "whole runs are only wanted at the oldest"
    monkeypatch.setattr("lightgauge.reference.variant.MIN_LLVM", 15)
    assert verdict("G10", 16.0) == "fail"
