"""The heat map scene × failure as SVG: the scene made for each failure in the first row, the bundled scenes below.

A cell of a scene shows which share of the limit is used, and under it the standard error of that share where the figure has one. A
figure under twice its standard error is not told from nothing: its cell is grey, whatever share it shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..report.svg import escaped, tag, text
from ..summary import number
from .catalogue import IDS
from .record import status_words

CELL, ROW, LEFT, TOP = 22.0, 25.0, 92.0, 26.0
BELOW_NOISE, SIGMAS = "#b9bec6", 2.0
STATUS_FILLS = {
    "pass": "#7cc796", "fails as stated": "#f0cf6b", "below noise": "#9dbbe6", "fail": "#e0685f", "crashed": "#8c2f2a",
    "out of scope": "#b9bec6",
}  # fmt: skip
# Share of the limit that is used, and the colour up to there.
STEPS = (
    (0.1, "#7cc796"),
    (0.5, "#b5dca0"),
    (1.0, "#eef0b0"),
    (3.0, "#f3c07a"),
    (10.0, "#e8895f"),
    (math.inf, "#d1554c"),
)


def draw_heat_map(record: Mapping[str, Any]) -> str:
    """One `<svg>`; a cell's title says what it holds. Nothing is drawn where a failure means nothing."""
    shown = [i for i in IDS if any(case["id"] == i for case in record["cases"])]
    column = {name: LEFT + CELL * k for k, name in enumerate(shown)}
    parts = [text(name, at + CELL / 2.0, TOP - 6.0, text_anchor="middle", font_size=9.0) for name, at in column.items()]
    parts.append(text("made for it", LEFT - 8.0, TOP + 14.0, text_anchor="end"))
    for case in record["cases"]:
        words = f"{case['id']} {case['title']}: {status_words(case)}; {case['why']}"
        parts.append(_cell(column[case["id"]], TOP, STATUS_FILLS[status_words(case)], words, ""))
    for k, scene in enumerate(record["scenes"]):
        y = TOP + ROW * (k + 1) + 6.0
        parts.append(text(scene["name"][:14], LEFT - 8.0, y + 14.0, text_anchor="end"))
        if scene.get("error"):
            parts.append(text(scene["error"][:150], LEFT + 4.0, y + 14.0))
        for name, found in scene["cells"].items():
            if name in column:
                words = f"{scene['name']}, {name}: {found['what']} {figure_words(found)}"
                parts.append(_cell(column[name], y, cell_fill(found), words, short(found["ratio"]), error_words(found)))
    width, height = LEFT + CELL * len(shown) + 4.0, TOP + ROW * (len(record["scenes"]) + 1) + 12.0
    return tag("svg", *parts, viewBox=f"0 0 {width:g} {height:g}", width=width, height=height, role="img", fill="currentColor",
               font_family="system-ui, sans-serif", font_size=12.0, aria_label="scenes against failures")  # fmt: skip


def is_noise(found: Mapping[str, Any]) -> bool:
    """Whether a cell's figure lies under SIGMAS of its own standard errors: of one that is better higher, what is missing from 1."""
    value = float(found["value"]) if found["better"] == "lower" else 1.0 - float(found["value"])
    return bool(found.get("se")) and value < SIGMAS * float(found["se"])


def cell_fill(found: Mapping[str, Any]) -> str:
    """Colour of a cell."""
    return BELOW_NOISE if is_noise(found) else fill_of(found["ratio"])


def figure_words(found: Mapping[str, Any]) -> str:
    """The figure, its standard error and its limit."""
    error = f" ± {number(float(found['se']))}" if found.get("se") else ""
    noise = ", below the noise" if is_noise(found) else ""
    return f"{number(float(found['value']))}{error}, limit {number(float(found['limit']))}{noise}"


def error_words(found: Mapping[str, Any]) -> str:
    """Standard error of the share of the limit, in at most five signs; nothing for figures without."""
    if not found.get("se"):
        return ""
    limit = float(found["limit"])
    return f"±{short(float(found['se']) / (limit if found['better'] == 'lower' else 1.0 - limit))}"


def fill_of(ratio: float) -> str:
    """Colour of a share of the limit."""
    return next(colour for most, colour in STEPS if ratio <= most)


def short(ratio: float) -> str:
    """A share of the limit in at most four signs."""
    if ratio < 0.005:
        return "0"
    return (
        f"{ratio:.2f}".lstrip("0")
        if ratio < 1.0
        else f"{ratio:.1f}"
        if ratio < 10.0
        else f"{ratio:.0f}"
        if ratio < 1000.0
        else "≫"
    )


def _cell(x: float, y: float, fill: str, words: str, inside: str, error: str = "") -> str:
    parts = [tag("title", escaped(words)), tag("rect", x=x, y=y, width=CELL - 1.0, height=ROW - 1.0, fill=fill, rx=2.0)]
    lines = [(inside, 8.5, 11.0 if error else 15.0), (error, 7.0, 20.5)]
    for written, size, down in lines:
        if written:
            middle = x + (CELL - 1.0) / 2.0
            parts.append(text(written, middle, y + down, text_anchor="middle", font_size=size, fill="#1b1f24"))
    return tag("g", *parts)
