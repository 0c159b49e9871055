"""Placement efficiency: η(e) = cost of a uniform grid with error e / cost of the adaptive placement with error e.

Under 1 the octree is a failure (failure-catalogue, "Metrics"). Cost is the number of probes, with and without invalid ones,
bytes, or the time of an update. The grid's time is that of its form factors at the rate at which ours were gathered; ours is
measured, with the filling of tiles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..metrics.error import Measured
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


def eta(curve: Sequence[GridRow], key: Key, cost: Cost, own: float, reached: Measured) -> Eta:
    """η at the error `reached` for `own` cost. se: what it loses where the error is one standard error larger (near the floor
    the curve is flat, and a smaller error would cost a grid without bound): that of the points, and that of the grid nearest in
    error, whose shifts differ, in quadrature."""
    near = min(curve, key=lambda row: abs(row.error[key] - reached.value))
    spread = math.hypot(reached.se, near.se[key])
    found, worse, low, high = (
        cost_at(curve, key, cost, reached.value + sigmas * spread) for sigmas in (0.0, 1.0, Z95, -Z95)
    )
    return Eta(found.cost / own, (found.cost - worse.cost) / own, found.bound, (low.cost / own, high.cost / own))
