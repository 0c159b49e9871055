"""Results as an aligned table on a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

COLUMNS = ("scene", "status", "relrmse", "floor_l1", "leak", "probes", "bake_s")
DASH = "-"


def plain(text: str) -> str:
    """Text without control characters, so that a scene's name cannot steer the terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as left-aligned columns, two blanks apart."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def number(value: Any) -> str:
    """Four significant digits; a dash for what is absent or not a number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return DASH
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def interval(metric: Mapping[str, Any] | None) -> str:
    """`value ± se`, or a dash."""
    if not metric:
        return DASH
    se = metric.get("se")
    return number(metric.get("value")) + (f" ± {number(se)}" if se is not None else "")


def results_table(results: Mapping[str, Any]) -> str:
    """One line a scene of a results object; a column nobody fills is left out. Why scenes failed follows."""
    rows = [_row(scene) for scene in results["scenes"]]
    used = [i for i in range(len(COLUMNS)) if i < 2 or any(row[i] != DASH for row in rows)]
    text = table([[row[i] for i in used] for row in [list(COLUMNS), *rows]])
    failed = [scene for scene in results["scenes"] if scene["status"] != "ok"]
    reasons = [f"{plain(str(scene['name']))}: {plain(str(scene.get('error') or 'failed'))}" for scene in failed]
    return "\n".join([text, *reasons])


def _row(scene: Mapping[str, Any]) -> list[str]:
    metrics, cost = scene.get("metrics", {}), scene.get("cost", {})
    return [
        plain(str(scene["name"])),
        plain(str(scene["status"])),
        interval(metrics.get("relrmse")),
        interval(metrics.get("floor_l1")),
        interval(metrics.get("leak")),
        number(cost.get("real_probes")),
        number(cost.get("bake_s")),
    ]


def where(out: Path) -> str:
    """The line that says where the results lie."""
    page = out / "index.html"
    return f"page: {page}" if page.is_file() else f"results: {out / 'results.json'}"
