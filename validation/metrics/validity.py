"""Validity against the winding number: how well the share of back faces tells what stands inside something (failure-catalogue C4).

    AUC = P(share inside > share outside) + ½ P(equal) = U / (n₁ n₀)          (Mann and Whitney 1947)

Its standard error is that of Hanley and McNeil (1982). Judged at probes, by the share that decides their validity, and at places
near closed surfaces, within one voxel of them, by rays of their own. Where some one-sided surface is not closed the oracle knows
only the closed ones and the figures have other names (`_open`): a probe under a single sheet then counts as a false alarm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import mannwhitneyu

from ...reference.datatypes import F64, Bool
from ...reference.placement.validity import back_share
from ...reference.placement.winding import Solids, closed_solids, inside
from ...reference.visibility import Geometry
from .error import Measured

MOST_PROBES, MOST_NEAR = 2000, 1000
MOST_PAIRS = 4_000_000  # points × triangles the oracle may cost
FEWEST = 20  # points inside and outside without which nothing is said


@dataclass(frozen=True, eq=False)
class Judged:
    """Places with their share of back faces (N,) and whether they lie in something solid (N,)."""

    share: F64
    solid: Bool


@dataclass(frozen=True, eq=False)
class Validity:
    """metrics by name; notes: why one is absent; judged: probes and places together, or None where no mesh is closed."""

    metrics: dict[str, Measured]
    notes: list[str]
    judged: Judged | None


def measure_validity(g: Geometry, positions: F64, share: F64, voxel: float, tolerance: float, seed: int) -> Validity:
    """validity_auc (probes), validity_auc_near, validity_wrong (share of both that `tolerance` gets wrong), or the same with `_open`.

    positions (R, 3) m and share (R,): probes and their shares of back faces. voxel: how far, m, from surfaces the places lie.
    """
    solids = closed_solids(g)
    most = MOST_PAIRS // max(solids.triangles, 1)
    if not solids.faces or most < 2 * FEWEST:
        why = f"{solids.triangles} triangles are too many for the oracle" if solids.faces else "no mesh is closed"
        return Validity({}, [f"no validity metrics: {why}"], None)
    rng = np.random.default_rng([seed, 29])
    chosen = rng.permutation(len(positions))[: min(MOST_PROBES, 2 * most // 3)]
    probes = Judged(share[chosen], inside(solids, positions[chosen]))
    places = _near(solids, min(MOST_NEAR, most // 3), voxel, rng)
    near = Judged(back_share(g, places, seed + 29), inside(solids, places))
    both = Judged(np.concatenate([probes.share, near.share]), np.concatenate([probes.solid, near.solid]))
    suffix = "_open" if solids.open_triangles else ""
    metrics, notes = {}, []
    for name, what, j in (("validity_auc", "probes", probes), ("validity_auc_near", "places near surfaces", near)):
        if min(j.solid.sum(), (~j.solid).sum()) < FEWEST:
            notes.append(f"no {name}{suffix}: {int(j.solid.sum())} of {len(j.solid)} {what} lie inside something")
        else:
            metrics[name + suffix] = area_under_curve(j)
    wrong = float(((both.share > tolerance) != both.solid).mean())
    n = len(both.solid)
    metrics["validity_wrong" + suffix] = Measured(wrong, math.sqrt(wrong * (1.0 - wrong) / n), n)
    return Validity(metrics, notes, both)


def area_under_curve(j: Judged) -> Measured:
    """Area under the ROC curve with its standard error; both kinds must be there."""
    solid, free = j.share[j.solid], j.share[~j.solid]
    n1, n0 = len(solid), len(free)
    auc = float(mannwhitneyu(solid, free).statistic) / (n1 * n0)
    q1, q2 = auc / (2.0 - auc), 2.0 * auc**2 / (1.0 + auc)
    variance = (auc * (1.0 - auc) + (n1 - 1) * (q1 - auc**2) + (n0 - 1) * (q2 - auc**2)) / (n1 * n0)
    return Measured(auc, math.sqrt(max(variance, 0.0)), n1 + n0)


def rates(j: Judged, tolerance: float) -> tuple[float, float]:
    """One point of the ROC curve: share of solid places that are called valid, share of free ones that are called invalid; 0 where
    there are none."""
    invalid = j.share > tolerance
    missed, alarms = (~invalid)[j.solid], invalid[~j.solid]
    return float(missed.mean()) if len(missed) else 0.0, float(alarms.mean()) if len(alarms) else 0.0


def _near(solids: Solids, count: int, reach: float, rng: np.random.Generator) -> F64:
    """Places (count, 3) m uniform over the closed surfaces, moved along the normal by up to `reach`, m, to either side."""
    corners = solids.vertices[np.concatenate(solids.faces)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    triangle = rng.choice(len(area), size=count, p=area / area.sum())
    u, v = np.sort(rng.random((2, count)), axis=0)
    weights = np.stack([u, v - u, 1.0 - v], axis=1)
    on = np.einsum("nk,nki->ni", weights, corners[triangle])
    normal = cross[triangle] / area[triangle, None]
    return np.asarray(on + rng.uniform(-reach, reach, (count, 1)) * normal)
