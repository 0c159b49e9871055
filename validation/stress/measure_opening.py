"""Case B8: an opening so small that hardly a ray finds it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...reference.errors import InputError
from ...reference.pipeline.surfaces import bake_surfaces, gather_at_points, light_patches
from .case import Reading
from .cases_radiosity import OPENING
from .scenes import box_faces, grey, owners, plate, quads_mesh, scene_of
from .until_decided import mean_of, share_of, until_decided

RAYS_EACH, CLOSED_EACH, LOOKS = 12, 3, 6  # bakes a look
POINTS, RAYS_NOISE, CLOSED_NOISE = 64, 0.02, 5e-4
PATCH = 0.34


def tiny_opening(area: float, seed: int) -> Mapping[str, Reading]:
    """A lit and a black room of 1 m³, a thin black wall between with a square hole of `area` m². Power that reaches the black room, of
    that which falls on the hole: by rays, and by closed forms, the mean over seeds; the least and the most of any seed (not a number
    where the solver refuses); and the seeds in which rays find nothing, their number and share."""
    rays: list[float] = []
    closed: list[float] = []

    def look(k: int) -> Mapping[str, Reading]:
        for number in range(RAYS_EACH * (k - 1), RAYS_EACH * k):
            rays.append(_through(area, RAYS_NOISE, 1000 * seed + number))
        for number in range(CLOSED_EACH * (k - 1), CLOSED_EACH * k):
            closed.append(_through(area, CLOSED_NOISE, 1000 * seed + number))
        dark = sum(x == 0.0 for x in rays)
        return {
            "rays (ours)": mean_of(rays),
            "closed forms (ours)": mean_of(closed),
            "least of any seed": Reading(float(np.min(rays + closed)), 0.0, len(rays) + len(closed)),
            "most of any seed, closed forms": Reading(float(np.max(closed)), 0.0, len(closed)),
            "seeds without an answer, rays": Reading(float(dark), 0.0, len(rays)),
            "share without an answer, rays": share_of(dark, len(rays)),
        }

    return until_decided(OPENING, area, look, LOOKS)


def _through(area: float, noise: float, seed: int) -> float:
    """Power in the black room over what falls on the hole; not a number where there is no solution."""
    lo, hi = 0.5 - 0.5 * math.sqrt(area), 0.5 + 0.5 * math.sqrt(area)
    spans = [((0, 1), (0, lo)), ((0, 1), (hi, 1)), ((0, lo), (lo, hi)), ((hi, 1), (lo, hi))]  # y, z
    wall = [np.array([[1, y[0], z[0]], [1, y[1], z[0]], [1, y[1], z[1]], [1, y[0], z[1]]]) for y, z in spans]
    faces = box_faces((0, 0, 0), (2, 1, 1))
    lit = [quads_mesh([np.minimum(f[0], (1, 1, 1))]) for i, f in enumerate(faces) if i != 1]
    dark = [quads_mesh([np.maximum(f[0], (1, 0, 0))], material=1) for i, f in enumerate(faces) if i != 0]
    lamp = quads_mesh([plate((0.3, 0.6), (0.3, 0.6), 0.95, up=False)], exitance=1.0)
    materials = [grey(0.5), grey(0.0), grey(0.0, two_sided=True)]
    s = scene_of(
        [*lit, *dark, quads_mesh(np.array(wall), material=2), lamp],
        materials,
        radiosity={"patch_size": PATCH, "noise": noise},
    )
    surfaces = bake_surfaces(s, seed)
    try:
        light, p = light_patches(s, surfaces, seed), surfaces.patches
    except InputError:  # form factors that are not finite: no answer
        return math.nan
    owner = owners(surfaces.geometry, p)
    inside = (owner >= len(lit)) & (owner < len(lit) + len(dark))
    arrived = float(p.area[inside] @ light.radiosity.irradiance[inside, 0])
    at = np.random.default_rng([seed, 11]).uniform(lo, hi, (POINTS, 3))
    at[:, 0] = 1.0 - 1e-5
    towards = np.tile([-1.0, 0.0, 0.0], (POINTS, 1))
    return arrived / (area * float(gather_at_points(s, surfaces, light, at, towards, seed)[:, 0].mean()))
