"""Which probes a leak comes from, and through which wall.

A place leaks by what its irradiance E would change by if the probes that it cannot see did not count,

    ΔE = E - Σ_visible w e / Σ_visible w,   e the irradiance that a probe's light makes there,

relative to the mean light. Where a scene is dark by construction, ΔE = E: all light there has leaked. A probe is
unseen if the segment to it meets a surface; elsewhere than in the dark that must be the face of a wall, thinner than the
voxel reaches: light that comes round a corner or over a hill belongs to no wall.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I64, Bool
from ...reference.visibility import Geometry, cast, to_box, vectors
from .field import LightField, Places, holding_level
from .walls import Walls, walls_behind
from .weights import ProbeWeights, probe_weights, sums

LEAKS = 1e-3  # of the mean light: what counts as a leak
LEAKS_IN_DARK = 1e-6  # where there should be none at all
NEARLY = 1.0 - 1e-4  # a surface this near to the probe, as a share of the way, is not between


@dataclass(frozen=True, eq=False)
class Pairs:
    """Places and probes that they read, by `ProbeWeights`. light (M,): W·m⁻² that each probe gives the place. unseen (M,)
    bool. triangle (M,) first surface on the way, crossing (M, 3) m where, where unseen."""

    weights: ProbeWeights
    light: F64
    unseen: Bool
    triangle: I64
    crossing: F64


@dataclass(frozen=True, eq=False)
class Leaks:
    """What was found at N places. strength (N,): leaked light over the mean light, signed. leaks (N,) bool. answers, holds
    (N,) levels: of the voxel that answers, and of the finest voxel there. pairs: of the places that leak.
    """

    strength: F64
    leaks: Bool
    answers: I64
    holds: I64
    pairs: Pairs


def find_leaks(field: LightField, at: Places, dark: Bool | None, mean_light: float) -> Leaks:
    """Leaks at places. dark (N,): whether there should be no light, None where the scene does not say; then only places
    in the dark are looked at. mean_light, W·m⁻², is what strengths are relative to."""
    weights = probe_weights(field.texture, field.layout, field.source, at.positions)
    return leaks_by(field, at, dark, mean_light, weights, holding_level(field.octree, at.positions))


def leaks_by(
    field: LightField, at: Places, dark: Bool | None, mean_light: float, weights: ProbeWeights, holds: I64
) -> Leaks:
    """Leaks at places that read probes by `weights`, in voxels of levels `holds` (N,): see `find_leaks`."""
    total = sums(weights.sample, weights.weight, at.count)
    raw = _given(field, at, weights)
    share = weights.weight / np.maximum(total[weights.sample], np.finfo(np.float64).tiny)
    light = share * raw
    irradiance = sums(weights.sample, light, at.count)
    if dark is None:
        looked_at = np.ones(at.count, dtype=np.bool_)
    else:
        magnitude = sums(weights.sample, np.abs(light), at.count)
        looked_at = dark & (magnitude > LEAKS_IN_DARK * mean_light)
    chosen = np.flatnonzero(looked_at[weights.sample])
    pairs = _seen_pairs(field, at, weights, light, chosen)
    if dark is None:
        pairs = _through_walls(field, pairs, at, np.minimum(holds, weights.level))
        strength = _unseen_change(pairs, share[chosen], irradiance, at.count) / mean_light
        leaks = np.abs(strength) > LEAKS
    else:
        strength = np.where(looked_at, irradiance, 0.0) / mean_light
        leaks = looked_at
    return Leaks(strength, leaks, weights.level.astype(np.int64), holds, _only(pairs, leaks))


def _given(field: LightField, at: Places, weights: ProbeWeights) -> F64:
    """Irradiance (M,) W·m⁻², the mean of its channels, that each probe's light would make alone. Black probes, nearly all in the dark,
    are not asked."""
    lit = np.flatnonzero((field.coefficients != 0.0).reshape(-1, 12).any(axis=1)[weights.probe])
    given = np.zeros(len(weights.probe))
    response, light = at.response[weights.sample[lit]], field.coefficients[weights.probe[lit]]
    given[lit] = np.einsum("mk,mkc->mc", response, light).mean(axis=1)
    return given


def _through_walls(field: LightField, pairs: Pairs, at: Places, level: I64) -> Pairs:
    """The pairs, unseen only where a wall lies between that is thinner than the voxel of the place, at `level` (N,), reaches."""
    blocked = np.flatnonzero(pairs.unseen)
    size = field.octree.grid.finest * 2.0 ** (field.octree.grid.level - level[pairs.weights.sample[blocked]])
    unseen = np.zeros_like(pairs.unseen)
    unseen[blocked] = walls_crossed(field.geometry, pairs, at, blocked).need < size
    return dataclasses.replace(pairs, unseen=unseen)


def _seen_pairs(field: LightField, at: Places, weights: ProbeWeights, light: F64, chosen: I64) -> Pairs:
    sample, probe = weights.sample[chosen], weights.probe[chosen]
    unseen, triangle, crossing = crossings(field.geometry, at.positions[sample], field.octree.positions[probe])
    part = ProbeWeights(sample, probe, weights.weight[chosen], weights.level)
    return Pairs(part, light[chosen], unseen, triangle, crossing)


def crossings(g: Geometry, start: F64, end: F64) -> tuple[Bool, I64, F64]:
    """Whether a surface lies between `start` and `end` (M, 3) m: (M,); its triangle (M,) and place (M, 3), the first from
    the start."""
    way = end - start
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
    if len(start) == 0:
        return np.zeros(0, np.bool_), np.zeros(0, np.int64), np.zeros((0, 3))
    hits = cast(g, to_box(g, start), vectors(direction))
    distance = np.array(hits.t, dtype=np.float64)
    between = np.array(hits.hit) & (distance < NEARLY * length)
    triangle = np.array(hits.triangle).astype(np.int64)
    return between, triangle, start + np.where(between, distance, 0.0)[:, None] * direction


def _unseen_change(pairs: Pairs, share: F64, irradiance: F64, count: int) -> F64:
    """E less the irradiance from seen probes alone (N,), W·m⁻²; E where none is seen."""
    sample, seen = pairs.weights.sample, ~pairs.unseen
    weight = sums(sample, share * seen, count)
    light = sums(sample, pairs.light * seen, count)
    from_seen = np.divide(light, weight, out=np.zeros(count), where=weight > 1e-9)
    any_unseen = sums(sample, pairs.unseen, count) > 0
    return np.where(any_unseen, irradiance - from_seen, 0.0)


def _only(pairs: Pairs, leaks: Bool) -> Pairs:
    """Pairs of the places that leak."""
    w = pairs.weights
    keep = leaks[w.sample]
    part = ProbeWeights(w.sample[keep], w.probe[keep], w.weight[keep], w.level)
    return Pairs(part, pairs.light[keep], pairs.unseen[keep], pairs.triangle[keep], pairs.crossing[keep])


def blamed(leaks: Leaks) -> Bool:
    """Which pairs (M,) carry the leak: unseen probes with light of more than a hundredth of the place's."""
    pairs = leaks.pairs
    largest = np.zeros(len(leaks.strength))
    np.maximum.at(largest, pairs.weights.sample, np.abs(pairs.light))
    return np.asarray(pairs.unseen & (np.abs(pairs.light) > 0.01 * largest[pairs.weights.sample]))


def walls_crossed(g: Geometry, pairs: Pairs, at: Places, chosen: I64) -> Walls:
    """The wall (K,) at the crossings of `chosen` pairs (K,), as seen from the place's side."""
    crossing, triangle = pairs.crossing[chosen], pairs.triangle[chosen]
    towards = at.positions[pairs.weights.sample[chosen]] - crossing
    normals = g.normals[triangle]
    facing = np.where(np.einsum("ni,ni->n", normals, towards) < 0.0, -1.0, 1.0)[:, None] * normals
    return walls_behind(g, crossing, facing, triangle)
