"""Outdoors under leaves (failure-catalogue C8): what the bake leaves out, and what that costs.

Black cards of 1 m in one layer above the places, in as many of the layer's cells as the cover says, evenly spread (an R2 sequence,
Roberts 2018). Each ray to the sky passes the layer once, so that in the mean over places the light that comes down is 1 - cover s
of the open sky's, s the share that the layer's disc sends (form factor of a disc: r² / (r² + h²)): a closed form for all three.

    static    the cards are in the bake
    moving    role = "moving": the bake does not see them, the truth does
    masked    one sheet, of whose texture the mask leaves `cover`: the bake takes it for whole
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference import pipeline
from ...reference.config import TruthSettings
from ...reference.datatypes import F64, Material, Mesh, Scene
from ...reference.progress import silent
from ...reference.truth.mitsuba_scene import build_truth_scene
from ...reference.truth.path_traced import Estimate, estimate
from ...reference.truth.points import Points
from ...reference.variant import ensure_variant
from ...reference.volume.sampler import sample
from .case import Reading
from .scenes import even_sky, grey, mesh, quad, scene_of

HALF, HEIGHT = 16, 3.0  # of the layer, m
BOX, LOW, HIGH = 3.0, 0.2, 1.0  # half the side of the volume in which places lie, and their heights, m
VOXEL, BLACK = 0.5, 0.02
PLACES, DEPTH = 150, 4
SPREAD = np.array([0.7548776662466927, 0.5698402909980532])  # powers of the inverse plastic number
TEXELS = 64  # of the mask, a side: it is repeated in no direction
GROUND, SHEET, MASKED = 0, 1, 2  # numbers of the materials


def under_leaves(cover_percent: float, seed: int) -> Mapping[str, Reading]:
    """By kind of leaves: mean of ours over mean of the truth, minus 1; `over_floor`: the same of cards in the bake over what exact
    SH of order 1 at the very places gives; `truth`: light that comes down through cards over the closed form, minus 1."""
    ensure_variant()
    cover = cover_percent / 100.0
    rng = np.random.default_rng([seed, 108])
    cell = np.stack(np.unravel_index(np.arange((2 * HALF) ** 2), (2 * HALF, 2 * HALF)), axis=1) @ SPREAD + rng.random()
    cells = np.flatnonzero(cell % 1.0 < cover)
    points = _places(rng)
    found: dict[str, Reading] = {}
    cards, mask = _cards(cells), _masked(cover, rng)
    kinds: dict[str, tuple[Mesh, Material | None]] = {
        "static": (cards, None), "moving": (dataclasses.replace(cards, static=False), None), "masked": mask,
    }  # fmt: skip
    truths: dict[str, Estimate] = {}
    for name, (leaves, material) in kinds.items():
        made = _forest(leaves, material)
        if name != "moving":  # the truth does not ask whether cards move
            truths[name] = estimate(
                build_truth_scene(made), points, TruthSettings(noise=0.05, max_spp=512), DEPTH, seed, silent
            )
        truth = truths.get(name, truths["static"])
        ours = _sampled(made, points, seed)
        found[name] = _bias(ours, truth)
        if name == "static":
            found["over_floor"] = _bias(ours, _floor(truth))
            open_sky = Estimate(np.full((2, PLACES, 3), math.pi * (1.0 - cover * layer_share())), None, 1, 1)
            found["truth"] = _bias(truth.mean, open_sky)
    return found


def excess(cover_percent: float) -> float:
    """What leaving the layer out adds: 1/(1 - cover s) - 1, at mid-height of the places."""
    return 1.0 / (1.0 - cover_percent / 100.0 * layer_share()) - 1.0


def lost_l1(cover_percent: float) -> tuple[float, float]:
    """What order 1 makes of light that comes in over the layer's rim, for cards and for a layer without gaps: mean irradiance over
    the true one, minus 1. Up to the rim's height u = sin(elevation) SH of order 1 gives 2π ∫ (1/4 + u/2) du instead of 2π ∫ u
    du."""
    cover, u = cover_percent / 100.0, math.sqrt(1.0 - layer_share())
    rim, below = 0.5 * (u + u * u), 1.0 - cover * layer_share()
    return (1.0 - cover + cover * rim) / below - 1.0, rim / below - 1.0


def layer_share() -> float:
    """Share of an open sky's light that comes through the layer's disc of equal area, for a place at mid-height that faces up."""
    square = (2.0 * HALF) ** 2 / math.pi
    return square / (square + (HEIGHT - 0.5 * (LOW + HIGH)) ** 2)


def _places(rng: np.random.Generator) -> Points:
    """Places in the volume that face up."""
    at = rng.uniform((-BOX, LOW, -BOX), (BOX, HIGH, BOX), (PLACES, 3))
    return Points(at, np.tile([0.0, 1.0, 0.0], (PLACES, 1)), np.full(PLACES, -1, dtype=np.int32))


def _cards(cells: npt.NDArray[np.integer]) -> Mesh:
    """One mesh of cards over `cells` (N,) of the layer, row by row."""
    corner = np.stack([cells // (2 * HALF) - HALF, np.full(len(cells), HEIGHT), cells % (2 * HALF) - HALF], axis=1)
    around = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]])
    first = 4 * np.arange(len(cells))[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return mesh((corner[:, None] + around).reshape(-1, 3), faces, SHEET, name="leaves", lit_by_probes=False)


def _masked(cover: float, rng: np.random.Generator) -> tuple[Mesh, Material]:
    """The whole layer as one sheet with a mask, and its material as the glTF loader makes it of a mask."""
    mask = np.zeros(TEXELS**2, dtype=np.float32)
    mask[rng.permutation(TEXELS**2)[: round(cover * TEXELS**2)]] = 1.0
    leaves = Material("leaves", np.full(3, BLACK), two_sided=True, opacity=mask.reshape(TEXELS, TEXELS))
    size = 2.0 * HALF
    sheet = quad(
        (-HALF, HEIGHT, -HALF), (0, 0, size), (size, 0, 0), name="leaves", material=MASKED, lit_by_probes=False
    )
    return dataclasses.replace(sheet, uvs=np.array([[0, 0], [0, 1], [1, 1], [1, 0]], dtype=np.float32)), leaves


def _forest(leaves: Mesh, material: Material | None) -> Scene:
    """Ground, sky and leaves, with probes in a volume around the places."""
    side = 4.0 * HALF
    ground = quad(
        (-2 * HALF, 0, -2 * HALF), (0, 0, side), (side, 0, 0), name="ground", material=GROUND, lit_by_probes=False
    )
    settings: dict[str, Any] = {
        "volumes": {"places": {"min": [-BOX, 0.0, -BOX], "max": [BOX, HIGH, BOX]}},
        "placement": {"min_voxel": VOXEL, "probe_rays": 512, "touching": True},
        "radiosity": {"patch_size": 8.0, "rays": 64, "noise": 0.1},
    }
    materials = [grey(BLACK), grey(BLACK, two_sided=True), *([material] if material else [])]
    return scene_of([ground, leaves], materials, even_sky(1.0), **settings)


def _sampled(made: Scene, points: Points, seed: int) -> F64:
    """Irradiance (N, 3) from the product's probes, the whole chain."""
    surfaces = pipeline.bake_surfaces(made, seed)
    probes = pipeline.trace_probes(made, surfaces, pipeline.place(made, surfaces, seed), seed)
    light = pipeline.light_patches(made, surfaces, seed)
    texture = pipeline.virtual_texture(probes, pipeline.update(made, surfaces, probes, light).texels)
    return sample(texture, points.positions, points.normals).irradiance.astype(np.float64)


def _floor(truth: Estimate) -> Estimate:
    """What exact SH of order 1 gives there."""
    if truth.l1 is None:
        raise ValueError("the truth must hold the L1 floor")
    return dataclasses.replace(truth, irradiance=truth.l1)


def _bias(ours: F64, truth: Estimate) -> Reading:
    """Mean of ours over mean of the truth, minus 1, with the error of a ratio of means over places."""
    reference = truth.mean
    ratio = float(ours.mean() / reference.mean())
    rest = (ours - ratio * reference).mean(axis=1)
    return Reading(
        ratio - 1.0, float(rest.std(ddof=1)) / math.sqrt(PLACES) / float(reference.mean()), PLACES, PLACES - 1
    )
