"""Results on a terminal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.summary import interval, number, results_table, where

Make = Callable[..., JsonObject]


def test_one_line_a_scene_and_why_one_failed(results: Make) -> None:
    made = results("cornell", "house")
    made["scenes"].append({"name": "valley", "status": "failed", "error": "vertex 1204 is NaN"})
    lines = results_table(made).splitlines()
    assert len(lines) == 6 and lines[4] == "± is one standard error"
    assert lines[0].split() == ["scene", "status", "relrmse", "floor_l1", "probes", "bake_s"]  # no leak: nobody has one
    assert lines[1].split()[:5] == ["cornell", "ok", "0.11", "±", "0.0033"]
    assert lines[5] == "valley: vertex 1204 is NaN"


def test_charts_alone_show_their_settings(results: Make, chart: Make) -> None:
    made = chart("cornell")
    for i, row in enumerate(made["rows"]):
        row["pareto"] = {"probes": i == 0, "bytes": False, "update_ms": i == 0}
    lines = results_table({**results(), "charts": [made]}).splitlines()
    assert len(lines) == 1 + 12 + 1
    assert lines[0].split() == [
        "scene",
        "method",
        "setting",
        "probes",
        "bytes",
        "update_ms",
        "sample_ns",
        "relrmse",
        "front",
    ]
    assert lines[1].split()[:4] == ["cornell", "uniform", "n=27", "27"] and lines[1].endswith("probes, update_ms")
    assert "± 0.006" in lines[1] and lines[2].endswith(" -")
    assert lines[-1].startswith("cornell: L1 floor 0.091 ± 0.002, reference noise 0.0171")


def test_a_chart_beside_scenes_does_not_hide_them(results: Make) -> None:
    assert results_table(results("cornell")).startswith("scene")
    assert "setting" not in results_table(results("cornell"))


def test_nothing_is_said_to_be_nothing(results: Make) -> None:
    assert results_table(results()) == "nothing was measured"
    bare = results_table({**results(), "charts": [{"scene": "a", "rows": []}]})
    assert "L1 floor -, reference noise -" in bare


def test_names_cannot_steer_the_terminal(results: Make, chart: Make) -> None:
    hostile = "a\x1b[2J\r\nb\u202e"
    made, drawn = results(hostile, charts=False), chart(hostile)
    drawn["rows"][0] |= {"method": hostile, "setting": hostile, "pareto": {hostile: True}}
    for table in (results_table(made), results_table({**results(), "charts": [drawn]})):
        assert not set("\x1b\r\u202e") & set(table)


def test_numbers() -> None:
    assert [number(v) for v in (3, 0.123456, 1e-9, None, True, float("nan"))] == ["3", "0.1235", "1e-09", "-", "-", "-"]
    assert interval({"value": 0.5, "se": 0.0}) == "0.5" and interval({"value": 0.5, "se": 0.25}) == "0.5 ± 0.25"


def test_the_page_is_named_where_there_is_one(tmp_path: Path) -> None:
    assert where(tmp_path) == f"results: {tmp_path / 'results.json'}"
    (tmp_path / "index.html").write_text("")
    assert where(tmp_path) == f"page: {tmp_path / 'index.html'}"
