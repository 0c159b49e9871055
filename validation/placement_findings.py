"""What is found out about validity, dead edges and levels of detail of a baked scene: metrics, notes, and the record's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..reference.placement.dead_edges import Edges, dead_edges, exposed
from ..reference.texture_types import Samples
from ..reference.truth.points import PointSet
from .bake import Baked, lifted
from .ground_truth import GroundTruth
from .metrics.dead_edges import dead_jump, dead_jumps, fallback_share, open_places
from .metrics.error import Measured
from .metrics.validity import measure_validity
from .placement_sweeps import as_metric, copied, lod_errors, lod_table, sweep_tables, without_copies
from .spots import Spot


@dataclass(frozen=True)
class PlacementFindings:
    """metrics by name and tables by name, as results.json holds them; notes: why something is absent; spots: the worst places."""

    metrics: dict[str, Any]
    notes: list[str]
    tables: dict[str, list[dict[str, Any]]]
    spots: list[Spot]


def placement_findings(
    baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples], seed: int
) -> PlacementFindings:
    """All of it. sampled: kernel samples by set of points."""
    s, probes = baked.scene.settings.placement, baked.probes
    voxel = probes.octree.grid.wanted
    g, positions = baked.surfaces.geometry, probes.octree.positions
    validity = measure_validity(g, positions, probes.rows.back_share, voxel, s.backface_tolerance, seed)
    measured = dict(validity.metrics)
    for name, points in truth.points.items():
        where = lifted(baked.scene, baked.texture, points)
        measured["fallback_share" + ("" if name == "camera" else f"_{name}")] = fallback_share(
            baked.texture, where, sampled[name]
        )
    edges = dead_edges(probes.octree, probes.valid)
    in_the_open = exposed(g, probes.octree, edges, s.backface_tolerance, seed + 7)
    jumps, spots = _jumps(baked, in_the_open, seed)
    measured |= jumps
    measured |= lod_errors(baked, truth)
    notes = [*validity.notes, _said(edges, in_the_open, copied(baked))]
    sweeps, gains = sweep_tables(baked, truth, validity.judged)
    tables = {"lods": lod_table(baked, truth), "sweeps": sweeps, "offset_gains": gains}
    entries = {name: as_metric(m) for name, m in measured.items()}
    return PlacementFindings({name: e for name, e in entries.items() if e is not None}, notes, tables, spots)


def _jumps(baked: Baked, edges: Edges, seed: int) -> tuple[dict[str, Measured], list[Spot]]:
    """dead_jump, dead_jump_sup and the worst place, and the same figures without copies where there are any."""
    tolerance = baked.scene.settings.placement.backface_tolerance
    places, level = open_places(baked.surfaces.geometry, baked.probes.octree.positions, edges, tolerance, seed + 31)
    found = dead_jump(baked.texture, places, level)
    if copied(baked):
        before = dead_jump(without_copies(baked), places, level)
        found |= {f"{name}_without_copies": m for name, m in before.items()}
    if not len(places):
        return found, []
    each = dead_jumps(baked.texture, places, level)
    worst = int(each.argmax())
    return found, [Spot("dead_jump_sup", places[worst], places[worst], float(each[worst]))]


def _said(edges: Edges, in_the_open: Edges, copies: int) -> str:
    """The dead edges in a sentence."""
    total, some = len(edges.level), len(in_the_open.level)
    if not some:
        return f"none of {total:,} dead edges has a place in the open, so no light is copied and there is no dead_jump"
    return (
        f"{some:,} of {total:,} dead edges have places in the open; {copies:,} probes take a neighbour's light for them"
    )
