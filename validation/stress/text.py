"""A stress record as text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..summary import number, plain, table, where
from .record import is_good, status_words

COLUMNS = ("id", "status", "failure", "measured", "breaks at", "s")
WIDEST = 46
WORST = ("fail", "below noise", "stated", "pass", "shown")


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
    cells = [
        case["id"],
        status_words(case),
        cut(case["title"]),
        cut(measured_words(case)),
        breaks_words(case),
        f"{case['seconds']:.1f}",
    ]
    return [plain(str(cell)) for cell in cells]


def measured_words(case: Mapping[str, Any]) -> str:
    """The curve that decides, from the first to the last value of the sweep."""
    curve = deciding(case)
    if curve is None:
        return ""
    known = [p for p in curve["points"] if p["value"] is not None]
    ends = known if len(known) == 1 else [known[0], known[-1]]
    return f"{curve['name']}: " + " … ".join(number(float(p["value"])) for p in ends)


def expected_words(case: Mapping[str, Any]) -> str:
    """The bands of the curve that decides."""
    curve = deciding(case)
    return "" if curve is None else bands_words(curve, "good") or bands_words(curve, "stated")


def deciding(case: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The first curve with a reading of the worst kind, None where no judged one was read."""
    curves = [c for c in case["curves"] if c["judged"] and any(p["value"] is not None for p in c["points"])]
    return min(curves, key=lambda c: min(WORST.index(p["status"]) for p in c["points"]), default=None)


def bands_words(curve: Mapping[str, Any], name: str) -> str:
    """A curve's bands `name` (good, stated) at the first and the last value that has one, once where they are the same."""
    bands = [band_words(p[name]) for p in curve["points"] if p.get(name)]
    if not bands:
        return ""
    return bands[0] if bands[0] == bands[-1] else f"{bands[0]} … {bands[-1]}"


def band_words(band: Mapping[str, Any]) -> str:
    """A band of the record in words."""
    low, high = band.get("low"), band.get("high")
    if low is None and high is None:
        return "anything"
    if low is None or high is None:
        return f"≤ {number(high)}" if low is None else f"≥ {number(low)}"
    if number(low) == number(high):
        return number(low) if low == high else f"{number(low)} ± {number((high - low) / 2.0)}"
    return f"{number(low)} to {number(high)}"


def breaks_words(case: Mapping[str, Any]) -> str:
    """Where a case breaks: the two neighbours where only whole values mean something, else the middle; else why not."""
    found = case.get("breaking") or {}
    if found.get("at") is None:
        return str(found.get("said", "")).split(":")[0]
    ends = (found["low"], found["high"])
    neighbours = ends[1] - ends[0] == 1.0 and all(float(end).is_integer() for end in ends)
    at = f"{number(ends[0])} to {number(ends[1])}" if neighbours else number(found["at"])
    return f"{at} {case['unit']}".strip()


def cut(words: str, most: int = WIDEST) -> str:
    """Words that fit into a column."""
    return words if len(words) <= most else words[: most - 1] + "…"


def _scene_line(scene: Mapping[str, Any]) -> str:
    if scene.get("error"):
        return plain(f"{scene['name']}: {scene['error']}")
    over = [f"{name} {number(cell['ratio'])}×" for name, cell in scene["cells"].items() if cell["ratio"] > 1.0]
    said = f"over the limit: {', '.join(over)}" if over else "nothing over its limit"
    return plain(f"{scene['name']}: {len(scene['cells'])} failures read; {said}")
