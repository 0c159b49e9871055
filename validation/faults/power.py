"""From the sound product's runs over many seeds: how often gates cry wolf, and how surely they notice a one per cent error of energy.

An error of energy e multiplies light by 1 + e. A bias b, measured relative to light that has not the error, becomes (1 + b)(1 + e) - 1
with a standard error (1 + e) times as large; a reference with the error turns it into (1 + b) / (1 + e) - 1. So each sound run says
what its gates would have said of the error, in every place where light may gain it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import beta, norm

from ..gates import SIGMAS, Limit

ERROR = 0.01
LEVEL = 0.95
# Where light may gain the error -> metrics of a scene that then change, and whether the light is the reference they are relative to.
STAGES: Mapping[str, Mapping[str, bool]] = {
    "light of patches, and so all after it": {"patch_bias": False, "exact_bias": False, "bias": False},
    "light of probes, or later": {"exact_bias": False, "bias": False},
    "the path-traced reference": {"truth_exact_bias": False, "patch_bias": True, "bias": True},
}


def bounds(hits: int, trials: int) -> tuple[float, float]:
    """Clopper and Pearson's interval (1934) of level LEVEL for a share."""
    tail = 0.5 * (1.0 - LEVEL)
    low = float(beta.ppf(tail, hits, trials - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, trials - hits)) if hits < trials else 1.0
    return low, high


def false_alarms(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Sound runs that a gate flagged."""
    flagged = [{"seed": r["seed"], "scene": r["scene"], "flags": r["flags"]} for r in runs if r["flags"]]
    low, high = bounds(len(flagged), len(runs)) if runs else (0.0, 1.0)
    return {"runs": len(runs), "flagged": len(flagged), "share": [low, high], "which": flagged}


def with_error(entry: Mapping[str, Any], error: float, of_reference: bool) -> dict[str, Any]:
    """A bias, as results.json holds it, if light had gained `error`."""
    factor = 1.0 / (1.0 + error) if of_reference else 1.0 + error
    changed = dict(entry) | {"value": (1.0 + entry["value"]) * factor - 1.0}
    if entry.get("se") is not None:
        changed["se"] = entry["se"] * factor
    return changed


def excess(metrics: Mapping[str, Any], limits: Mapping[str, Limit], stage: str, error: float) -> float:
    """How far beyond its limits, with the two standard errors that gates ask for, an error of energy moves the metric that it moves
    furthest; above 0 a gate notices."""
    found = [-math.inf]
    for name, of_reference in STAGES[stage].items():
        if name in metrics and name in limits:
            moved, limit = with_error(metrics[name], error, of_reference), limits[name]
            doubt = SIGMAS * (moved.get("se") or 0.0)
            found += [moved["value"] + doubt - limit.max] if limit.max is not None else []
            found += [limit.min - moved["value"] + doubt] if limit.min is not None else []
    return max(found)


def energy_power(runs: Sequence[Mapping[str, Any]], limits: Mapping[str, Mapping[str, Limit]]) -> list[dict[str, Any]]:
    """Per stage and sign: in how many sound runs the error would have been noticed."""
    rows = []
    for stage in STAGES:
        for error in (ERROR, -ERROR):
            found = [excess(r["metrics"], limits[r["scene"]], stage, error) for r in runs]
            hits = sum(x > 0.0 for x in found)
            low, high = bounds(hits, len(runs)) if runs else (0.0, 1.0)
            row: dict[str, Any] = {
                "stage": stage,
                "error": error,
                "noticed": hits,
                "runs": len(runs),
                "share": [low, high],
            }
            if len(found) > 1 and (spread := float(np.std(found, ddof=1))) > 0.0:
                row["sigmas"] = float(np.mean(found)) / spread
                row["normal"] = float(norm.cdf(float(row["sigmas"])))
            rows.append(row)
    return rows


def smallest_caught(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Per fault of a size: the smallest size down to which all were caught, and the largest that was missed."""
    found = []
    for name in dict.fromkeys(r["id"] for r in rows if r["size"] is not None):
        mine = sorted((r for r in rows if r["id"] == name), key=lambda r: -r["size"])
        missed = next((r["size"] for r in mine if not r["caught"]), None)
        caught = [r["size"] for r in mine if missed is None or r["size"] > missed]
        found.append({"id": name, "title": mine[0]["title"], "caught": min(caught, default=None), "missed": missed})
    return found


def margins(runs: Sequence[Mapping[str, Any]], limits: Mapping[str, Mapping[str, Limit]]) -> list[dict[str, Any]]:
    """How far each metric of sound runs stays from being flagged, in its standard errors beyond the two that gates ask for, and
    the chance of a false alarm that this means if its error is normal; the thinnest first. Metrics without a standard error are
    not random."""
    rows = []
    for run in runs:
        for name, limit in limits[run["scene"]].items():
            entry = run["metrics"].get(name)
            if entry is None or not entry.get("se"):
                continue
            room = [limit.max - entry["value"]] if limit.max is not None else []
            room += [entry["value"] - limit.min] if limit.min is not None else []
            sigmas = min(room) / entry["se"] - SIGMAS
            rows.append({"scene": run["scene"], "metric": name, "sigmas": sigmas, "chance": float(norm.sf(sigmas))})
    return sorted(rows, key=lambda row: row["sigmas"])
