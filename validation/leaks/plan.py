"""What the drawing of a leak shows, as plain numbers: the walls cut open, places that leak, probes blamed, cells of the edit.

The scene is seen along one axis of the world, down unless the light comes through a floor, and its surfaces are cut at the
worst place.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F64
from ...reference.visibility import Geometry
from ..plane_section import plane_section
from .attribution import blamed
from .field import LightField
from .search import Edit

MOST = {"walls": 2000, "places": 400, "probes": 150, "cells": 1500}
MARGIN = 0.2  # of the drawing's longer side, around what leaks
DIGITS = 4


def plan(field: LightField, edit: Edit) -> dict[str, Any]:
    """axes: numbers of the two axes of the world that the drawing shows, across and down. at: where on the third it is cut.
    walls: segments [x0, y0, x1, y1]; places: [x, y, strength]; probes: [x, y]; cells: [x, y, size]; all m, largest first."""
    leaks = edit.before
    bad = np.flatnonzero(leaks.leaks)
    if len(bad) == 0:
        return {}
    mine = blamed(leaks)
    along = _view(field.geometry, leaks.pairs.triangle[mine])
    across, down = (axis for axis in (0, 2, 1) if axis != along)
    ordered = bad[np.argsort(-np.abs(leaks.strength[bad]), kind="stable")]
    at = edit.places.positions
    cut = float(at[ordered[0], along])
    shown = ordered[:: -(-len(ordered) // MOST["places"])]
    probes = field.octree.positions[np.unique(leaks.pairs.weights.probe[mine])]
    cells = _cells(edit, across, down)
    seen = np.concatenate([at[bad][:, [across, down]], probes[:, [across, down]], cells[:, :2]])
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = MARGIN * max(float((high - low).max()), field.octree.grid.wanted)
    walls = clipped(
        section(field.geometry, along, cut)[:, [across, down, across + 3, down + 3]], low - room, high + room
    )
    places = np.column_stack([at[shown][:, [across, down]], np.abs(leaks.strength[shown])])
    return {
        "axes": [across, down],
        "at": cut,
        "bounds": _rounded(np.concatenate([low - room, high + room])),
        "walls": _rounded(walls[: MOST["walls"]]),
        "places": _rounded(places),
        "probes": _rounded(np.unique(probes[:, [across, down]], axis=0)[: MOST["probes"]]),
        "cells": _rounded(cells[: MOST["cells"]]),
    }


def _view(g: Geometry, triangle: npt.NDArray[np.integer]) -> int:
    """The axis to look along: y, unless most of the walls that leak lie flat; then z."""
    flat = np.abs(g.normals[triangle, 1]) > np.sqrt(0.5)
    return 2 if len(flat) and flat.mean() > 0.5 else 1


def _cells(edit: Edit, across: int, down: int) -> F64:
    """Lower corner and size (N, 3) m of the edit's cells in the drawing, each column of cells once, large before small."""
    columns = [np.zeros((0, 3))]
    for layer in edit.layers:
        flat = np.unique(layer.cells[:, [across, down]], axis=0)
        corner = layer.origin[[across, down]] + layer.size * flat
        columns.append(np.column_stack([corner, np.full(len(flat), layer.size)]))
    return np.concatenate(columns)


def section(g: Geometry, axis: int, at: float) -> F64:
    """Segments (N, 6) m in which the plane `axis` = `at` cuts the triangles."""
    return plane_section(g.vertices[g.faces], axis, at).reshape(-1, 6)


def clipped(segments: F64, low: F64, high: F64) -> F64:
    """Segments (N, 4) cut to a rectangle (2,), (2,); what lies outside is left out (Liang and Barsky 1984)."""
    start, way = segments[:, :2], segments[:, 2:] - segments[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / way, (high - start) / way
    inside = (start >= low) & (start <= high)
    enter = np.where(way == 0.0, np.where(inside, -np.inf, np.inf), np.minimum(a, b)).max(axis=1).clip(0.0, None)
    leave = np.where(way == 0.0, np.where(inside, np.inf, -np.inf), np.maximum(a, b)).min(axis=1).clip(None, 1.0)
    keep = enter < leave
    start, way, enter, leave = start[keep], way[keep], enter[keep, None], leave[keep, None]
    return np.concatenate([start + enter * way, start + leave * way], axis=1)


def _rounded(values: F64) -> Any:
    return np.round(values, DIGITS).tolist()
