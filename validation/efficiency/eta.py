"""Placement efficiency: η(e) = cost of a uniform grid with error e / cost of the adaptive placement with error e.

Under 1 the octree is a failure (failure-catalogue, "Metrics"). Cost is the number of probes, with and without invalid ones,
bytes, or the time of an update. The grid's time is that of its form factors at the rate at which ours were gathered; ours is
measured, with the filling of tiles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64
from ..statistics.jackknife import se_of_rest
from .curve import Cost, GridRow, Key, cost_at

Z95 = 1.96


@dataclass(frozen=True)
class Eta:
    """value ± se; bound: "at least" or "at most" where the curve ends before the error is met. interval: 95 %, read off the curve where
    the error is Z95 standard errors larger and smaller; each end no farther than the curve goes."""

    value: float
    se: float
    bound: str
    interval: tuple[float, float]


def own_cost(cost: Mapping[str, float]) -> dict[Cost, float]:
    """Costs of a baked placement (`Baked.cost`) as the curve counts them. entries: what would take a grid as long as ours."""
    slower = cost["probe_update_ms"] / max(cost["probe_gather_ms"], 1e-9)
    return {
        "probes": cost["real_probes"],
        "valid_probes": cost["valid_probes"],
        "bytes": cost["probe_bytes"] + cost["texture_bytes"],
        "entries": cost["probe_entries"] * slower,
    }


def eta(
    curve: Sequence[GridRow], key: Key, cost: Cost, own: float, error: float, blocks: F64, placements: float = 0.0
) -> Eta:
    """η at our `error` for `own` cost. blocks (B,): our mean squares by block of points. placements: standard error of `error` from
    where our lattice falls.

    se: what η loses where our error is one standard error larger (near the floor the curve is flat, and a smaller error would cost
    a grid without bound). What counts is how far we are from the grid nearest in error, and points and reference are the same for
    both: so it is that of the difference, from blocks left out of both, with that of both placements in quadrature.
    """
    near = min(curve, key=lambda row: abs(row.error[key] - error))
    spread = math.hypot(_apart(blocks, near.blocks[key].mean(axis=0)), near.se[key], placements)
    found, worse, low, high = (cost_at(curve, key, cost, error + sigmas * spread) for sigmas in (0.0, 1.0, Z95, -Z95))
    return Eta(found.cost / own, (found.cost - worse.cost) / own, found.bound, (low.cost / own, high.cost / own))


def _apart(ours: F64, theirs: F64) -> float:
    """Standard error of the difference of two root mean squares from blocks (B,) of the same points."""
    mine, other = (np.sqrt(np.maximum(b.sum() - b, 0.0) / max(len(b) - 1, 1)) for b in (ours, theirs))
    return float(se_of_rest(list(mine - other)))
