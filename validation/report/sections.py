"""What the page shows of a scene, as plain values for the template: no markup, no arithmetic in the template."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..explain.command import explain_command
from ..record_models import JsonObject
from .bitmap_pictures import map_colours, map_context
from .embed import broken_pixels, data_uri, fallback, pixels
from .flight import flight_context
from .leaks import leaks_context
from .overlay import Colour, draw_probes, level_colours
from .pictures import SceneView, png_bytes
from .pixel import pixel_context
from .place_tables import marks, place_rows
from .score_tables import biased_context, images_context
from .sweep_tables import grid_rows, lod_rows, sweeps_context
from .verdict import floor_ratio, headline, warnings
from .waterfall import waterfall_context
from .words import COSTS, MEANINGS, SUFFIXES, amount, judge, meaning, number, percent, written

SETS = (
    "relrmse", "floor_l1", "relrmse_over_floor", "patch_relrmse", "bias", "patch_bias", "p99", "reference_noise", "unlit_share",
)  # fmt: skip
PRIMARY = ("real_probes", "bake_s", "update_ms")
SAID = {"good": "good", "over": "over", "unsure": "cannot tell", "": ""}
# Noise of the truth's picture from which its error is shown averaged at first, and the radii of the windows, pixels.
NOISY, AVERAGES = (0.05, 0.15), (0, 2, 5)
LONG_PATH = re.compile(r"(?<![\w.:/])/(?:[^\s/'\",;]+/){2,}([^\s/'\",;]+/[^\s/'\",;]+)")
POINTS = {"camera": SUFFIXES[""], "surface": SUFFIXES["_surface"], "volume": SUFFIXES["_volume"]}


def cell(metrics: Mapping[str, Any], name: str) -> JsonObject | None:
    """One metric as text: value, interval, sample count, judgement."""
    if name not in metrics:
        return None
    metric = metrics[name]
    known, _, _ = meaning(name)
    value, spread = written(metric, known.kind if known else "plain", str(metric.get("unit", "")))
    judged = judge(metric, known.limit if known else None)
    noise, floor = bool(metric.get("below_noise")), metric.get("noise")
    return {
        "value": value,
        "spread": spread,
        "n": f"{metric['n']:,}",
        "below": noise,
        "noise": "" if floor is None else written({"value": floor}, known.kind if known else "plain")[0],
        "judged": judged,
        "said": SAID[judged],
    }


def summary_row(scene: Mapping[str, Any]) -> JsonObject:
    """A scene's line in the table on top."""
    metrics, cost = scene.get("metrics", {}), scene.get("cost", {})
    ratio = floor_ratio(metrics)
    return {
        "name": scene["name"],
        "status": scene["status"],
        "head": headline(scene),
        "warnings": warnings(scene),
        "errors": [cell(metrics, f"relrmse{suffix}") for suffix in SUFFIXES],
        "floor": cell(metrics, "floor_l1"),
        "ratio": f"{ratio:.2f}\u00d7" if ratio is not None else "",
        "leak": cell(metrics, "leak"),
        "cost": {key: amount(key, cost[key]) if key in cost else "" for key in PRIMARY},
    }


def scene_section(
    scene: Mapping[str, Any], views: Sequence[tuple[SceneView, str]], provenance: Mapping[str, Any]
) -> JsonObject:
    """A scene's section. views: its cameras, each with the name of its EXR file."""
    metrics = scene.get("metrics", {})
    worst = list(scene.get("worst", []))
    drawn = [int(v) for view, _ in views if view.dots is not None for v in np.unique(view.dots.level)]
    colours = map_colours(scene, drawn)
    return {
        "name": scene["name"],
        "status": scene["status"],
        "error": scene.get("error", ""),
        "head": headline(scene),
        "warnings": warnings(scene),
        "sentence": sentence(metrics),
        "views": [
            {
                **view_context(view, name, scene),
                "explain": explain_command(str(provenance.get("command", "")), scene["name"], view.pictures.camera),
            }
            for view, name in views
        ],
        "levels": level_rows(scene, level_colours(drawn) or colours),
        "maps": map_context(scene, colours),
        "waterfall": waterfall_context(scene.get("waterfall"), [view for view, _ in views]),
        "pixel": pixel_context(scene.get("pixel"), [view for view, _ in views]),
        "leaks": leaks_context(scene.get("leaks")),
        "fly": flight_context(scene.get("fly")),
        "lods": lod_rows(scene),
        "grids": grid_rows(scene),
        "sweeps": sweeps_context(scene),
        "sets": [s for name in SETS if (s := set_row(metrics, name)) is not None],
        "others": other_rows(metrics),
        "worst": [worst_row(i, place) for i, place in enumerate(worst)],
        "images": images_context(scene),
        "biased": biased_context(scene),
        "places": place_rows(scene),
        "cost": cost_rows(scene.get("cost", {})),
        "verdicts": [str(v) for v in scene.get("verdicts", [])],
        "notes": [shortened(str(note)) for note in scene.get("notes", [])],
        "files": file_rows(scene.get("files", {})),
        "command": str(scene.get("command", provenance.get("command", ""))),
    }


def sentence(metrics: Mapping[str, Any]) -> str:
    """The error of a scene, said in one breath."""
    error, floor = cell(metrics, "relrmse"), cell(metrics, "floor_l1")
    if error is None:
        return ""
    said = f"At {error['n']} points the cameras see, the light is wrong by {error['value']} {error['spread']}".rstrip()
    if floor is not None:
        said += f"; exact L1 probes at those very points would be wrong by {floor['value']} {floor['spread']}".rstrip()
    noise = metrics.get("reference_noise")
    patches = cell(metrics, "patch_relrmse")
    if patches is not None and not patches["below"]:
        said += f"; the patches alone, without probes, are wrong by {patches['value']} {patches['spread']}".rstrip()
    return said + (f". The reference itself carries {percent(float(noise['value']), 2)} of noise." if noise else ".")


def view_context(view: SceneView, exr: str, scene: Mapping[str, Any]) -> JsonObject:
    """One camera: fallback pictures, packed light, the probes, marks at the worst places it sees."""
    pictures, pose = view.pictures, view.pose
    drawn = data_uri(png_bytes(draw_probes(pictures, pose, view.dots), 128)) if view.dots is not None else ""
    return {
        "camera": pictures.camera,
        "width": pictures.hit.shape[1],
        "height": pictures.hit.shape[0],
        "noise": percent(pictures.truth_noise, 2),
        "noisy": pictures.truth_noise > NOISY[0],
        "average": AVERAGES[sum(pictures.truth_noise > n for n in NOISY)],
        "broken": broken_pixels(pictures),
        "empty": not bool(pictures.hit.any()),
        "images": fallback(pictures),
        "pixels": pixels(pictures),
        "probes": drawn,
        "exr": exr,
        "marks": marks(scene, pictures, pose),
    }


def level_rows(scene: Mapping[str, Any], colours: Mapping[int, Colour]) -> list[JsonObject]:
    """Counts by level and kind, with the colour of the level."""
    rows = []
    for row in scene.get("counts_by_level", []):
        rgb = colours.get(row["level"])
        size = row.get("voxel_m")
        counts = {key: f"{row.get(key, 0):,}" for key in ("voxels", "real", "virtual", "culled", "invalid", "tiles")}
        colour = "#{:02x}{:02x}{:02x}".format(*rgb) if rgb else ""
        rows.append({"level": row["level"], "size": f"{number(size)} m" if size else "", "colour": colour, **counts})
    return rows


def set_row(metrics: Mapping[str, Any], base: str) -> JsonObject | None:
    """One error metric at the three sets of points."""
    cells = [cell(metrics, f"{base}{suffix}") for suffix in SUFFIXES]
    if not any(cells):
        return None
    known = MEANINGS[base]
    return {"name": base, "label": known.label, "says": known.says, "good": known.good, "cells": cells}


def other_rows(metrics: Mapping[str, Any]) -> list[JsonObject]:
    """All metrics that are not in the table of sets: the known ones in their order, then the unknown by name."""
    shown = {f"{base}{suffix}" for base in SETS for suffix in SUFFIXES}
    order = list(MEANINGS)
    rows = []
    for name in metrics:
        if name in shown:
            continue
        known, base, suffix = meaning(name)
        label = (known.label if known else name) + (f", {SUFFIXES.get(suffix, suffix)}" if suffix else "")
        says, good = (known.says, known.good) if known else ("", "")
        place = (order.index(base) if known else len(order), name)
        rows.append((place, {"name": name, "label": label, "says": says, "good": good, "cell": cell(metrics, name)}))
    return [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def shortened(note: str) -> str:
    """A note with long file paths cut to folder and name; the record keeps them whole."""
    return LONG_PATH.sub("\u2026/\\1", note)


def worst_row(index: int, place: Mapping[str, Any]) -> JsonObject:
    """A place with large error."""
    return {
        "index": index + 1,
        "set": POINTS.get(place["set"], place["set"]),
        "position": ", ".join(f"{v:.3f}" for v in place["position"]),
        "ours": "  ".join(number(float(v)) for v in place["ours"]),
        "truth": "  ".join(number(float(v)) for v in place["truth"]),
        "relative": f"{100.0 * place['relative']:+,.0f} %",
    }


def cost_rows(cost: Mapping[str, Any]) -> list[JsonObject]:
    """Costs with a unit and a word of explanation, the known ones first."""
    keys = [key for key in COSTS if key in cost] + sorted(key for key in cost if key not in COSTS)
    return [
        {"name": COSTS.get(key, (key, ""))[0], "says": COSTS.get(key, ("", ""))[1], "value": amount(key, cost[key])}
        for key in keys
    ]


def file_rows(files: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(what, path) of every file the record lists, nested lists and tables flattened."""
    rows: list[tuple[str, str]] = []
    for what, where in files.items():
        if isinstance(where, Mapping):
            rows += [(f"{what} {inner}", path) for inner, path in file_rows(where)]
        elif isinstance(where, list):
            rows += [(what, str(path)) for path in where]
        else:
            rows.append((what, str(where)))
    return rows
