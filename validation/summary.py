"""Results as an aligned table on a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

COLUMNS = ("scene", "status", "relrmse", "floor_l1", "leak", "probes", "bake_s")
CHART_COLUMNS = ("scene", "method", "setting", "probes", "bytes", "update_ms", "sample_ns", "relrmse", "front")
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
    """`value ± se`, the value alone where no error applies, or a dash."""
    if not metric:
        return DASH
    se = metric.get("se")
    return number(metric.get("value")) + (f" ± {number(se)}" if se else "")


def results_table(results: Mapping[str, Any]) -> str:
    """One line a scene of a results object; a column nobody fills is left out. Why scenes failed follows.

    Without scenes, one line a charted setting; without either, that there is nothing.
    """
    if not results["scenes"]:
        return charts_table(results.get("charts", []))
    rows = [_row(scene) for scene in results["scenes"]]
    used = [i for i in range(len(COLUMNS)) if i < 2 or any(row[i] != DASH for row in rows)]
    text = table([[row[i] for i in used] for row in [list(COLUMNS), *rows]])
    text += "\n± is one standard error"
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


def charts_table(charts: Sequence[Mapping[str, Any]]) -> str:
    """One line a setting, and under each chart its L1 floor and the reference's noise.

    front: the costs (probes, bytes, update time, sample cost) at which no other setting is as good in both cost and error.
    """
    if not charts:
        return "nothing was measured"
    rows = [[plain(str(chart["scene"])), *_chart_row(row)] for chart in charts for row in chart["rows"]]
    limits = [
        f"{plain(str(chart['scene']))}: L1 floor {interval(chart.get('floor'))}, "
        f"reference noise {interval(chart.get('noise'))}; ± is one standard error"
        for chart in charts
    ]
    return "\n".join([table([list(CHART_COLUMNS), *rows]), *limits])


def _chart_row(row: Mapping[str, Any]) -> list[str]:
    on = [cost for cost, front in row.get("pareto", {}).items() if front]
    return [
        plain(str(row["method"])),
        plain(str(row["setting"])),
        number(row.get("probes")),
        number(row.get("bytes")),
        number(row.get("update_ms")),
        number(row.get("sample_ns")),
        interval(row.get("relrmse")),
        ", ".join(plain(str(cost)) for cost in on) or DASH,
    ]


def where(out: Path) -> str:
    """The line that says where the results lie."""
    page = out / "index.html"
    return f"page: {page}" if page.is_file() else f"results: {out / 'results.json'}"


def bake_text(made: Mapping[str, Any]) -> str:
    """What a bake holds and how far its form factors can be trusted."""
    facts, receivers = made["facts"], made["receivers"]
    rows = [["receivers", "number", "rms error of a row"]]
    rows += [[plain(name), str(n), number(facts["rms_row_se"][name])] for name, n in receivers.items() if n]
    lines = [
        table(rows),
        f"reciprocity defect {number(facts['reciprocity_raw'])} of the rays, {number(facts['reciprocity'])} kept; "
        f"closure {number(facts['closure_averaged'])} averaged, {number(facts['closure'])} kept",
        f"rays: {facts['patch_rays']:,} for patches ({facts['patch_rays_if_uniform']:,} if all had the same), "
        f"{facts['probe_rays']:,} for probes ({facts['probe_rays_if_uniform']:,})",
        f"spectral radius {number(facts['spectral_radius'])}: {facts['bounces']} bounces settle the light",
        f"bake: {made['file']} ({made['bytes'] / 2**20:.1f} MiB)",
    ]
    return "\n".join([*lines, *(plain(note) for note in made["notes"])])


def relight_text(made: Mapping[str, Any]) -> str:
    """Mean, least and most light of every kind of receiver."""
    rows = [["receivers", "number", "mean (r, g, b)", "least", "most"]]
    for name, r in made["receivers"].items():
        cells = [" ".join(number(v) for v in r[key]) for key in ("mean", "min", "max")]
        rows.append([plain(name), str(r["count"]), *cells])
    cost = f"first frame {number(made['first_s'])} s with reading, later ones {number(made['frame_ms'])} ms"
    if made["moved_frame_ms"] is not None:
        cost += f", with all lights changed {number(made['moved_frame_ms'])} ms"
    where_to = f"{made['bounces']} bounces, {cost}\nvalues: {made['values']}"
    return "\n".join([table(rows), where_to, *(plain(note) for note in made["notes"])])
