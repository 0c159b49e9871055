"""The leaks of a scene on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..summary import interval, number, plain, table

WALLS, PLACES = 6, 3
METRICS = (
    "leak",
    "leak_worst",
    "leak_area",
    "overdark",
    "leak_band",
    "relrmse_camera",
    "relrmse_surface",
    "relrmse_volume",
)


def leaks_text(results: Mapping[str, Any]) -> str:
    """One paragraph a scene that was explained; empty if none was."""
    told = [scene for scene in results["scenes"] if scene.get("leaks")]
    return "\n\n".join("\n".join(_scene_lines(plain(str(s["name"])), s["leaks"])) for s in told)


def _scene_lines(name: str, leaks: Mapping[str, Any]) -> list[str]:
    lines = [
        "",
        f"{name}: walls, the most endangered first (voxels up to `needed` keep light in)",
        _walls(leaks["walls"]),
    ]
    if not leaks["leaking"]:
        return [*lines, f"{name}: no leak at {leaks['places']:,} places"]
    lines.append(
        f"{name}: {leaks['leaking']:,} of {leaks['places']:,} places leak, {leaks['leaking_receivers']:,} of them measured receivers"
    )
    lines += [f"  through {plain(r['mesh'])}: {r['share']:.0%} of the leaked light" for r in leaks["through"][:WALLS]]
    lines += [line for place in leaks["worst"][:PLACES] for line in _place(place)]
    return [*lines, *_edit(leaks)]


def _walls(rows: list[Mapping[str, Any]]) -> str:
    cells = [["wall", "thickness m", "needed m", "voxel m", "area predicted to leak", "worst at"]]
    for row in rows[:WALLS]:
        cells.append(
            [
                plain(row["mesh"]) + ("" if row["behind"] == row["mesh"] else f" / {plain(row['behind'])}"),
                "sheet" if row["sheet"] else number(row["thickness_m"]),
                "none" if row["sheet"] else number(row["needed_voxel_m"]),
                number(row["voxel_m"]),
                f"{row['leak_share']:.0%}",
                _point(row["position"]),
            ]
        )
    return table(cells)


def _place(place: Mapping[str, Any]) -> list[str]:
    wall = place["wall"]
    through = f", through {plain(wall['mesh'])} at {_point(wall['position'])}" if wall else ""
    dead = ", a larger one than its own, whose probes are all invalid" if place["dead"] else ""
    lines = [
        f"  {place['strength']:.1%} of the mean light at {_point(place['position'])}{through}; voxel {number(place['voxel_m'])} m{dead}"
    ]
    lines += [
        f"    {p['share']:.0%} from probe {p['index']} at {_point(p['position'])}, level {p['level']}"
        for p in place["probes"]
    ]
    return lines + [f"    {line}" for line in own_edit(place.get("edit") or {})]


def own_edit(edit: Mapping[str, Any]) -> list[str]:
    """The one cell that stops a place's leak, and the command that applies it; or why there is none."""
    if "cell" in edit:
        said = f"one cell of {number(edit['size_m'])} m with its corner at {_point(edit['corner'])} stops it here"
        return [said, *([plain(edit["command"])] if "command" in edit else [])]
    if not edit:
        return []
    if edit["lit_m3"] == 0.0:
        return [f"no voxel stops it here, down to {number(edit['tried_m'])} m"]
    return [
        f"no voxel stops it here, down to {number(edit['tried_m'])} m: that one leaves {number(edit['lit_m3'])} m³ lit, "
        f"{edit['lit_share']:.0%} of its open space"
    ]


def _edit(leaks: Mapping[str, Any]) -> list[str]:
    edit, before, after = leaks["edit"], leaks["before"], leaks["after"]
    lines = []
    if edit["lit_in_sight"]:
        lines.append(
            f"{edit['lit_in_sight']:,} places are lit by probes that they see: those hold the light themselves, as when a patch "
            "reaches through a wall (radiosity.patch_size)"
        )
    if not edit["cells"]:
        why = (
            "only sheets leak, which no voxel is small enough for"
            if edit["through_sheets"]
            else edit["refused"] or "none found"
        )
        return [*lines, f"edit: none ({plain(why)})"]
    sizes = ", ".join(f"{layer['cells']:,} cells of {number(layer['size_m'])} m" for layer in edit["layers"])
    lines += [f"edit: {sizes}, bakes to find it: {edit['rounds']}", f"  {how_small(edit)}"]
    if edit["deeper"]:
        lines.append(
            f"  finer than placement.min_voxel ({number(edit['min_voxel_m'])} m), which holds for all the rest as before"
        )
    if edit["refused"]:
        lines.append(f"  finer cells were refused: {plain(edit['refused'])}")
    rows = [["", "before", "with the edit"], ["real probes", f"{before['probes']:,}", f"{after['probes']:,}"]]
    rows += [
        [name, interval(before["metrics"][name]), interval(after["metrics"].get(name))]
        for name in METRICS
        if name in before["metrics"]
    ]
    rows.append(
        ["places that leak", f"{leaks['leaking']:,}", f"{edit['still_leaking']:,} ({edit['checked']:,} looked at)"]
    )
    return [*lines, table(rows), f"apply and measure it: {plain(leaks['command'])}"]


def how_small(edit: Mapping[str, Any]) -> str:
    """Whether the edit could be smaller, and how that was found out."""
    if edit.get("minimal"):
        return (
            f"the smallest found, of {edit['grown_cells']:,} cells at first: with any one of its cells put down to the next larger "
            "voxel some place leaks, judged by the probes of the whole edit; the rest was baked and measured"
        )
    return f"of {edit['grown_cells']:,} cells at first; perhaps not the smallest: not each of its cells was shown to be needed"


def _point(position: list[float]) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"
