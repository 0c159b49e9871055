"""Case B8: an opening so small that hardly a ray finds it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from ...reference.datatypes import F64, Scene
from ...reference.errors import InputError
from ...reference.pipeline.surfaces import bake_surfaces, gather_at_points, light_patches
from .case import Reading
from .cases_radiosity import OPENING
from .scenes import box_faces, grey, owners, plate, quads_mesh, scene_of
from .until_decided import mean_of, share_of, until_decided

RAYS_EACH, CLOSED_EACH, LOOKS = 12, 3, 6  # bakes a look
GRID, RAYS_NOISE, CLOSED_NOISE = 8, 0.02, 5e-4  # jittered places an edge of the hole
PATCH, DECADE = 0.34, 10.0
RAYS_FROM, CLOSED_FROM = 1e-2, 1e-3  # m²: from here on enough rays find the hole for an exponent


def tiny_opening(area: float, seed: int) -> Mapping[str, Reading]:
    """A lit and a black room of 1 m³, a thin black wall between with a square hole of `area` m² (of 1: no wall). Power that reaches the
    black room, of that which falls on the hole: by rays, and by closed forms, the mean over seeds; the least and the most of any seed
    (not a number where the solver refuses); the seeds in which rays find nothing, their number and share; exponents of the power in the
    area, over the decade below `area`: relative to what falls on a square metre of the hole, and as it is."""
    ways = {"rays": (RAYS_NOISE, RAYS_EACH, RAYS_FROM), "closed forms": (CLOSED_NOISE, CLOSED_EACH, CLOSED_FROM)}

    def look(k: int) -> Mapping[str, Reading]:
        found, shares = {}, {}
        for name, (noise, each, least) in ways.items():
            seeds = [1000 * seed + number for number in range(each * k)]
            here = np.array([_powers(area, noise, number) for number in seeds])
            shares[name] = (here[:, 0] / (area * here[:, 1])).tolist()
            found[f"{name} (ours)"] = mean_of(shares[name])
            if area / DECADE >= least * 0.999:
                below = np.array([_powers(area / DECADE, noise, number) for number in seeds])
                found[f"exponent, {name}"] = _exponent(here[:, 0] / here[:, 1], below[:, 0] / below[:, 1])
                found[f"exponent of the power, {name}"] = _exponent(here[:, 0], below[:, 0])
        dark = sum(x == 0.0 for x in shares["rays"])
        every = shares["rays"] + shares["closed forms"]
        return {
            **found,
            "least of any seed": Reading(float(np.min(every)), 0.0, len(every)),
            "most of any seed, closed forms": Reading(float(np.max(shares["closed forms"])), 0.0, len(every)),
            "seeds without an answer, rays": Reading(float(dark), 0.0, len(shares["rays"])),
            "share without an answer, rays": share_of(dark, len(shares["rays"])),
        }

    return until_decided(OPENING, area, look, LOOKS)


def _exponent(here: F64, below: F64) -> Reading:
    """ln(P(a) / P(a / 10)) / ln 10 from the means over seeds (S,) at both areas, with its standard error to first order."""
    a, b = mean_of(here.tolist()), mean_of(below.tolist())
    if not (a.value > 0.0 and b.value > 0.0):
        return Reading(math.nan, 0.0, len(here))
    se = math.hypot(a.se / a.value, b.se / b.value) / math.log(DECADE)
    return Reading(math.log(a.value / b.value) / math.log(DECADE), se, len(here), len(here) - 1)


def _rooms(area: float, noise: float) -> tuple[Scene, range]:
    """The scene, and the numbers of the black room's meshes."""
    lo, hi = 0.5 - 0.5 * math.sqrt(area), 0.5 + 0.5 * math.sqrt(area)
    spans = [((0, 1), (0, lo)), ((0, 1), (hi, 1)), ((0, lo), (lo, hi)), ((hi, 1), (lo, hi))]  # y, z
    wall = [np.array([[1, y[0], z[0]], [1, y[1], z[0]], [1, y[1], z[1]], [1, y[0], z[1]]]) for y, z in spans]
    faces = box_faces((0, 0, 0), (2, 1, 1))
    lit = [quads_mesh([np.minimum(f[0], (1, 1, 1))]) for i, f in enumerate(faces) if i != 1]
    dark = [quads_mesh([np.maximum(f[0], (1, 0, 0))], material=1) for i, f in enumerate(faces) if i != 0]
    lamp = quads_mesh([plate((0.3, 0.6), (0.3, 0.6), 0.95, up=False)], exitance=1.0)
    between = [quads_mesh(np.array(wall), material=2)] if area < 1.0 else []
    materials = [grey(0.5), grey(0.0), grey(0.0, two_sided=True)]
    made = scene_of([*lit, *dark, *between, lamp], materials, radiosity={"patch_size": PATCH, "noise": noise})
    return made, range(len(lit), len(lit) + len(dark))


@cache
def _powers(area: float, noise: float, seed: int) -> tuple[float, float]:
    """Power in the black room, W, and what falls on a square metre of the hole, W·m⁻²; not a number where there is no solution."""
    s, black = _rooms(area, noise)
    surfaces = bake_surfaces(s, seed)
    try:
        light, p = light_patches(s, surfaces, seed), surfaces.patches
    except InputError:  # form factors that are not finite: no answer
        return math.nan, math.nan
    owner = owners(surfaces.geometry, p)
    inside = (owner >= black.start) & (owner < black.stop)
    arrived = float(p.area[inside] @ light.radiosity.irradiance[inside, 0])
    edge = math.sqrt(area)
    cells = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID), indexing="ij"), axis=-1).reshape(-1, 2)
    places = (cells + np.random.default_rng([seed, 11]).random(cells.shape)) / GRID
    at = np.column_stack([np.full(len(places), 1.0 - 1e-5), 0.5 + edge * (places - 0.5)])
    towards = np.tile([-1.0, 0.0, 0.0], (len(at), 1))
    return arrived, float(gather_at_points(s, surfaces, light, at, towards, seed)[:, 0].mean())
