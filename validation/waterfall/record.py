"""The waterfall as results.json holds it: `waterfall` of a scene, and the metrics that gates judge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..record import metric
from .links import LINKS, NAMES
from .measured import RAYS, Measured
from .reference import Reference, relative_noise
from .statistics import Waterfall
from .world import EXACT_RAYS, World

TINY = 1e-300


def waterfall_table(w: World, found: Measured) -> dict[str, Any]:
    """links: names and what they are made of. sets: by name, see `set_table`; meshes: the same by mesh, relative to the scene's mean
    light. reference, diffuse (absent where the bake sees all): paths and noise behind the stages by paths; needed: paths that would do,
    0 where these do. All figures are relative to the mean light, standard errors beside them."""
    return {
        "links": [{"name": link.name, "label": link.label, "says": link.says} for link in LINKS],
        "sets": {name: set_table(one) for name, one in found.sets.items()},
        "meshes": {name: set_table(one, cross=False) for name, one in found.meshes.items()},
        "reference": {**paths_table(found.reference), "needed": found.reference.needed},
        **({} if found.diffuse is None else {"diffuse": paths_table(found.diffuse)}),
        "rays": {"point": RAYS, "probe": w.probe_rays, "patch_times": EXACT_RAYS},
        "notes": list(found.notes),
    }


def paths_table(found: Reference) -> dict[str, Any]:
    """paths: a point. noise: standard error of the light there, root mean square over the mean."""
    return {"paths": found.spp, "noise": relative_noise(found.irradiance)}


def set_table(found: Waterfall, cross: bool = True) -> dict[str, Any]:
    """reference, W·m⁻²: mean light. links: by name signed, rms, correlation with the whole, share of the squared error. cross: terms
    of the squared error by pair of links, over the whole of it as it is seen, so that they and `remainder` add up to 1."""
    n = found.points
    links = {
        name: {
            "signed": metric(found.signed[i], found.signed_se[i], n),
            "rms": metric(found.rms[i], found.rms_se[i], n, **({"below_noise": True} if found.noisy[i] else {})),
            "correlation": metric(found.correlation[i], found.correlation_se[i], n),
            "share": metric(found.share[i], found.share_se[i], n),
        }
        for i, name in enumerate(NAMES)
    }
    table: dict[str, Any] = {
        "points": n,
        "reference": found.reference,
        "signed": metric(found.total_signed, found.total_signed_se, n),
        "rms": metric(found.total_rms, found.total_rms_se, n),
        "links": links,
        "remainder": 1.0 - found.explained,
        "explained": metric(found.explained, found.explained_se, n),
        "closure": found.closure,
    }
    return {**table, "cross": (found.cross / found.seen).tolist()} if cross else table


def waterfall_metrics(table: dict[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    """Of the scene's cameras together: `waterfall_explained`; `waterfall_closure`, the worst of all sets; and
    `waterfall_disagreement`: how many standard errors the whole of the links, against a reference of its own, lies from the error that
    the run `measured` without them. Links add up whatever they are; this fails where they are links of something else."""
    whole = table["sets"]["camera"]
    worst = max(one["closure"] for one in table["sets"].values())
    found = {
        "waterfall_explained": whole["explained"],
        "waterfall_closure": metric(worst, None, whole["points"]),
    }
    own = measured.get("relrmse_lod", measured.get("relrmse"))
    if own is not None:
        away = abs(whole["rms"]["value"] - own["value"]) / max(math.hypot(whole["rms"]["se"], own["se"]), TINY)
        found["waterfall_disagreement"] = metric(away, None, whole["points"])
    return found
