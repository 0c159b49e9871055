"""A stress record as text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..summary import number, plain, table, where
from .record import is_good, status_words

COLUMNS = ("id", "status", "failure", "measured", "breaks at", "s")
WIDEST = 46


def stress_text(record: Mapping[str, Any], out: Path) -> str:
    """One line a case, why the bad ones are bad, the sum, and where the page is."""
    rows = [list(COLUMNS), *(_row(case) for case in record["cases"])]
    lines = [table(rows)]
    for case in record["cases"]:
        if case["status"] != "pass":
            lines.append(plain(f"{case['id']} {status_words(case)}: {case['why'].removeprefix('crashed: ')}"))
    for case in record["cases"]:
        if case.get("breaking"):
            lines.append(plain(f"{case['id']} breaks: {case['breaking']['said']}"))
    lines += [_scene_line(scene) for scene in record["scenes"]]
    counts = ", ".join(f"{count} {status}" for status, count in record["summary"].items())
    bad = [case["id"] for case in record["cases"] if not is_good(case)]
    lines.append(
        f"{len(record['cases'])} cases: {counts}" + (f"; not as they should be: {', '.join(bad)}" if bad else "")
    )
    lines.append(where(out))
    return "\n".join(lines)


def _row(case: Mapping[str, Any]) -> list[str]:
    breaking = case.get("breaking") or {}
    at = f"{number(breaking['at'])} {case['unit']}".strip() if breaking.get("at") is not None else ""
    cells = [
        case["id"],
        status_words(case),
        cut(case["title"]),
        cut(measured_words(case)),
        at,
        f"{case['seconds']:.1f}",
    ]
    return [plain(str(cell)) for cell in cells]


def measured_words(case: Mapping[str, Any]) -> str:
    """The first judged curve, from the first to the last value of the sweep."""
    for curve in case["curves"]:
        known = [p for p in curve["points"] if p["value"] is not None]
        if curve["judged"] and known:
            ends = [known[0]] if len(known) == 1 else [known[0], known[-1]]
            return f"{curve['name']}: " + " … ".join(number(float(p["value"])) for p in ends)
    return ""


def expected_words(case: Mapping[str, Any]) -> str:
    """The bands of the first judged curve, at the first and the last value where they differ."""
    for curve in case["curves"]:
        bands = [
            band_words(p.get("good") or p.get("stated")) for p in curve["points"] if p.get("good") or p.get("stated")
        ]
        if curve["judged"] and bands:
            return bands[0] if bands[0] == bands[-1] else f"{bands[0]} … {bands[-1]}"
    return ""


def band_words(band: Mapping[str, Any] | None) -> str:
    """A band of the record in words."""
    low, high = (band or {}).get("low"), (band or {}).get("high")
    if low is None and high is None:
        return "anything"
    if low is None or high is None:
        return f"≤ {number(high)}" if low is None else f"≥ {number(low)}"
    return number(low) if low == high else f"{number(low)} to {number(high)}"


def cut(words: str, most: int = WIDEST) -> str:
    """Words that fit into a column."""
    return words if len(words) <= most else words[: most - 1] + "…"


def _scene_line(scene: Mapping[str, Any]) -> str:
    if scene.get("error"):
        return plain(f"{scene['name']}: {scene['error']}")
    over = [f"{name} {number(cell['ratio'])}×" for name, cell in scene["cells"].items() if cell["ratio"] > 1.0]
    said = f"over the limit: {', '.join(over)}" if over else "nothing over its limit"
    return plain(f"{scene['name']}: {len(scene['cells'])} failures read; {said}")
