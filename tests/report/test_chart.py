"""The Pareto front and the drawing of the chart."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.chart import draw_chart, fronts, pareto_front
from lightgauge.validation.report.svg import LogScale, padded, ticks


def test_front_of_known_points() -> None:
    cost, error = [1, 2, 3, 4, 2, 5], [9, 5, 5, 1, 7, 1]
    assert pareto_front(cost, error).tolist() == [True, True, False, True, False, False]
    assert pareto_front([2, 2], [3, 3]).tolist() == [True, True]
    assert pareto_front([1, np.nan, 2], [2, 0, np.nan]).tolist() == [True, False, False]
    assert pareto_front([], []).tolist() == []
    with pytest.raises(ValueError, match="equal shapes"):
        pareto_front([1, 2], [1])


def test_front_is_what_nothing_dominates() -> None:
    rng = np.random.default_rng(0)
    cost, error = rng.integers(0, 9, 60), rng.integers(0, 9, 60)
    for i, on in enumerate(pareto_front(cost, error)):
        beaten = any(
            c <= cost[i] and e <= error[i] and (c, e) != (cost[i], error[i]) for c, e in zip(cost, error, strict=True)
        )
        assert on != beaten


def test_same_input_same_bytes_and_no_style(chart: Callable[..., JsonObject]) -> None:
    drawn = draw_chart(chart())
    assert drawn == draw_chart(chart())
    assert "style" not in drawn and "nan" not in drawn
    root = ElementTree.fromstring(drawn)
    titles = [e.text or "" for e in root.iter("{http://www.w3.org/2000/svg}title")]
    assert sum("n=4913" in t for t in titles) == 3
    assert "L1 floor" in drawn and "9.10 %" in drawn.replace("\u00a0", " ")


def test_marks_stay_inside_the_drawing(chart: Callable[..., JsonObject]) -> None:
    made = chart()
    made["rows"][0]["relrmse"] = {"value": 0.0, "se": 0.5}
    made["rows"][1]["update_ms"] = 0.0
    made["rows"][2]["relrmse"]["se"] = None
    root = ElementTree.fromstring(draw_chart(made))
    _, _, width, height = (float(v) for v in root.attrib["viewBox"].split())
    for element in root.iter():
        assert 0 <= float(element.get("cx", "0")) <= width and 0 <= float(element.get("cy", "0")) <= height


@pytest.mark.parametrize("count", [0, 1])
def test_few_settings_are_no_trouble(chart: Callable[..., JsonObject], count: int) -> None:
    ElementTree.fromstring(draw_chart({"scene": "a", "rows": chart()["rows"][:count], "floor": None, "noise": None}))


def test_hostile_names_are_text(chart: Callable[..., JsonObject]) -> None:
    made = chart('</title><script>alert("x")</script>\x1b[2J')
    made["rows"][0] |= {"method": "<script>", "setting": '"><script>'}
    drawn = draw_chart(made)
    ElementTree.fromstring(drawn)
    assert "<script" not in drawn and "\x1b" not in drawn


@pytest.mark.parametrize("span", [(0.03, 0.6), (1e-6, 1e3), (0.9, 1.1), (27, 4913)])
def test_ticks_lie_within_and_are_few(span: tuple[float, float]) -> None:
    for binary in (False, True):
        found = ticks(*padded(list(span), 1.3), binary=binary)
        assert 1 <= len(found) <= 7 and found == sorted(found)
        assert all(re.fullmatch(r"[125]e[+-]\d+|3e[+-]\d+", f"{v:.0e}") for v in found if not binary)


def test_the_scale_is_logarithmic() -> None:
    scale = LogScale(1.0, 100.0, 0.0, 10.0)
    assert [scale(v) for v in (0.1, 1.0, 10.0, 100.0, 1e9)] == pytest.approx([0, 0, 5, 10, 10])


def test_no_words_lie_under_marks_or_beyond_the_edge(chart: Callable[..., JsonObject]) -> None:
    """The names of the bands stand in the margin, right of all panels; letters are taken as 0.62 of their height wide."""
    root = ElementTree.fromstring(draw_chart(chart()))
    width = float(root.attrib["viewBox"].split()[2])
    right = max(
        float(e.get("x", "0")) + float(e.get("width", "0")) for e in root.iter("{http://www.w3.org/2000/svg}rect")
    )
    for e in root.iter("{http://www.w3.org/2000/svg}text"):
        words, x = e.text or "", float(e.get("x", "0"))
        length = 0.62 * float(e.get("font-size", "13")) * len(words)
        start = x - {"end": 1.0, "middle": 0.5}.get(e.get("text-anchor", ""), 0.0) * length
        assert start >= 0.0 and start + length <= width, words
        assert x > right or words not in ("L1 floor", "reference", "noise", "9.10\u00a0%")


def test_error_bars_are_drawn_to_two_standard_errors(chart: Callable[..., JsonObject]) -> None:
    made = chart()
    made["rows"] = made["rows"][:1]
    root = ElementTree.fromstring(draw_chart(made))
    titled = next(g for g in root.iter("{http://www.w3.org/2000/svg}g") if "n=27" in (g.findtext("{*}title") or ""))
    path = titled.find("{*}path")
    assert path is not None
    low, high = (float(v) for v in re.findall(r"[,V](-?[\d.]+)", path.get("d", ""))[:2])
    spans = [e for e in root.iter("{http://www.w3.org/2000/svg}line") if e.get("stroke-dasharray")]
    floor, noise = sorted({float(e.get("y1", "0")) for e in spans})
    per_e = (noise - floor) / np.log(0.091 / 0.0171)
    value, se = made["rows"][0]["relrmse"]["value"], made["rows"][0]["relrmse"]["se"]
    assert abs(high - low) == pytest.approx(per_e * np.log((value + 2 * se) / (value - 2 * se)), abs=0.1)


def test_a_panel_of_sample_costs_where_any_is_known(chart: Callable[..., JsonObject]) -> None:
    """Other methods have marks of their own, the legend goes on in a second line, and every mark stays in its panel."""
    made = chart()
    methods = ("adaptive", "uniform", "per_mesh", "chebyshev", "ratio_l1", "fixed_point", "something else")
    for i, row in enumerate(made["rows"]):
        row |= {"method": methods[i % len(methods)], "sample_ns": None if i == 3 else 20.0 + 7.0 * i, "remark": "noted"}
    root = ElementTree.fromstring(draw_chart(made))
    panels = [e for e in root.iter("{http://www.w3.org/2000/svg}rect") if e.get("fill") == "none"]
    words = [e.text for e in root.iter("{http://www.w3.org/2000/svg}text")]
    titles = [e.text or "" for e in root.iter("{http://www.w3.org/2000/svg}title")]
    assert sum(w == "sample cost" for w in words) == 1 and any(w == "100 ns" for w in words)
    framed = sorted({(float(e.get("x", "0")), float(e.get("width", "0"))) for e in panels if e.get("height") == "380"})
    assert len(framed) == 4 and all(a + w < b for (a, w), (b, _) in pairwise(framed))
    assert sum("n=27:" in t for t in titles) == 4
    assert sum("sample" in t and "noted" in t for t in titles) == 4 * (len(made["rows"]) - 1)
    shapes = {e.get("points", "").count(" ") for e in root.iter("{http://www.w3.org/2000/svg}polygon")}
    assert len(shapes) >= 3
    right = float(root.attrib["viewBox"].split()[2])
    legend = [e for e in root.iter("{http://www.w3.org/2000/svg}text") if float(e.get("y", "99")) < 44]
    assert len({e.get("y") for e in legend}) == 2
    assert all(float(e.get("x", "0")) + 0.5 * 13 * len(e.text or "") < right for e in legend)
    on = fronts(made["rows"])
    assert set(on) == {"probes", "bytes", "update", "sample"} and not on["sample"][3]
