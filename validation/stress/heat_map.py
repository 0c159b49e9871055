"""The heat map scene × failure as SVG: the scene made for each failure in the first row, the bundled scenes below.

A cell of a scene shows which share of the limit is used, and under it the standard error of that share where the figure has one. A
figure under twice its standard error is not told from nothing: its cell is grey, whatever share it shows. Failures stand in bands of
whole groups, one below the other, so that a page holds them at a size that can be read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from ..report.svg import escaped, tag, text
from ..summary import number
from .catalogue import IDS
from .record import status_words

CELL, ROW, LEFT, TOP, GAP = 32.0, 31.0, 92.0, 26.0, 14.0
MOST_COLUMNS = 34  # of a band: with LEFT no wider than the page
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
    shown = bands([i for i in IDS if any(case["id"] == i for case in record["cases"])])
    height = TOP + ROW * (len(record["scenes"]) + 1) + GAP
    parts = [part for k, names in enumerate(shown) for part in _band(record, names, TOP + height * k)]
    width, height = LEFT + CELL * max(map(len, shown), default=0) + 4.0, height * max(len(shown), 1)
    return tag("svg", *parts, viewBox=f"0 0 {width:g} {height:g}", width=width, height=height, role="img", fill="currentColor",
               font_family="system-ui, sans-serif", font_size=12.0, aria_label="scenes against failures")  # fmt: skip


def bands(names: Sequence[str]) -> list[list[str]]:
    """Names of failures in rows of at most MOST_COLUMNS; a group (its letter) stays together."""
    found: list[list[str]] = []
    for _, group in groupby(names, key=lambda name: name[0]):
        those = list(group)
        if found and len(found[-1]) + len(those) <= MOST_COLUMNS:
            found[-1] += those
        else:
            found.append(those)
    return found


def _band(record: Mapping[str, Any], names: Sequence[str], top: float) -> Iterator[str]:
    """The columns of `names`, their cells from `top` on."""
    column = {name: LEFT + CELL * k for k, name in enumerate(names)}
    for name, at in column.items():
        yield text(name, at + (CELL - 1.0) / 2.0, top - 6.0, text_anchor="middle", font_size=11.0)
    yield text("made for it", LEFT - 8.0, top + 19.0, text_anchor="end")
    for case in record["cases"]:
        if case["id"] in column:
            words = f"{case['id']} {case['title']}: {status_words(case)}; {case['why']}"
            yield _cell(column[case["id"]], top, STATUS_FILLS[status_words(case)], words, "")
    for k, scene in enumerate(record["scenes"]):
        y = top + ROW * (k + 1) + 6.0
        yield text(scene["name"][:14], LEFT - 8.0, y + 19.0, text_anchor="end")
        if scene.get("error"):
            yield text(scene["error"][:150], LEFT + 4.0, y + 19.0)
        for name, found in scene["cells"].items():
            if name in column:
                words = f"{scene['name']}, {name}: {found['what']} {figure_words(found)}"
                yield _cell(column[name], y, cell_fill(found), words, short(found["ratio"]), error_words(found))


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
    """Standard error of the share of the limit, in at most five signs; nothing for figures without, or where it rounds to 0."""
    if not found.get("se"):
        return ""
    limit = float(found["limit"])
    words = short(float(found["se"]) / (limit if found["better"] == "lower" else 1.0 - limit))
    return "" if words == "0" else f"±{words}"


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
    lines = [(inside, 12.0, 14.5 if error else 19.5), (error, 9.5, 25.5)]
    for written, size, down in lines:
        if written:
            middle = x + (CELL - 1.0) / 2.0
            parts.append(text(written, middle, y + down, text_anchor="middle", font_size=size, fill="#1b1f24"))
    return tag("g", *parts)
