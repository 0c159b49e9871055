"""What the page shows of pictures as a whole (FLIP, SSIM, relMSE) and of blocks of points that are biased, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..record_models import JsonObject
from .place_tables import block_letter
from .words import MEANINGS, number, percent

FIGURES = ("flip", "ssim", "relmse")


def images_context(scene: Mapping[str, Any]) -> JsonObject:
    """rows: one a camera, a cell for each figure with its noise; legend: what each says and what it is blind to. Empty without."""
    metrics = scene.get("metrics", {})
    rows = []
    for row in scene.get("images", []):
        cells = [_score(metrics.get(f"{name}_camera_{row['camera']}")) for name in FIGURES]
        span = f"{row['exposure_start']:+.2f} to {row['exposure_stop']:+.2f}"
        rows.append(
            {"camera": row["camera"], "cells": cells, "exposures": f"{row['exposures']}, {span} stops", "paths": row["paths_per_pixel"]}
        )  # fmt: skip
    return {"rows": rows, "legend": [(MEANINGS[name].label, MEANINGS[name].says) for name in FIGURES]} if rows else {}


def _score(metric: Mapping[str, Any] | None) -> JsonObject | None:
    if metric is None:
        return None
    noise = metric.get("noise")
    return {
        "value": number(float(metric["value"])),
        "noise": "" if noise is None else number(float(noise)),
        "below": bool(metric.get("below_noise")),
    }


def biased_context(scene: Mapping[str, Any]) -> JsonObject:
    """Blocks that are biased beyond chance, worst first, with counts of all; empty where nothing was tested."""
    metrics = scene.get("metrics", {})
    if "biased_blocks" not in metrics:
        return {}
    share = metrics["biased_blocks"]
    rows = [
        {
            "index": block_letter(i),
            "position": ", ".join(f"{v:.3f}" for v in place["position"]),
            "size": f"{number(place['size_m'])} m",
            "points": place["points"],
            "relative": f"{100.0 * place['relative']:+.1f} %",
            "noise": percent(place["noise"], 2),
            "p": number(place["p"], 2),
        }
        for i, place in enumerate(scene.get("biased", []))
    ]
    return {
        "count": round(share["value"] * share["n"]),
        "of": share["n"],
        "equal": percent(metrics["equal_blocks"]["value"], 2) if "equal_blocks" in metrics else "",
        "seen": percent(metrics["block_noise"]["value"], 2) if "block_noise" in metrics else "",
        "rows": rows,
    }
