"""The waterfall of a scene on the page: a bar per link, a signed picture per link and camera, and the tables beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from ..record_models import JsonObject
from .embed import data_uri
from .pictures import SceneView, error_colours, png_bytes
from .svg import tag, text
from .words import Z95, interval, number, percent

WIDTH, ROW, LEFT, RIGHT, TOP = 900.0, 30.0, 190.0, 170.0, 26.0
BRIGHT, DARK, RMS = "#d6604d", "#4393c3", "#8a8f98"
PICTURE_COLOURS = 64
UNSEEN = 1e-5  # a link without more than this anywhere has no picture


def waterfall_context(found: Mapping[str, Any] | None, views: Sequence[SceneView]) -> JsonObject | None:
    """What the template shows of a record's `waterfall`; None where the error was not taken apart."""
    if not found:
        return None
    links, sets = found["links"], found["sets"]
    return {
        "sets": [_set(name, one, links) for name, one in sets.items()],
        "says": [(link["label"], link["says"]) for link in links],
        "meshes": _meshes(found["meshes"], links),
        "links": [link["label"] for link in links],
        "cross": _cross(sets["camera"], links),
        "views": [_view(view, links) for view in views if view.links is not None],
        "reference": _budget(found["reference"]),
        "diffuse": _budget(found["diffuse"]) if "diffuse" in found else "",
        "rays": f"{found['rays']['point']:,}",
        "times": found["rays"]["patch_times"],
        "notes": list(found["notes"]),
    }


def _budget(found: Mapping[str, Any]) -> str:
    return f"{found['paths']:,} paths a point, noise {percent(found['noise'], 2)}"


def _set(name: str, one: Mapping[str, Any], links: Sequence[Mapping[str, Any]]) -> JsonObject:
    rows = []
    for link in links:
        mine = one["links"][link["name"]]
        cells = [
            _metric(mine[k], 1.0 if k == "correlation" else 100.0, k == "signed")
            for k in ("signed", "rms", "correlation", "share")
        ]
        rows.append({"label": link["label"], "cells": cells, "noisy": bool(mine["rms"].get("below_noise"))})
    return {
        "name": "All cameras" if name == "camera" else name.capitalize(),
        "points": f"{one['points']:,}",
        "svg": Markup(draw_bars(one, links)),
        "rows": rows,
        "remainder": _metric({"value": one["remainder"]}, 100.0),
        "whole": [_metric(one["signed"], 100.0, True), _metric(one["rms"], 100.0)],
        "explained": _metric(one["explained"], 100.0),
        "closure": number(one["closure"], 2),
    }


def _metric(found: Mapping[str, Any], scale: float, signed: bool = False) -> tuple[str, str]:
    """Value and half of the 95 % interval, in percent where `scale` says so."""
    unit = "\u00a0%" if scale > 1.0 else ""
    shown, half = interval(scale * found["value"], scale * Z95 * float(found.get("se") or 0.0))
    shown = f"+{shown}" if signed and found["value"] > 0.0 else shown
    return shown + unit, f"±\u00a0{half}{unit}" if half else ""


def _meshes(meshes: Mapping[str, Any], links: Sequence[Mapping[str, Any]]) -> list[JsonObject]:
    rows = []
    for name, one in meshes.items():
        rms = [one["links"][link["name"]]["rms"]["value"] for link in links]
        largest = max(range(len(rms)), key=rms.__getitem__)
        cells = [(f"{100.0 * one['links'][link['name']]['signed']['value']:+.2f}", f"{100.0 * value:.2f}", i == largest)
                 for i, (link, value) in enumerate(zip(links, rms, strict=True))]  # fmt: skip
        rows.append({"name": name, "points": f"{one['points']:,}", "rms": _metric(one["rms"], 100.0), "cells": cells})
    return rows


def _cross(one: Mapping[str, Any], links: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Rows of the matrix of cross terms, in percent of the squared error, blank where they round to nothing."""
    shown = [[f"{100.0 * v:+.1f}" for v in row] for row in one["cross"]]
    return [
        (link["label"], ["" if v in ("+0.0", "-0.0") else v for v in row])
        for link, row in zip(links, shown, strict=True)
    ]


def _view(view: SceneView, links: Sequence[Mapping[str, Any]]) -> JsonObject:
    """Pictures of the links that have any, and the names of the others."""
    assert view.links is not None
    pictures, empty = [], []
    for link in links:
        error = view.links[link["name"]]
        if float(abs(error).max(initial=0.0)) <= UNSEEN:
            empty.append(link["label"])
            continue
        shown = png_bytes(error_colours(error, view.pictures.hit), PICTURE_COLOURS)
        pictures.append({"label": link["label"], "src": data_uri(shown)})
    height, width = view.pictures.hit.shape
    return {"camera": view.pictures.camera, "pictures": pictures, "empty": empty, "width": width, "height": height}


def draw_bars(one: Mapping[str, Any], links: Sequence[Mapping[str, Any]]) -> str:
    """The waterfall as SVG: signed means as steps from truth to ours, each beginning where the last one ended, and the RMS of each link
    as a thin bar below its step; both with 95 % intervals."""
    steps = [one["links"][link["name"]] for link in links]
    ends, at = [0.0], 0.0
    for step in steps:
        at += step["signed"]["value"]
        ends.append(at)
    high = max(*(s["rms"]["value"] + Z95 * s["rms"].get("se", 0.0) for s in steps), one["rms"]["value"], *ends, 1e-9)
    low = min(*ends, 0.0) - 0.02 * high
    scale = (WIDTH - LEFT - RIGHT) / (high - low)

    def x(value: float) -> float:
        return LEFT + (min(max(value, low), high) - low) * scale

    height = TOP + ROW * (len(links) + 1) + 8.0
    parts = [
        tag("line", x1=x(0.0), x2=x(0.0), y1=TOP - 6.0, y2=height, stroke="currentColor", stroke_opacity=0.5),
        text("0: truth", x(0.0), 12.0, text_anchor="middle", font_size=12.0, fill="currentColor"),
    ]
    for i, (link, step) in enumerate(zip(links, steps, strict=True)):
        parts += _step(link["label"], step, (ends[i], ends[i + 1]), TOP + ROW * i, x)
    whole = {"signed": one["signed"], "rms": one["rms"]}
    parts += _step("Whole error", whole, (0.0, one["signed"]["value"]), TOP + ROW * len(links), x)
    return tag("svg", *parts, viewBox=f"0 0 {WIDTH:.0f} {height:.0f}", width=WIDTH, height=height, role="img",
               aria_label="waterfall: signed mean of each link as a step from truth to ours, RMS as a gray bar")  # fmt: skip


def _step(label: str, step: Mapping[str, Any], ends: tuple[float, float], y: float, x: Any) -> list[str]:
    """A row: name, step, thin RMS bar, and both in figures."""
    signed, rms = step["signed"], step["rms"]
    colour = BRIGHT if signed["value"] > 0.0 else DARK
    a, b = sorted((x(ends[0]), x(ends[1])))
    half = Z95 * float(rms.get("se") or 0.0)
    spread = Z95 * float(signed.get("se") or 0.0)
    end = x(rms["value"])
    return [
        text(label, LEFT - 10.0, y + 16.0, text_anchor="end", font_size=13.0, fill="currentColor"),
        tag("rect", x=a, y=y + 3.0, width=max(b - a, 1.0), height=10.0, fill=colour),
        tag("line", x1=x(ends[1] - spread), x2=x(ends[1] + spread), y1=y + 8.0, y2=y + 8.0, stroke="currentColor"),
        tag("rect", x=x(0.0), y=y + 16.0, width=max(end - x(0.0), 0.0), height=5.0, fill=RMS),
        tag("line", x1=x(max(rms["value"] - half, 0.0)), x2=x(rms["value"] + half), y1=y + 18.5, y2=y + 18.5, stroke="currentColor"),
        tag("line", x1=x(ends[1]), x2=x(ends[1]), y1=y + 13.0, y2=y + 33.0, stroke="currentColor", stroke_opacity=0.35),
        text(f"{100.0 * signed['value']:+.2f} %  rms {100.0 * rms['value']:.2f} %", WIDTH - RIGHT + 8.0, y + 16.0, font_size=12.0,
             fill="currentColor"),
    ]  # fmt: skip
