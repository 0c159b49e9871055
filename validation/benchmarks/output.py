"""A bench's result as a table on the terminal and as files: bench.json, and the error-time curve as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..record import write_bytes_atomic, write_json_atomic
from ..summary import DASH, number, plain, table
from .curve_chart import curve_points, draw_curve
from .registry import missed

COLUMNS = ("row", "value", "spread", "n", "target", "")


def as_text(result: dict[str, Any]) -> str:
    """One line a row: its median, half the interquartile range, repeats, target, and whether it is met."""
    if not result["rows"]:
        return "\n".join(["nothing was measured", *map(plain, result["notes"])])
    misses = set(missed(result))
    lines = [list(COLUMNS), *(_line(row, row["name"] in misses) for row in result["rows"])]
    judged = sum(row["target"] is not None for row in result["rows"])
    verdict = f"{judged - len(misses)} of {judged} targets met"
    meaning = "value: median of n repeats; spread: half their interquartile range; --json says what was measured"
    return "\n".join([table(lines), meaning, *map(plain, result["notes"]), verdict])


def _line(row: Mapping[str, Any], miss: bool) -> list[str]:
    target, verdict = DASH, ""
    if row["target"] is not None:
        target = f"{'≥' if row['better'] == 'higher' else '≤'} {number(row['target'])}"
        verdict = "MISS" if miss else "ok"
    value = f"{number(row['value'])} {row['unit']}"
    cells = [row["name"], value, f"± {number(row['spread'])}", str(row["n"]), target, verdict]
    return [plain(cell) for cell in cells]


def write_files(out: Path, result: dict[str, Any]) -> list[Path]:
    """bench.json, and boxinbox.svg where the curve was measured; returns what was written."""
    written = [out / "bench.json"]
    write_json_atomic(written[0], result)
    if curve_points(result["rows"]):
        written.append(out / "boxinbox.svg")
        write_bytes_atomic(written[1], draw_curve(result["rows"]).encode())
    return written
