"""Worst places on the page: a table of where each metric is worst, and the marks of all such places on the cameras' pictures.

Marks are numbers for the worst receivers, capital letters for biased blocks, small letters for the worst places of metrics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..record_models import JsonObject
from .overlay import space_marks, surface_marks
from .pictures import CameraPictures, CameraPose
from .words import meaning, number, percent, written

MARKED = 10
PROBES = 4
Mark = tuple[str, float, float]


def block_letter(index: int) -> str:
    """A, B, … of the biased blocks."""
    return chr(ord("A") + index)


def place_letter(index: int) -> str:
    """a, b, … of the places where metrics are worst."""
    return chr(ord("a") + index)


def marks(scene: Mapping[str, Any], pictures: CameraPictures, pose: CameraPose) -> list[Mark]:
    """(label, x, y) in pixels of what this camera sees of the scene's worst receivers, biased blocks and metrics' worst places."""
    drawn: list[Mark] = []
    for rows, seen, label in (
        (scene.get("worst", [])[:MARKED], surface_marks, lambda i: str(i + 1)),
        (scene.get("biased", []), surface_marks, block_letter),
        (scene.get("places", []), space_marks, place_letter),
    ):
        points = np.array([row["position"] for row in rows], np.float64).reshape(-1, 3)
        drawn += [(label(i), round(x, 1), round(y, 1)) for i, x, y in seen(pictures, pose, points)]
    return drawn


def place_rows(scene: Mapping[str, Any]) -> list[JsonObject]:
    """A row for each metric's worst place."""
    rows = []
    for i, place in enumerate(scene.get("places", [])):
        known, _, _ = meaning(place["metric"])
        size = place.get("voxel_m")
        probes = [f"{percent(p['weight'], 2)} of {_position(p['position'])}" for p in place.get("probes", [])]
        rows.append(
            {
                "letter": place_letter(i),
                "label": known.label if known else place["metric"],
                "name": place["metric"],
                "value": written({"value": place["value"]}, known.kind if known else "plain")[0],
                "position": _position(place["position"]),
                "voxel": f"level {place['level']}, {number(size)} m" if size else "none answers",
                "probes": probes[:PROBES],
                "more": max(len(probes) - PROBES, 0),
            }
        )
    return rows


def _position(position: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.3f}" for v in position) + ")"
