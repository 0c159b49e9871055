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
    return lines + [
        f"    {p['share']:.0%} from probe {p['index']} at {_point(p['position'])}, level {p['level']}"
        for p in place["probes"]
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
    lines += [f"edit: {sizes}, bakes to find it: {edit['rounds']}"]
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
    rows.append(["places that leak", f"{leaks['leaking']:,}", f"{edit['still_leaking']:,}"])
    return [*lines, table(rows), f"apply and measure it: {plain(leaks['command'])}"]


def _point(position: list[float]) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"
