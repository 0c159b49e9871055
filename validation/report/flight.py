"""A flight on the page: charts over its frames, its path from above with the places that pop most, figures, errors by level."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from ..record_models import JsonObject
from .leaks import ruler
from .svg import tag, text
from .words import Kind, amount, number, percent, written

BLUE, ORANGE, GREEN, RED = "#3b82d6", "#cf6d10", "#2e9e5b", "#d6604d"
COLUMNS, WIDTH, ROW = 4, 1140.0, 176.0
LEFT, GAP, TOP, HIGH = 46.0, 14.0, 40.0, 100.0
MAP_WIDTH, MAP_HEIGHT, FOOT, MARGIN = 720.0, 560.0, 34.0, 0.04
RADII, NUMBERED, APART = (0.8, 6.0), 5, 28.0  # pixels
FIGURES: tuple[tuple[str, str, Kind], ...] = (
    ("wrong_reads", "Tiles of another place that were read", "plain"),
    ("unexplained", "Samples unlike the whole texture, no tile missing", "plain"),
    ("twin_deviation", "Kernel beside its plain twin, told from the last viewer, of the mean light", "plain"),
    ("texel_deviation", "Texels of the cache at the end beside the plain filling", "plain"),
    ("pop", "Worst pop at a fixed point", "percent"),
    ("pop_blend", "Worst pop with blend", "percent"),
    ("pop_whole", "Worst pop with no tile ever missing", "percent"),
    ("pop_whole_blend", "Worst pop with blend and no tile missing", "percent"),
    ("pop_p99", "Mean over frames of the 99th percentile of pops", "percent"),
    ("pop_p99_blend", "Mean of the 99th percentiles with blend", "percent"),
    ("flicker", "Flicker", "percent"),
    ("flicker_blend", "Flicker with blend", "percent"),
    ("seen_pop", "Worst pop in the viewer's picture", "percent"),
    ("seen_pop_blend", "Worst pop in the picture with blend", "percent"),
    ("lag", "Longest wait of a fixed point for its light, frames", "plain"),
    ("lag_share", "Fixed points that ever waited", "percent"),
    ("relrmse_lod", "Error of levels of detail, in the picture", "percent"),
    ("relrmse_streaming", "Error of missing tiles, in the picture", "percent"),
    ("relrmse_both", "Both, against the finest level everywhere", "percent"),
    ("loaded", "Tiles loaded", "plain"),
    ("evicted", "Tiles evicted", "plain"),
    ("hit_share", "Wanted tiles that were there already", "percent"),
    ("frames_short", "Frames with tiles missing", "plain"),
    ("most_missing", "Most tiles missing", "plain"),
    ("fell_share", "Samples answered by a coarser tile", "percent"),
)
COSTS = ("bytes", "host_ms", "device_ms", "sample_ns")
COST_WORDS = {
    "bytes": "Bytes to the device a frame",
    "host_ms": "Move, host and device",
    "device_ms": "Move, device alone",
    "sample_ns": "Sample, owners checked",
}


@dataclass(frozen=True)
class Panel:
    """A small chart: title, and lines as (words, colour, column of the record, factor, dashed)."""

    title: str
    lines: Sequence[tuple[str, str, str, float, bool]]
    level: str = ""  # key of the table drawn as a level


PANELS = (
    Panel("Tiles", (("wanted", ORANGE, "wanted", 1.0, False), ("resident", BLUE, "resident", 1.0, False)), "budget"),
    Panel("Tiles a frame", (("loaded", BLUE, "loaded", 1.0, False), ("evicted", ORANGE, "evicted", 1.0, True))),
    Panel("Pop, %", (("without", ORANGE, "pop", 100.0, False), ("with blend", BLUE, "pop_blend", 100.0, False))),
    Panel("Pop, no tile missing, %",
          (("without", ORANGE, "pop_whole", 100.0, False), ("with blend", BLUE, "pop_whole_blend", 100.0, False))),
    Panel("Wrong reads", (("wrong", RED, "wrong_reads", 1.0, False), ("unexplained", BLUE, "unexplained", 1.0, True))),
    Panel("Points a coarser tile answers", (("fixed", BLUE, "fell", 1.0, False), ("in the picture", ORANGE, "seen_fell", 1.0, False))),
    Panel("KiB to the device", (("uploaded", BLUE, "bytes", 1.0 / 1024.0, False),)),
    Panel("Move, ms", (("all", ORANGE, "host_ms", 1.0, False), ("device", BLUE, "device_ms", 1.0, False))),
)  # fmt: skip


def flight_context(fly: Mapping[str, Any] | None) -> JsonObject | None:
    """What the template shows of a record's `fly` table; None where nothing was flown."""
    if not fly:
        return None
    summary = fly["summary"]
    return {
        "said": sentence(fly),
        "charts": Markup(draw_frames(fly)),
        "map": Markup(draw_path(fly)),
        "figures": [
            {"words": words, "value": _figure(float(summary[name]["value"]), kind), "n": f"{summary[name]['n']:,}"}
            for name, words, kind in FIGURES
            if name in summary
        ],
        "costs": [
            (COST_WORDS[k], amount(k, summary[f"{k}_median"]["value"]), amount(k, summary[f"{k}_most"]["value"]))
            for k in COSTS
            if f"{k}_median" in summary
        ],
        "levels": [_level(row) for row in fly["levels_used"]],
        "notes": fly["notes"],
    }


def _figure(value: float, kind: Kind) -> str:
    return percent(value) if kind == "percent" else f"{value:,.0f}"


def sentence(fly: Mapping[str, Any]) -> str:
    """The flight in a breath."""
    s = fly["summary"]
    wrong = int(s["wrong_reads"]["value"])
    checked = f"of {s['wrong_reads']['n']:,} samples"
    short = int(s["frames_short"]["value"])
    parts = [
        f"{fly['frames']:,} frames along {fly['path']}, {fly['budget']:,} tiles of budget in a world of {fly['tiles']:,}, of which",
        f"up to {int(s['most_wanted']['value']):,} are wanted at once; the finest level serves up to",
        f"{number(fly['lod_distance_m'])} m.",
        f"{wrong:,} {checked} read a tile of another place;"
        if wrong
        else f"None {checked} read a tile of another place;",
        f"in {short:,} frames tiles were missing, and coarser ones answered."
        if short
        else "no wanted tile was ever missing.",
    ]
    return " ".join(parts)


def _level(row: Mapping[str, Any]) -> JsonObject:
    def error(name: str) -> str:
        if not row.get(name):
            return ""
        return "below noise" if row[name].get("below_noise") else " ".join(written(row[name], "percent")).rstrip()

    return {
        "level": row["level"] or "none",
        "size": f"{number(row['voxel_m'])} m" if row.get("voxel_m") else "",
        "points": f"{row['points']:,}",
        "cells": [error(name) for name in ("relrmse", "relrmse_finest", "off_finest")],
    }


def draw_frames(fly: Mapping[str, Any]) -> str:
    """All panels as one SVG. The first frame, which fills an empty cache, is drawn in none but the first."""
    rows = -(-len(PANELS) // COLUMNS)
    width = (WIDTH - COLUMNS * (LEFT + GAP)) / COLUMNS
    parts = []
    for i, panel in enumerate(PANELS):
        x = (i % COLUMNS) * (width + LEFT + GAP) + LEFT
        parts += _panel(fly, panel, x, (i // COLUMNS) * ROW + TOP, width, 0 if i == 0 else 1)
    return tag("svg", *parts, viewBox=f"0 0 {WIDTH:g} {rows * ROW:g}", class_="chart", role="img", font_size=12.0,
               fill="currentColor", font_family="system-ui, sans-serif",
               aria_label="charts over the frames of the flight; figures in the table below")  # fmt: skip


def _panel(fly: Mapping[str, Any], panel: Panel, x: float, y: float, width: float, first: int) -> list[str]:
    columns = [[float(v) * factor for v in fly["per_frame"][name][first:]] for _, _, name, factor, _ in panel.lines]
    level = float(fly[panel.level]) if panel.level else None
    step, top = steps(max([v for c in columns for v in c] + ([] if level is None else [level])))
    frames = fly["frames"]

    def at(frame: float, value: float) -> tuple[float, float]:
        return x + width * frame / max(frames - 1, 1), y + HIGH * (1.0 - value / top)

    parts = [text(panel.title, x, y - 22.0, font_weight="600")]
    for i in range(round(top / step) + 1):
        _, py = at(0, i * step)
        parts.append(tag("line", x1=x, x2=x + width, y1=py, y2=py, stroke="currentColor", stroke_opacity=0.15))
        parts.append(text(f"{i * step:,g}", x - 6.0, py + 4.0, text_anchor="end", font_size=11.0))
    if level is not None:
        _, py = at(0, level)
        parts.append(tag("line", x1=x, x2=x + width, y1=py, y2=py, stroke=RED, stroke_dasharray="5 4"))
    for words, px, anchor in (("0", x, "start"), (f"frame {frames - 1}", x + width, "end")):
        parts.append(text(words, px, y + HIGH + 15.0, text_anchor=anchor, font_size=11.0))
    key = x
    named = [(words, colour) for words, colour, *_ in panel.lines] + ([(panel.level, RED)] if panel.level else [])
    for words, colour in named:
        parts.append(text(words, key, y - 7.0, fill=colour, font_size=11.0, font_weight="600"))
        key += 10.0 + 6.8 * len(words)
    for column, (_, colour, _, _, dashed) in zip(columns, panel.lines, strict=True):
        path = "M" + "L".join("{:.1f} {:.1f}".format(*at(first + k, v)) for k, v in enumerate(column))
        more: dict[str, str | float] = {"stroke_dasharray": "3 3"} if dashed else {}
        parts.append(tag("path", d=path, fill="none", stroke=colour, stroke_width=1.4, stroke_linejoin="round", **more))
    return parts


def steps(most: float, wanted: int = 4) -> tuple[float, float]:
    """A round step (1, 2 or 5 times a power of ten) and the whole number of them, at most `wanted`, that reach `most`; 1, 1 for 0."""
    if most <= 0.0:
        return 1.0, 1.0
    decade = 10.0 ** math.floor(math.log10(most / wanted))
    step = next(m * decade for m in (1.0, 2.0, 5.0, 10.0) if m * decade * wanted >= most * (1.0 - 1e-9))
    return step, step * math.ceil(most / step * (1.0 - 1e-9))


def draw_path(fly: Mapping[str, Any]) -> str:
    """From above: the watched points, larger and redder the more they pop, the path, and the frames with the worst pops numbered."""
    places, viewer = fly["places"], fly["viewer"]
    xs = [p[0] for p in places] + [v[0] for v in viewer]
    zs = [p[2] for p in places] + [v[2] for v in viewer]
    span = max(max(xs) - min(xs), max(zs) - min(zs), 1e-6)
    x0, z0 = min(xs) - MARGIN * span, min(zs) - MARGIN * span
    wide, deep = max(xs) - min(xs) + 2.0 * MARGIN * span, max(zs) - min(zs) + 2.0 * MARGIN * span
    scale = min(MAP_WIDTH / wide, MAP_HEIGHT / deep)
    height = deep * scale

    def at(x: float, z: float) -> tuple[float, float]:
        return (x - x0) * scale, (z - z0) * scale

    worst = max((p[3] for p in places), default=0.0)
    parts = [_dot(*at(x, z), math.sqrt(pop / worst) if worst > 0.0 else 0.0) for x, _, z, pop in places]
    jumps = fly["path"] == "teleport"
    track = "M" + "L".join("{:.1f} {:.1f}".format(*at(v[0], v[2])) for v in viewer)
    parts.append(
        tag(
            "path",
            d=track,
            fill="none",
            stroke=BLUE,
            stroke_width=1.0 if jumps else 2.5,
            stroke_opacity=0.5 if jumps else 0.9,
        )
    )
    parts += _worst_frames(fly["per_frame"]["pop"], [at(v[0], v[2]) for v in viewer])
    parts += ruler(wide, scale, height)
    label = f"from above: x to the right, z down; largest dot: {percent(worst)} in one frame"
    parts.append(text(label, MAP_WIDTH, height + 24.0, text_anchor="end", font_size=12.0, fill="currentColor"))
    return tag("svg", *parts, viewBox=f"0 0 {MAP_WIDTH:.0f} {height + FOOT:.0f}", width=MAP_WIDTH, height=height + FOOT, role="img",
               aria_label=f"the flight's path {label}")  # fmt: skip


def _dot(x: float, y: float, share: float) -> str:
    radius = RADII[0] + (RADII[1] - RADII[0]) * share
    fill = RED if share > 0.0 else "currentColor"
    return tag("circle", cx=x, cy=y, r=radius, fill=fill, fill_opacity=0.25 + 0.5 * share)


def _worst_frames(pops: Sequence[float], where: Sequence[tuple[float, float]]) -> list[str]:
    """Numbers at the frames with the largest pops, but none so close to a larger one that they would cover each other."""
    chosen: list[int] = []
    for frame in sorted(range(len(pops)), key=lambda k: -pops[k]):
        near = any(math.dist(where[frame], where[other]) < APART for other in chosen)
        if len(chosen) < NUMBERED and pops[frame] > 0.0 and not near:
            chosen.append(frame)
    return [part for frame in chosen for part in _mark(*where[frame], f"{frame}")]


def _mark(x: float, y: float, words: str) -> list[str]:
    ring = tag("circle", cx=x, cy=y, r=5.0, fill=BLUE, stroke="currentColor", stroke_width=1.0)
    return [ring, text(words, x + 8.0, y - 6.0, font_size=12.0, font_weight="700", fill="currentColor")]
