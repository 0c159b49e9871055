"""The leaks of a scene as tables: by wall, and the worst places with the probes they read."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...reference.datatypes import I64, Scene
from .attribution import Leaks, blamed, walls_crossed
from .field import LightField, Places
from .prediction import triple
from .search import Edit, Search
from .single import Single, single_edits

WORST = 10
PROBES = 4  # of a place that are named


def by_wall(scene: Scene, field: LightField, edit: Edit) -> list[dict[str, Any]]:
    """Per mesh that leaks: how many places, their mean strength, and the share of all leaked light, most first."""
    leaks = edit.before
    pairs, mine = leaks.pairs, blamed(leaks)
    mesh = field.geometry.mesh[pairs.triangle]
    total = float(np.abs(pairs.light[mine]).sum())
    rows = []
    for number in np.unique(mesh[mine]):
        here = mine & (mesh == number)
        at = np.unique(pairs.weights.sample[here])
        rows.append(
            {
                "mesh": scene.meshes[number].name,
                "places": len(at),
                "strength": float(np.abs(leaks.strength[at]).mean()),
                "share": float(np.abs(pairs.light[here]).sum()) / total,
            }
        )
    return sorted(rows, key=lambda row: -row["share"])


def worst_places(scene: Scene, search: Search, edit: Edit) -> list[dict[str, Any]]:
    """The places that leak most, a voxel apart, each with the probes that the light comes from, the wall that it comes through, and the
    one cell that would stop the leak there (`single`). What was looked for in the tips of edges and in slivers beside faces comes last:
    it leaks strongly, but in next to no space."""
    leaks, at, field = edit.before, edit.places, search.field
    sample, mine = leaks.pairs.weights.sample, blamed(leaks)
    thin = np.isin(at.names, ("edges", "slivers"))
    order = np.lexsort((-np.abs(leaks.strength), thin, ~leaks.leaks))
    order = _apart(field, leaks, at, order[leaks.leaks[order]])
    size = field.octree.grid.size
    singles = single_edits(search, at, leaks, order) if len(order) else []
    rows = []
    for number, i in enumerate(order.tolist()):
        pairs = np.flatnonzero((sample == i) & mine)
        pairs = pairs[np.argsort(-np.abs(leaks.pairs.light[pairs]), kind="stable")]
        whole = float(np.abs(leaks.pairs.light[sample == i]).sum())
        rows.append(
            {
                "set": str(at.names[i]),
                "position": list(triple(at.positions[i])),
                "strength": float(leaks.strength[i]),
                "voxel_m": size(int(min(leaks.answers[i], leaks.holds[i]))),
                "dead": bool(leaks.answers[i] < leaks.holds[i]),
                "probes": [_probe(field, edit, int(k), whole) for k in pairs[:PROBES]],
                "wall": _wall(scene, field, edit, int(pairs[0])) if len(pairs) else None,
                "edit": _single(singles[number]) if singles else {},
            }
        )
    return rows


def _apart(field: LightField, leaks: Leaks, at: Places, order: I64) -> I64:
    """The first WORST of `order` (N,) that are a voxel or more apart."""
    grid = field.octree.grid
    size = grid.finest * 2.0 ** (grid.level - np.minimum(leaks.answers, leaks.holds))
    kept: list[int] = []
    for i in order.tolist():
        away = np.abs(at.positions[kept] - at.positions[i]).max(axis=1)
        if (away >= size[i]).all():
            kept.append(i)
        if len(kept) == WORST:
            break
    return np.array(kept, dtype=np.int64)


def _single(found: Single) -> dict[str, Any]:
    """One cell as it is in a bitmap file, and where that is; without one, what the smallest voxel that was tried leaves lit."""
    if found.layer is None:
        return {"tried_m": found.tried_m, "lit_m3": found.lit_m3, "lit_share": found.lit_share}
    layer = found.layer
    cell = layer.cells[0]
    return {
        "size_m": layer.size,
        "cell": [int(c) for c in cell],
        "origin": [float(x) for x in layer.origin],
        "corner": list(triple(layer.origin + cell * layer.size)),
    }


def _probe(field: LightField, edit: Edit, pair: int, whole: float) -> dict[str, Any]:
    """A probe by number, place and level, with its share of the place's light."""
    pairs = edit.before.pairs
    probe = int(pairs.weights.probe[pair])
    return {
        "index": probe,
        "position": list(triple(field.octree.positions[probe])),
        "level": int(field.octree.corner_level[probe]),
        "share": abs(float(pairs.light[pair])) / max(whole, 1e-300),
    }


def _wall(scene: Scene, field: LightField, edit: Edit, pair: int) -> dict[str, Any]:
    """The wall at the crossing. Thickness and need are absent where there is no slab: at a wall's end or in a wedge."""
    pairs = edit.before.pairs
    walls = walls_crossed(
        field.geometry, pairs, edit.places, np.array([pair, pair])
    )  # two: one lane would compile anew
    found: dict[str, Any] = {
        "mesh": scene.meshes[int(field.geometry.mesh[pairs.triangle[pair]])].name,
        "position": list(triple(pairs.crossing[pair])),
    }
    if np.isfinite(walls.thickness[0]):
        found |= {
            "behind": scene.meshes[int(walls.behind[0])].name,
            "thickness_m": float(walls.thickness[0]),
            "needed_voxel_m": float(walls.need[0]),
        }
    return found
