"""A case drawn: its curves over the swept parameter, the bands they should keep to, and where it breaks.

Straight SVG with presentation attributes only, as the rest of the report: the same record gives the same bytes. Readings of 0 on a
logarithmic axis stand on its floor, hollow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..report.svg import LogScale, escaped, tag, text, ticks
from ..summary import number

WIDTH, HEIGHT = 560.0, 250.0
LEFT, RIGHT, TOP, BOTTOM = 66.0, 548.0, 12.0, 206.0
COLOURS = ("#3b82d6", "#cf6d10", "#2e9e5b", "#b0499f", "#8d7a0b", "#c23b3b", "#12806f", "#6b6bd6", "#5f6b78", "#d98cb3")
SPREAD = 30.0  # from this ratio on, an axis of readings is logarithmic
GRID: dict[str, str | float] = {"stroke": "currentColor", "stroke_opacity": 0.13}
Point = Mapping[str, Any]
Scale = Callable[[float], float]


def draw_case(case: Mapping[str, Any]) -> str:
    """One `<svg>` of a case of the record; empty text where nothing was read."""
    points = [p for curve in case["curves"] for p in curve["points"] if p["value"] is not None]
    if not points:
        return ""
    x, x_ticks = _x_axis(case, points)
    y, y_ticks, floor = _y_axis(points)
    parts = _frame(case, x, x_ticks, y, y_ticks, floor)
    for i, curve in enumerate(case["curves"]):
        parts += _bands(curve["points"], x, y, COLOURS[i % len(COLOURS)])
    at = (case.get("breaking") or {}).get("at")
    if at is not None:
        parts.append(tag("line", x1=x(at), x2=x(at), y1=TOP, y2=BOTTOM, stroke="#c23b3b", stroke_dasharray="3 3",
                         stroke_width=1.5))  # fmt: skip
    for i, curve in enumerate(case["curves"]):
        parts += _curve(case, curve, x, y, COLOURS[i % len(COLOURS)])
    return tag("svg", tag("title", escaped(f"{case['id']}: {case['metric']} over {case['parameter']}")), *parts,
               viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", width=WIDTH, height=HEIGHT, role="img", fill="currentColor",
               font_family="system-ui, sans-serif", font_size=11.0)  # fmt: skip


def linear(low: float, high: float, start: float, end: float) -> Scale:
    """low..high to pixels start..end; what lies outside is held at the edge."""
    return lambda v: start + (min(max(v, low), high) - low) / (high - low) * (end - start)


def linear_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round values within low..high, multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= rough)
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _x_axis(case: Mapping[str, Any], points: Sequence[Point]) -> tuple[Scale, list[float]]:
    low, high = min(p["parameter"] for p in points), max(p["parameter"] for p in points)
    if low == high:
        low, high = (low / 2.0, high * 2.0) if case["log"] else (low - 0.5, high + 0.5)
    if case["log"]:
        wide = (high / low) ** 0.04
        return LogScale(low / wide, high * wide, LEFT, RIGHT), ticks(low, high, most=7) or [low, high]
    wide = 0.04 * (high - low)
    return linear(low - wide, high + wide, LEFT, RIGHT), linear_ticks(low, high)


def _y_axis(points: Sequence[Point]) -> tuple[Scale, list[float], float | None]:
    """Scale, ticks, and the value that readings of 0 are drawn at where the axis is logarithmic."""
    values = [p["value"] for p in points]
    edges = [edge for p in points for band in ("good", "stated") for edge in (p.get(band) or {}).values()]
    sizes = [v for v in values + edges if v > 0.0]
    if min(values) >= 0.0 and len(sizes) > 1 and max(sizes) / min(sizes) > SPREAD:
        zero = min(values) == 0.0
        low, high = min(sizes) / (6.0 if zero else 2.0), max(sizes) * 2.0
        return LogScale(low, high, BOTTOM, TOP), ticks(min(sizes) / 1.5, high, most=6), low if zero else None
    every = [*values, *edges]
    low, high = min(every), max(every)
    room = 0.1 * (high - low) or max(abs(high), 1.0) * 0.5
    return linear(low - room, high + room, BOTTOM, TOP), linear_ticks(low - room, high + room), None


def _frame(
    case: Mapping[str, Any], x: Scale, x_ticks: list[float], y: Scale, y_ticks: list[float], floor: float | None
) -> list[str]:
    parts = []
    for value in y_ticks:
        parts.append(tag("line", x1=LEFT, x2=RIGHT, y1=y(value), y2=y(value), **GRID))
        parts.append(text(tick(value), LEFT - 6.0, y(value) + 4.0, text_anchor="end"))
    if floor is not None:
        parts.append(text("0", LEFT - 6.0, BOTTOM + 3.0, text_anchor="end"))
    for value in x_ticks:
        parts.append(tag("line", x1=x(value), x2=x(value), y1=TOP, y2=BOTTOM, **GRID))
        parts.append(text(tick(value), x(value), BOTTOM + 15.0, text_anchor="middle"))
    parts.append(tag("rect", x=LEFT, y=TOP, width=RIGHT - LEFT, height=BOTTOM - TOP, fill="none", stroke="currentColor",
                     stroke_opacity=0.4))  # fmt: skip
    unit = f" ({case['unit']})" if case["unit"] else ""
    parts.append(
        text(f"{case['parameter']}{unit}", (LEFT + RIGHT) / 2.0, HEIGHT - 8.0, text_anchor="middle", font_weight="600")
    )
    return parts


def tick(value: float) -> str:
    """A round value, briefly."""
    return (
        f"{value:g}"
        if value == 0.0 or 1e-3 <= abs(value) < 1e5
        else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
    )


def _bands(points: Sequence[Point], x: Scale, y: Scale, colour: str) -> list[str]:
    """What a curve should keep to, shaded; where it fails as stated, within dashed lines."""
    parts = []
    for name, more in (("good", {"stroke": "none"}), ("stated", {"stroke": colour, "stroke_dasharray": "2 3"})):
        held = [(p["parameter"], p[name]) for p in points if p.get(name)]
        if not held:
            continue
        upper = [(x(v), y(b["high"]) if "high" in b else TOP) for v, b in held]
        lower = [(x(v), y(b["low"]) if "low" in b else BOTTOM) for v, b in held]
        if len(held) == 1:
            upper, lower = ([(at[0][0] - 6.0, at[0][1]), (at[0][0] + 6.0, at[0][1])] for at in (upper, lower))
        ring = " ".join(f"{a:.2f},{b:.2f}" for a, b in [*upper, *reversed(lower)])
        parts.append(tag("polygon", points=ring, fill=colour, fill_opacity=0.10, **more))
    return parts


def _curve(case: Mapping[str, Any], curve: Mapping[str, Any], x: Scale, y: Scale, colour: str) -> list[str]:
    known = [p for p in curve["points"] if p["value"] is not None]
    path = " ".join(f"{x(p['parameter']):.2f},{y(p['value']):.2f}" for p in known)
    dashes: dict[str, str | float] = {} if curve["judged"] else {"stroke_dasharray": "5 3"}
    line = (
        [tag("polyline", points=path, fill="none", stroke=colour, stroke_width=1.5, **dashes)] if len(known) > 1 else []
    )
    return line + [_mark(case, curve["name"], p, x(p["parameter"]), y, colour) for p in known]


def _mark(case: Mapping[str, Any], name: str, p: Point, at: float, y: Scale, colour: str) -> str:
    """A reading with ± 2 standard errors: full where it passes, hollow where it is below noise, crossed where it fails."""
    level, se = y(p["value"]), p.get("se") or 0.0
    words = f"{name} at {case['parameter']} {number(p['parameter'])}: {number(float(p['value']))} ± {number(float(se))}, {p['status']}"
    parts = [tag("title", escaped(words))]
    if se:
        parts.append(tag("line", x1=at, x2=at, y1=y(p["value"] - 2.0 * se), y2=y(p["value"] + 2.0 * se), stroke=colour))
    hollow = p["status"] in ("below noise", "shown")
    parts.append(tag("circle", cx=at, cy=level, r=3.5, fill="none" if hollow else colour, stroke=colour))
    if p["status"] in ("fail", "stated"):
        red = "#c23b3b" if p["status"] == "fail" else "currentColor"
        d = f"M{at - 6:.2f},{level - 6:.2f}l12,12m0,-12l-12,12"
        parts.append(tag("path", d=d, stroke=red, stroke_width=1.8, fill="none"))
    return tag("g", *parts)
