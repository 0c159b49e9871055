"""Speed against accuracy: relRMSE with its interval against probes, bytes, update time and sample cost, all logarithmic.

Drawn straight as SVG: the same input gives the same bytes, and the drawing suits a light and a dark page. Each mark is
a setting (its name appears under the pointer) with a bar of ± 2 standard errors, the stepped line the Pareto front, the
shaded bands what no L1 probe can reach (floor) and what the reference cannot tell (noise); they are named in the margin,
where no mark can cover the words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from .svg import LogScale, escaped, padded, tag, text, ticks
from .words import amount, percent

WIDTH, HEIGHT = 1140.0, 500.0
TOP, BOTTOM, LEFT, PANEL, GAP = 56.0, 436.0, 64.0, 300.0, 42.0
LINE = 15.0  # from one line of text to the next
WIDE = LEFT + 3 * PANEL + 2 * GAP  # where the last panel ends, however many there are
COSTS = (
    ("probes", "probes"),
    ("bytes", "bytes of the bake"),
    ("update_ms", "update time"),
    ("sample_ns", "sample cost"),
)
FRONTS = {"probes": "probes", "bytes": "bytes", "update_ms": "update", "sample_ns": "sample"}
METHODS = {
    "adaptive": ("virtual texture, octree", "#3b82d6", "circle"),
    "uniform": ("uniform grid", "#cf6d10", "square"),
    "l2": ("light of order 2", "#1b4f8f", "diamond"),
    "zh3": ("order 2 guessed, ZH3", "#5fa8e6", "bar"),
    "nonlinear": ("non-linear, Hazel", "#12806f", "post"),
    "per_mesh": ("one sample a mesh", "#2e9e5b", "triangle"),
    "chebyshev": ("eight loads with visibility", "#b0499f", "inverted"),
    "ratio_l1": ("L1 as ratios, 16 bytes", "#8d7a0b", "bowtie"),
    "fixed_point": ("8-bit fractions", "#c23b3b", "plus"),
}
OTHER = ("#8a8f98", "square")
# Corners in radii of a mark, y down.
POLYGONS = {
    "triangle": ((0.0, -1.2), (1.1, 0.8), (-1.1, 0.8)),
    "inverted": ((0.0, 1.2), (1.1, -0.8), (-1.1, -0.8)),
    "diamond": ((0.0, -1.2), (1.2, 0.0), (0.0, 1.2), (-1.2, 0.0)),
    "bowtie": ((-1.1, -1.0), (1.1, 1.0), (1.1, -1.0), (-1.1, 1.0)),
    "bar": ((-1.3, -0.5), (1.3, -0.5), (1.3, 0.5), (-1.3, 0.5)),
    "post": ((-0.5, -1.3), (0.5, -1.3), (0.5, 1.3), (-0.5, 1.3)),
    "plus": ((-0.4, -1.2), (0.4, -1.2), (0.4, -0.4), (1.2, -0.4), (1.2, 0.4), (0.4, 0.4), (0.4, 1.2), (-0.4, 1.2), (-0.4, 0.4),
             (-1.2, 0.4), (-1.2, -0.4), (-0.4, -0.4)),
}  # fmt: skip
TICK = 50.0  # least width for the words of one
Row = Mapping[str, Any]
Bands = list[tuple[str, float]]


def pareto_front(cost: npt.ArrayLike, error: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """(N,) costs and errors -> (N,) bool: no other setting is as good in both and better in one. NaN is never on it."""
    c, e = np.asarray(cost, np.float64).ravel(), np.asarray(error, np.float64).ravel()
    if c.shape != e.shape:
        raise ValueError(f"cost and error: expected equal shapes, got {c.shape} and {e.shape}")
    no_worse = (c[:, None] <= c[None, :]) & (e[:, None] <= e[None, :])
    better = (c[:, None] < c[None, :]) | (e[:, None] < e[None, :])
    front: npt.NDArray[np.bool_] = ~(no_worse & better).any(axis=0) & np.isfinite(c) & np.isfinite(e)
    return front


def draw_chart(chart: Mapping[str, Any]) -> str:
    """`ChartData` (see results.schema.json) -> one `<svg>` element, deterministic."""
    rows: Sequence[Row] = chart["rows"]
    bands: Bands = []
    for name, key in (("L1 floor", "floor"), ("reference\nnoise", "noise")):
        value = float((chart.get(key) or {}).get("value", 0.0))
        if value > 0.0:
            bands.append((name, value))
    y = LogScale(*_error_range(rows, bands), BOTTOM, TOP)
    shown = charted(rows)
    panels = [_panel(rows, shown, i, y, bands) for i in range(len(shown))]
    title = f"Relative RMS error against cost, {chart['scene']}"
    return tag(
        "svg", tag("title", escaped(title)), _legend(rows), *panels, *_band_names(bands, y),
        xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", class_="chart", role="img",
        font_family="system-ui, sans-serif", font_size=13.0, fill="currentColor",
    )  # fmt: skip


def _error_range(rows: Sequence[Row], bands: Bands) -> tuple[float, float]:
    values = [float(row["relrmse"]["value"]) for row in rows]
    return padded([v for v in values if v > 0.0] + [v for _, v in bands], 1.2)


def charted(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """The costs that a panel is drawn for, key and words: those that some row knows, or the first three where there is no row."""
    return [cost for i, cost in enumerate(COSTS) if i < 3 or any(row.get(cost[0]) is not None for row in rows)]


def _panel(rows: Sequence[Row], shown: Sequence[tuple[str, str]], index: int, y: LogScale, bands: Bands) -> str:
    key, label = shown[index]
    width = (WIDE - LEFT - (len(shown) - 1) * GAP) / len(shown)
    left = LEFT + index * (width + GAP)
    known = [row for row in rows if row.get(key) is not None]
    x = LogScale(*padded([float(row[key]) for row in known if float(row[key]) > 0.0], 1.5), left, left + width)
    parts = _bands(bands, x, y) + _axes(x, y, key, label, index == 0)
    mask = on_front(rows, key)
    parts.append(_front([row for row, on in zip(rows, mask, strict=True) if on], key, x, y))
    parts += [_mark(row, key, x, y) for row in known]
    return tag("g", *parts)


def on_front(rows: Sequence[Row], key: str) -> npt.NDArray[np.bool_]:
    """(N,) bool: on the front of cost `key`, as the record says, or worked out where it does not."""
    if all(key in row.get("pareto", {}) for row in rows):
        return np.array([row["pareto"][key] for row in rows], np.bool_)
    return pareto_front(costs(rows, key), [float(row["relrmse"]["value"]) for row in rows])


def costs(rows: Sequence[Row], key: str) -> npt.NDArray[np.float64]:
    """(N,) of one cost, NaN where a row does not know it."""
    return np.array([np.nan if row.get(key) is None else float(row[key]) for row in rows], np.float64)


def fronts(rows: Sequence[Row]) -> dict[str, npt.NDArray[np.bool_]]:
    """`on_front` for each cost, by a short name of the cost."""
    return {FRONTS[key]: on_front(rows, key) for key, _ in charted(rows)}


def _bands(bands: Bands, x: LogScale, y: LogScale) -> list[str]:
    parts = []
    for _, value in bands:
        at = y(value)
        parts.append(
            tag(
                "rect",
                x=x.start,
                y=at,
                width=x.end - x.start,
                height=BOTTOM - at,
                fill="currentColor",
                fill_opacity=0.07,
            )
        )
        parts.append(
            tag("line", x1=x.start, x2=x.end, y1=at, y2=at, stroke="currentColor", stroke_opacity=0.6,
                stroke_dasharray="5 4")
        )  # fmt: skip
    return parts


def _band_names(bands: Bands, y: LogScale) -> list[str]:
    """Name and value of each band, beside its line in the right margin, pushed down where they would touch."""
    x, free, parts = WIDE + 8.0, 0.0, []
    for name, value in sorted(bands, key=lambda band: -band[1]):
        at = max(y(value) + 4.0, free)
        for line in (*name.splitlines(), percent(value)):
            parts.append(text(line, x, at, font_size=12.0))
            at += LINE
        free = at + 4.0
    return parts


def _axes(x: LogScale, y: LogScale, key: str, label: str, first: bool) -> list[str]:
    parts = []
    for value in ticks(y.low, y.high):
        at = y(value)
        parts.append(tag("line", x1=x.start, x2=x.end, y1=at, y2=at, stroke="currentColor", stroke_opacity=0.13))
        if first:
            parts.append(text(f"{100.0 * value:g} %", x.start - 8, at + 4, text_anchor="end"))
    for value in ticks(x.low, x.high, binary=key == "bytes", most=int((x.end - x.start) / TICK)):
        at = x(value)
        parts.append(tag("line", x1=at, x2=at, y1=TOP, y2=BOTTOM, stroke="currentColor", stroke_opacity=0.13))
        parts.append(text(tick_label(key, value), at, BOTTOM + 19, text_anchor="middle"))
    parts.append(
        tag("rect", x=x.start, y=TOP, width=x.end - x.start, height=BOTTOM - TOP, fill="none", stroke="currentColor",
            stroke_opacity=0.4)
    )  # fmt: skip
    middle = (x.start + x.end) / 2.0
    parts.append(text(label, middle, BOTTOM + 43, text_anchor="middle", font_weight="600"))
    if first:
        parts.append(text("relRMSE", 2.0, TOP - 12, font_weight="600"))
    return parts


def tick_label(key: str, value: float) -> str:
    """A round value, written as briefly as it can be."""
    if key == "probes":
        return f"{value / 1000.0:g}k" if value >= 1000.0 else f"{value:g}"
    if key == "sample_ns":
        return f"{value:g} ns" if value < 1000.0 else f"{value / 1000.0:g} µs"
    return amount(key, value) if key == "bytes" else f"{value:g} ms" if value < 1000.0 else f"{value / 1000.0:g} s"


def _front(rows: Sequence[Row], key: str, x: LogScale, y: LogScale) -> str:
    points = sorted((x(max(float(r[key]), x.low)), y(max(float(r["relrmse"]["value"]), y.low))) for r in rows)
    if not points:
        return ""
    path = [f"M{points[0][0]:.2f},{points[0][1]:.2f}"]
    path += [f"H{b[0]:.2f}V{b[1]:.2f}" for _, b in pairwise(points)] + [f"H{x.end:.2f}"]
    return tag("path", d="".join(path), fill="none", stroke="currentColor", stroke_width=1.6, stroke_opacity=0.75)


def _mark(row: Row, key: str, x: LogScale, y: LogScale) -> str:
    value, se = float(row["relrmse"]["value"]), float(row["relrmse"].get("se") or 0.0)
    _, colour, shape = METHODS.get(row["method"], (row["method"], *OTHER))
    at, level = x(max(float(row[key]), x.low)), y(max(value, y.low))
    low, high = y(max(value - 2.0 * se, y.low)), y(max(value + 2.0 * se, y.low))
    said = (
        f"{row['method']}, {row['setting']}: {percent(value)} ± {percent(2.0 * se, 2)}, "
        f"{amount('probes', row['probes'])} probes, {amount('bytes', row['bytes'])}, "
        f"update {amount('update_ms', row['update_ms'])}"
    )
    if row.get("sample_ns") is not None:
        said += f", sample {amount('sample_ns', row['sample_ns'])}"
    said += f"; {row['remark']}" if row.get("remark") else ""
    title = tag("title", escaped(said))
    return tag("g", title, _shape(shape, at, level, colour, hollow=value <= 0.0), _bar(at, low, high, colour))


def _bar(x: float, low: float, high: float, colour: str) -> str:
    """An error bar with caps, over its mark: the mark is pale, so the bar shows even where it is shorter."""
    d = f"M{x:.2f},{low:.2f}V{high:.2f}M{x - 4:.2f},{low:.2f}h8M{x - 4:.2f},{high:.2f}h8"
    return tag("path", d=d, fill="none", stroke=colour, stroke_width=1.5)


def _shape(shape: str, x: float, y: float, colour: str, hollow: bool = False, r: float = 4.5) -> str:
    paint: dict[str, str | float] = {"fill": "none" if hollow else colour, "fill_opacity": 0.35, "stroke": colour}
    if shape == "circle":
        return tag("circle", cx=x, cy=y, r=r, **paint)
    if shape == "square":
        return tag("rect", x=x - r * 0.9, y=y - r * 0.9, width=r * 1.8, height=r * 1.8, **paint)
    return tag("polygon", points=" ".join(f"{x + r * a:.2f},{y + r * b:.2f}" for a, b in POLYGONS[shape]), **paint)


def _legend(rows: Sequence[Row]) -> str:
    parts, x, y = [], LEFT + 20.0, 14.0
    for method in dict.fromkeys(row["method"] for row in rows):
        label, colour, shape = METHODS.get(method, (method, *OTHER))
        width = 40.0 + 7.0 * len(label)
        if x + width > WIDTH:
            x, y = LEFT + 20.0, y + 20.0
        parts += [_shape(shape, x, y, colour), text(label, x + 12.0, y + 4.5)]
        x += width
    if x + 320.0 > WIDTH:
        x, y = LEFT + 20.0, y + 20.0
    parts.append(tag("line", x1=x, x2=x + 26.0, y1=y, y2=y, stroke="currentColor", stroke_width=1.6))
    parts += [text("Pareto front", x + 32.0, y + 4.5), text("bars: ± 2 standard errors", x + 138.0, y + 4.5)]
    return tag("g", *parts)
