"""The leaks of a scene on the page: a plan of the walls, what leaks, the probes blamed and the edit, and the tables beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from ..leaks.text import how_small, own_edit
from ..record_models import JsonObject
from .svg import tag, text
from .words import number, percent

WIDTH, LEAST_HEIGHT, MOST_HEIGHT = 720.0, 160.0, 640.0
FOOT = 34.0  # for the ruler below the drawing
WALLS, PLACES = 12, 5
AXES = "xyz"
# Told apart by lightness and shape too: leaking places are discs, probes diamonds, cells squares.
LEAK, PROBE, CELL = "#d6604d", "#4393c3", "#e0a100"
RADII = (1.5, 6.0)
METRICS = {
    "leak": "Light leak",
    "leak_worst": "Worst leak",
    "leak_area": "Leaked area",
    "overdark": "Overdark",
    "leak_band": "Lit band at the wall, signed",
    "relrmse_camera": "Relative error, cameras",
    "relrmse_surface": "Relative error, surfaces",
    "relrmse_volume": "Relative error, volumes",
}


def leaks_context(leaks: Mapping[str, Any] | None) -> JsonObject | None:
    """What the template shows of a record's `leaks` table; None where leaks were not explained."""
    if not leaks:
        return None
    edit = leaks["edit"]
    return {
        "places": f"{leaks['places']:,}",
        "leaking": f"{leaks['leaking']:,}" if leaks["leaking"] else "",
        "receivers": f"{leaks['leaking_receivers']:,}",
        "through": [(row["mesh"], percent(row["share"], 2)) for row in leaks["through"]],
        "walls": [_wall(row) for row in leaks["walls"][:WALLS]],
        "worst": [_place(row) for row in leaks["worst"][:PLACES]],
        "edit": [f"{layer['cells']:,} cells of {number(layer['size_m'])} m" for layer in edit["layers"]],
        "how_small": how_small(edit),
        "deeper": number(edit["min_voxel_m"]) if edit["deeper"] else "",
        "refused": edit["refused"],
        "sheets": edit["through_sheets"],
        "in_sight": f"{edit['lit_in_sight']:,}" if edit["lit_in_sight"] else "",
        "still": f"{edit['still_leaking']:,}",
        "compared": _compared(leaks),
        "command": leaks.get("command", ""),
        "plan": Markup(draw_plan(leaks["plan"])) if leaks.get("plan") else "",
    }


def _wall(row: Mapping[str, Any]) -> JsonObject:
    return {
        "mesh": row["mesh"],
        "behind": row["behind"],
        "thickness": "sheet" if row["sheet"] else f"{number(row['thickness_m'])} m",
        "needed": "none is small enough" if row["sheet"] else f"{number(row['needed_voxel_m'])} m",
        "lifted": "" if row["sheet"] else f"{number(row['needed_voxel_lifted_m'])} m",
        "voxel": f"{number(row['voxel_m'])} m",
        "share": percent(row["leak_share"], 2),
        "position": _point(row["position"]),
    }


def _place(row: Mapping[str, Any]) -> JsonObject:
    wall = row["wall"]
    probes = [
        f"{percent(p['share'], 2)} from {p['index']} at {_point(p['position'])}, level {p['level']}"
        for p in row["probes"]
    ]
    return {
        "strength": percent(row["strength"], 3),
        "position": _point(row["position"]),
        "voxel": f"{number(row['voxel_m'])} m",
        "dead": row["dead"],
        "wall": f"{wall['mesh']} at {_point(wall['position'])}" if wall else "",
        "probes": probes,
        "own": own_edit(row.get("edit") or {}),
    }


def _compared(leaks: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(what, before, with the edit) lines."""
    before, after = leaks["before"], leaks["after"]
    rows = [("Real probes", f"{before['probes']:,}", f"{after['probes']:,}")]
    for name, words in METRICS.items():
        if name in before["metrics"] and name in after["metrics"]:
            rows.append(
                (words, percent(before["metrics"][name]["value"], 3), percent(after["metrics"][name]["value"], 3))
            )
    edit = leaks["edit"]
    left = f"{edit['still_leaking']:,} of {edit['checked']:,} looked at"
    return [*rows, ("Places that leak", f"{leaks['leaking']:,}", left)]


def _point(position: list[float]) -> str:
    return ", ".join(f"{x:.2f}" for x in position)


def draw_plan(plan: Mapping[str, Any]) -> str:
    """The plan as SVG: cells below, walls above them, then probes, then leaking places, the strongest last."""
    x0, y0, x1, y1 = plan["bounds"]
    scale = min(WIDTH / (x1 - x0), MOST_HEIGHT / (y1 - y0))
    height = max((y1 - y0) * scale, LEAST_HEIGHT)

    def at(x: float, y: float) -> tuple[float, float]:
        return (x - x0) * scale, (y - y0) * scale

    parts = [*_cells(plan["cells"], at, scale), *_walls(plan["walls"], at)]
    parts += [_diamond(*at(x, y)) for x, y in plan["probes"]]
    strongest = max((p[2] for p in plan["places"]), default=1.0)
    for x, y, strength in reversed(plan["places"]):
        cx, cy = at(x, y)
        radius = RADII[0] + (RADII[1] - RADII[0]) * math.sqrt(strength / strongest)
        parts.append(tag("circle", cx=cx, cy=cy, r=radius, fill=LEAK, fill_opacity=0.75))
    parts += ruler(x1 - x0, scale, height)
    across, down = (AXES[i] for i in plan["axes"])
    cut = next(name for name in AXES if name not in (across, down))
    label = f"plan: {across} to the right, {down} down, surfaces cut at {cut} = {plan['at']:.2f} m"
    parts.append(text(label, WIDTH, height + 24.0, text_anchor="end", font_size=12.0, fill="currentColor"))
    return tag("svg", *parts, viewBox=f"0 0 {WIDTH:.0f} {height + FOOT:.0f}", width=WIDTH, height=height + FOOT, role="img",
               aria_label=f"{label}; discs leak, diamonds are the probes blamed, squares are cells of the edit")  # fmt: skip


def _cells(cells: list[list[float]], at: Any, scale: float) -> list[str]:
    drawn = []
    for x, y, size in cells:
        px, py = at(x, y)
        drawn.append(
            tag(
                "rect",
                x=px,
                y=py,
                width=size * scale,
                height=size * scale,
                fill=CELL,
                fill_opacity=0.14,
                stroke=CELL,
                stroke_width=0.8,
            )
        )
    return drawn


def _walls(walls: list[list[float]], at: Any) -> list[str]:
    if not walls:
        return []
    path = " ".join("M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*at(a, b), *at(c, d)) for a, b, c, d in walls)
    return [tag("path", d=path, fill="none", stroke="currentColor", stroke_width=1.4)]


def _diamond(x: float, y: float) -> str:
    r = 6.0
    corners = f"M{x:.1f} {y - r:.1f}L{x + r:.1f} {y:.1f}L{x:.1f} {y + r:.1f}L{x - r:.1f} {y:.1f}Z"
    return tag("path", d=corners, fill=PROBE, stroke="currentColor", stroke_width=0.8)


def ruler(metres: float, scale: float, height: float) -> list[str]:
    """A round length, a fifth of the drawing or less."""
    decade = 10.0 ** math.floor(math.log10(metres / 5.0))
    length = max(m * decade for m in (1.0, 2.0, 5.0) if m * decade <= metres / 5.0)
    y = height + 20.0
    line = tag(
        "path", d=f"M1 {y - 4:.1f}V{y:.1f}H{1 + length * scale:.1f}V{y - 4:.1f}", fill="none", stroke="currentColor"
    )
    return [line, text(f"{number(length)} m", length * scale + 8.0, y + 4.0, font_size=12.0, fill="currentColor")]
