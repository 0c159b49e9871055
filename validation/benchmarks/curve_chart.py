"""Error against time on the cube in a cube, both logarithmic: rays alone, the hybrid, and what others do. Drawn as SVG."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..report.svg import LogScale, escaped, padded, tag, text, ticks

WIDTH, HEIGHT = 760.0, 480.0
TOP, BOTTOM, LEFT, RIGHT = 76.0, 416.0, 84.0, 730.0
LEGEND_COLUMN = 260.0
RADIUS = 4.5
SERIES = {
    "rays": ("rays alone", "#cf6d10"),
    "hybrid": ("hybrid with closed forms", "#3b82d6"),
    "pyviewfactor": ("pyviewfactor, same run", "#2e9e5b"),
    "view3d": ("View3D 4.0, published figure on one core of another machine", "#8a8f98"),
}
VIEW3D = (0.22, 5.5e-6)  # seconds and rms per pair, as truth/README.md has it
CURVE = re.compile(r"boxinbox_((rays|hybrid)(?:_[0-9e-]+)?)_rms")
PAIRS = 204**2
Points = dict[str, list[tuple[float, float, str]]]


def curve_points(rows: Iterable[Mapping[str, Any]]) -> Points:
    """(seconds, rms, what it is called) by series, in order of time; only settings that have both rows."""
    values = {row["name"]: float(row["value"]) for row in rows}
    points: Points = {}
    for name, rms in values.items():
        match = CURVE.fullmatch(name)
        if match and f"boxinbox_{match[1]}_s" in values:
            called = match[1].replace("_", " ")
            points.setdefault(match[2], []).append((values[f"boxinbox_{match[1]}_s"], rms, called))
    speed, error = values.get("pyviewfactor_pairs_per_s"), values.get("pyviewfactor_rms")
    if points and speed and error:
        points["pyviewfactor"] = [(PAIRS / speed, error, "pyviewfactor")]
    return {series: sorted(found) for series, found in points.items()}


def draw_curve(rows: Iterable[Mapping[str, Any]]) -> str:
    """The picture as one `<svg>` document."""
    points = {**curve_points(rows), "view3d": [(*VIEW3D, "View3D 4.0")]}
    found = [p for series in points.values() for p in series]
    x = LogScale(*padded([p[0] for p in found], 1.5), LEFT, RIGHT)
    y = LogScale(*padded([p[1] for p in found], 1.5), BOTTOM, TOP)
    marks = [_series(name, points[name], x, y) for name in SERIES if name in points]
    return tag(
        "svg", tag("title", escaped("Error against time, cube in a cube, 204 patches")),
        tag("rect", width=WIDTH, height=HEIGHT, fill="#ffffff"), *_axes(x, y), *marks, *_legend(points),
        xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", role="img",
        font_family="system-ui, sans-serif", font_size=13.0, fill="#20242a", color="#20242a",
    )  # fmt: skip


def _axes(x: LogScale, y: LogScale) -> list[str]:
    parts = []
    for value in ticks(y.low, y.high):
        parts.append(_rule(LEFT, RIGHT, y(value), y(value)))
        parts.append(text(f"{value:.0e}".replace("e-0", "e-"), LEFT - 8, y(value) + 4, text_anchor="end"))
    for value in ticks(x.low, x.high):
        parts.append(_rule(x(value), x(value), TOP, BOTTOM))
        parts.append(text(f"{value:g} s", x(value), BOTTOM + 19, text_anchor="middle"))
    middle = (LEFT + RIGHT) / 2.0
    parts.append(text("time from mesh to form factors", middle, BOTTOM + 43, text_anchor="middle", font_weight="600"))
    parts.append(text("rms error per pair", 2.0, TOP - 16, font_weight="600"))
    return parts


def _rule(x1: float, x2: float, y1: float, y2: float) -> str:
    return tag("line", x1=x1, x2=x2, y1=y1, y2=y2, stroke="#20242a", stroke_opacity=0.15)


def _series(name: str, points: Sequence[tuple[float, float, str]], x: LogScale, y: LogScale) -> str:
    label, colour = SERIES[name]
    line = " ".join(f"{x(seconds):.2f},{y(rms):.2f}" for seconds, rms, _ in points)
    marks = [tag("polyline", points=line, fill="none", stroke=colour, stroke_width=1.6)] if len(points) > 1 else []
    for seconds, rms, called in points:
        said = tag("title", escaped(f"{called}: {rms:.2g} in {seconds:.3g} s"))
        marks.append(tag("g", said, _dot(name, x(seconds), y(rms))))
    return tag("g", tag("title", escaped(label)), *marks)


def _dot(name: str, x: float, y: float) -> str:
    """Filled for what this run measured, hollow for what is quoted."""
    colour = SERIES[name][1]
    return tag("circle", cx=x, cy=y, r=RADIUS, fill="#ffffff" if name == "view3d" else colour, stroke=colour)


def _legend(points: Points) -> list[str]:
    parts = []
    for i, name in enumerate(name for name in SERIES if name in points):
        x, y = LEFT + LEGEND_COLUMN * (i % 2), 18.0 + 18.0 * (i // 2)
        parts += [_dot(name, x, y), text(SERIES[name][0], x + 10.0, y + 4.5, font_size=12.0)]
    return parts
