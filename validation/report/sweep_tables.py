"""Tables of the knobs of sampling and validity, and of levels of detail, as text for the template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..record_models import JsonObject
from .words import SUFFIXES, number, percent, written

KNOBS = {
    "normal_offset": ("Offset along the normal", "finest voxels off the surface at which light is sampled"),
    "backface_tolerance": ("Tolerance of back faces", "share of back faces above which a probe is invalid; nothing is copied here"),
    "copies": ("Light copied into dead edges", "0 without, 1 with; the same bake"),
}  # fmt: skip
SET_WORDS = {"camera": SUFFIXES[""], "surface": SUFFIXES["_surface"], "volume": SUFFIXES["_volume"]}
# Columns beside the errors: they belong to the value of the knob, not to a set of points.
EXTRA = {
    "invalid_share": "Invalid probes",
    "missed": "Solid places called valid",
    "false_alarms": "Free places called invalid",
}


def sweeps_context(scene: Mapping[str, Any]) -> list[JsonObject]:
    """One table a knob: rows are its values, columns the sets of points."""
    tables = []
    for knob, (title, says) in KNOBS.items():
        rows = [r for r in scene.get("sweeps", []) if r["knob"] == knob]
        if rows:
            sets = list(dict.fromkeys(str(r["set"]) for r in rows))
            extra = [key for key in EXTRA if any(r.get(key) is not None for r in rows)]
            lines = [
                _line([r for r in rows if r["value"] == v], sets, extra)
                for v in dict.fromkeys(r["value"] for r in rows)
            ]
            heads = [SET_WORDS.get(s, s) for s in sets] + [EXTRA[key] for key in extra]
            gains = [_gain(g) for g in scene.get("offset_gains", [])] if knob == "normal_offset" else []
            tables.append({"title": title, "says": says, "heads": heads, "lines": lines, "gains": gains})
    return tables


def _line(rows: Sequence[Mapping[str, Any]], sets: Sequence[str], extra: Sequence[str]) -> JsonObject:
    by_set = {r["set"]: r for r in rows}
    cells = [_error(by_set[s]["relrmse"]) if s in by_set else "" for s in sets]
    shares = [percent(float(rows[0][key])) if rows[0].get(key) is not None else "" for key in extra]
    value = number(float(rows[0]["value"]), 2)
    return {"value": value, "current": any(r["current"] for r in rows), "cells": [*cells, *shares]}


def _error(metric: Mapping[str, Any] | None) -> str:
    if metric is None:
        return ""
    return "below noise" if metric.get("below_noise") else " ".join(written(metric, "percent")).rstrip()


def _gain(row: Mapping[str, Any]) -> str:
    where = SET_WORDS.get(row["set"], row["set"])
    if row.get("gain") is None or row["best"] == 0.0:
        return f"{where}: no offset is best"
    return f"{where}: {number(float(row['best']), 2)} is best, {_error(row['gain'])} under none"


def grid_rows(scene: Mapping[str, Any]) -> list[JsonObject]:
    """Uniform grids, coarse to fine."""
    return [
        {
            "size": f"{number(float(row['voxel_m']))} m",
            "probes": f"{row['probes']:,}",
            "valid": f"{row['valid_probes']:,}",
            "errors": [percent(float(row[key])) for key in ("relrmse", "placement_error")],
        }
        for row in scene.get("grids", [])
    ]


def lod_rows(scene: Mapping[str, Any]) -> list[JsonObject]:
    """Levels of detail, coarse to fine."""
    return [
        {
            "level": row["level"],
            "size": f"{number(float(row['voxel_m']))} m",
            "probes": f"{row['probes']:,}",
            "error": _error(row.get("relrmse")),
            "set": SET_WORDS.get(row["set"], row["set"]),
        }
        for row in scene.get("lods", [])
    ]
