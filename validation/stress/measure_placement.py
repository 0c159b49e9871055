"""Where probes stand and which of them count: validity, harmonic mean distance, thin things (failure-catalogue C4, C5, C6)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from ...reference import pipeline
from ...reference.config_placement import PlacementSettings
from ...reference.datatypes import F64, Bool, Mesh
from ...reference.directions import sphere
from ...reference.lattice import Octree, cells, keys
from ...reference.placement.distance import harmonic_mean
from ...reference.placement.mesh_voxels import mesh_voxels
from ...reference.placement.validity import back_share
from ...reference.placement.winding import closed_solids, inside
from ...reference.variant import ensure_variant
from ...reference.visibility import Geometry, build_geometry, cast, to_box, vectors
from ..metrics.validity import Judged, area_under_curve, rates
from .case import Reading
from .cases_probes import C4
from .scenes import ball, box, grey, mesh, quad, scene_of
from .until_decided import share_of, until_decided

TOLERANCE = PlacementSettings().backface_tolerance
PLACES, LOOKS = 1500, 6  # places of a look
ROCK, RADIUS = np.array([0.0, 0.3, 0.0]), 1.0
FINE = 4  # subdivisions of balls: 5,120 triangles
FAR, BIG, VOXEL = 100.0, 1e4, 1.6
POSITIONS = 3000
THIN = 0.2


def _share(hits: int, count: int) -> Reading:
    """A share with its binomial error; none at all is exact, for it is held against bands that begin at 0."""
    return share_of(int(hits), int(count)) if hits else Reading(0.0, 0.0, int(count))


def _rock() -> Mesh:
    return ball(FINE, centre=ROCK, radius=RADIUS, inward=False)


def _part_of_ball(missing: float, up: bool) -> Mesh:
    """A ball without the lowest (or highest) triangles: `missing` is their share of the area."""
    whole = _rock()
    height = whole.vertices[whole.faces].mean(axis=1)[:, 1] * (-1.0 if up else 1.0)
    kept = np.argsort(height, kind="stable")[round(missing * len(height)) :]
    return mesh(whole.vertices, whole.faces[np.sort(kept)], closed=missing == 0.0)


def validity(missing: float, seed: int) -> Mapping[str, Reading]:
    """C4: how well the share of back faces tells what stands in a rock, `missing` being the open share of its surface.

    embedded_…: open below, where it stands in the ground, a single sheet; open_…: open above, so that one can look into it. auc:
    area under the ROC curve, over all tolerances 0 … 1; missed, alarms: rates at the product's tolerance. The oracle is the winding
    number of the whole rock. below_missed: places under the ground, which has no underside, that count as valid; cards_alarms:
    places among two-sided leaves that do not."""
    ensure_variant()
    whole, ground = closed_solids(build_geometry(scene_of([_rock()]))), _ground()
    rocks = {
        name: build_geometry(scene_of([_part_of_ball(missing, up), ground]))
        for name, up in (("embedded", False), ("open", True))
    }
    solid: list[Bool] = []
    shares: dict[str, list[F64]] = {name: [] for name in rocks}

    def look(k: int) -> Mapping[str, Reading]:
        above = np.random.default_rng([seed, 104, k]).uniform((-1.6, 0.02, -1.6), (1.6, 2.0, 1.6), (PLACES, 3))
        solid.append(inside(whole, above))
        found: dict[str, Reading] = {}
        for name, g in rocks.items():
            shares[name].append(back_share(g, above, 100 * seed + k))
            found |= _judged(name, np.concatenate(shares[name]), np.concatenate(solid))
        return found | _around(seed, k)

    return until_decided(C4, missing, look, LOOKS)


def _ground() -> Mesh:
    return quad((-20, 0, -20), (0, 0, 40), (40, 0, 0))


@cache
def _around(seed: int, looks: int) -> dict[str, Reading]:
    """The readings of `validity` that have nothing to do with what the rock lacks, from the places of the first `looks`."""
    whole, ground, wrong = (
        closed_solids(build_geometry(scene_of([_rock()]))),
        _ground(),
        np.zeros((2, 2), dtype=np.int64),
    )
    leaves = [_leaf(np.random.default_rng([seed, 106, number])) for number in range(200)]
    forest = build_geometry(scene_of([ground, *leaves], [grey(), grey(two_sided=True)]))
    sound = build_geometry(scene_of([_rock(), ground]))
    for k in range(1, looks + 1):
        rng = np.random.default_rng([seed, 107, k])
        below = rng.uniform((-1.6, -1.0, -1.6), (1.6, -0.02, 1.6), (PLACES, 3))
        below = below[~inside(whole, below)]
        above = rng.uniform((-1.6, 0.02, -1.6), (1.6, 2.0, 1.6), (PLACES, 3))
        valid = back_share(sound, below, 100 * seed + k) <= TOLERANCE
        false = back_share(forest, above, 100 * seed + k) > TOLERANCE
        wrong += [[valid.sum(), len(below)], [false.sum(), PLACES]]
    return {"below_missed": _share(*wrong[0]), "cards_alarms": _share(*wrong[1])}


def _judged(name: str, share: F64, solid: Bool) -> dict[str, Reading]:
    judged = Judged(share, solid)
    auc = area_under_curve(judged)
    missed, alarms = rates(judged, TOLERANCE)
    return {
        f"{name}_auc": Reading(auc.value, auc.se, auc.n),
        f"{name}_missed": _share(round(missed * solid.sum()), int(solid.sum())),
        f"{name}_alarms": _share(round(alarms * (~solid).sum()), int((~solid).sum())),
    }


def _leaf(rng: np.random.Generator) -> Mesh:
    """A two-sided card of 0.3 m, anywhere and any way."""
    along, other = sphere(rng.random((2, 2)))
    across = np.cross(along, other)
    across /= np.linalg.norm(across)
    corner = rng.uniform((-1.6, 0.1, -1.6), (1.6, 2.0, 1.6))
    return quad(corner, 0.3 * along, 0.3 * across, material=1)


def _between(y: float, up: bool) -> Mesh:
    """A floor or a ceiling, as good as endless."""
    edges = ((0, 0, 2 * BIG), (2 * BIG, 0, 0))
    along, across = edges if up else edges[::-1]
    return quad((-BIG, y, -BIG), along, across)


def distances(rays: float, seed: int) -> Mapping[str, Reading]:
    """C5: bias and spread of the inverse harmonic mean distance, 1 m over a floor, by `rays` directions.

    bias_…: mean of expected/found - 1, for closed forms: plane 4 h, plates 2 h apart 2 h, square corridor √2 times half its width.
    spread: standard deviation over mean above the plane; independent: of directions drawn one by one. special: how many of the
    special values are not what they must be."""
    ensure_variant()
    count = round(rays)
    at = np.tile([0.0, 1.0, 0.0], (POSITIONS, 1))
    expected = {
        "plane": (4.0, [_between(0, True)]),
        "plates": (2.0, [_between(0, True), _between(2, False)]),
        "corridor": (math.sqrt(2.0), [box((-1, 0, -BIG), (1, 2, BIG))]),
    }
    found = {}
    for name, (value, meshes) in expected.items():
        g = build_geometry(scene_of(meshes))
        relative = value / harmonic_mean(g, at, np.arange(POSITIONS), count, seed)
        error = float(relative.std(ddof=1))
        found[f"bias_{name}"] = Reading(float(relative.mean()) - 1.0, error / math.sqrt(POSITIONS), POSITIONS)
        if name == "plane":
            se = 1.0 / math.sqrt(2.0 * POSITIONS)  # of a standard deviation, relative
            found["spread"] = Reading(error, error * se, POSITIONS)
            alone = _independent(g, at, count, seed)
            found["independent"] = Reading(alone, alone * se, POSITIONS)
    found["special"] = Reading(float(_wrong_values(count, seed)), 0.0, 5)
    return found


def _independent(g: Geometry, at: F64, rays: int, seed: int) -> float:
    """Relative spread of 1/HM with independent directions."""
    rng = np.random.default_rng([seed, 105])
    inverse = np.zeros(len(at))
    for _ in range(rays):
        hits = cast(g, to_box(g, at), vectors(sphere(rng.random((len(at), 2)))))
        inverse += 1.0 / np.array(hits.t, np.float64) / rays
    return float(inverse.std(ddof=1) / inverse.mean())


def _wrong_values(rays: int, seed: int) -> int:
    """How many of five special values are wrong: distance 0 → 0 at three places of a surface, all miss → ∞, a sphere's middle → its
    radius (the ball is an icosphere within the sphere, up to 0.2 % off)."""
    g = build_geometry(scene_of([quad((0, 0, 0), (1, 0, 0), (0, 1, 0))]))
    places = np.array([[0.5, 0.5, 0.0], [0.25, 0.7, 0.0], [0.5, 0.5, 1e-7], [0.0, 0.0, 1e9]])
    on = harmonic_mean(g, places, np.arange(4), rays, seed)
    round_room = build_geometry(scene_of([ball(FINE, radius=2.0)]))
    middle = harmonic_mean(round_room, np.zeros((2, 3)), np.arange(2), rays, seed)
    right = [*(on[:3] < 1e-4), on[3] == np.inf, bool((np.abs(middle / 2.0 - 1.0) < 4e-3).all())]
    return len(right) - int(np.sum(right))


def thin_things(width: float, seed: int) -> Mapping[str, Reading]:
    """C6: a square pole of `width` m between walls 100 m away; finest voxels of 1.6 m.

    default, touching: share of the finest voxels at the pole, half-way up, that exist, by the harmonic mean and with
    `placement.touching`. reads: harmonic mean 2 m beside its middle over what a pole of that width alone predicts, 1/(w/(8 d²) +
    1/R) in a round room."""
    pole = box((5.3, -FAR, 3.1), (5.3 + width, FAR, 3.1 + width), inward=False)
    walls = box((-FAR,) * 3, (FAR,) * 3, lit_by_probes=False)
    found = {}
    for name, touching in (("default", False), ("touching", True)):
        tables: dict[str, Any] = {
            "placement": {"min_voxel": VOXEL, "touching": touching},
            "radiosity": {"patch_size": 50.0, "rays": 64, "noise": 1.0},
        }
        made = scene_of([walls, pole], **tables)
        tree = pipeline.place(made, pipeline.bake_surfaces(made, seed), seed)
        found[name] = _found_share(tree, pole)
    half = 0.5 * width
    alone = box((-half, -FAR, -half), (half, FAR, half), inward=False)
    g = build_geometry(scene_of([ball(FINE, radius=FAR), alone]))
    if width <= THIN:  # the law is that of a thin one
        inverse = 1.0 / harmonic_mean(g, np.tile([2.0, 0.0, 0.0], (200, 1)), np.arange(200), 1024, seed)
        expected = width / (8.0 * 2.0**2) + 1.0 / FAR
        ratio = expected / inverse.mean()
        found["reads"] = Reading(float(ratio), float(ratio * inverse.std() / inverse.mean() / math.sqrt(200)), 200)
    return found


def _found_share(tree: Octree, pole: Mesh) -> Reading:
    wanted = cells(mesh_voxels(pole.vertices[pole.faces], tree.grid, tree.grid.level))
    wanted = wanted[np.abs(tree.grid.corner_positions(wanted)[:, 1]) < FAR / 2]
    there = np.isin(keys(wanted), keys(tree.voxels[-1]))
    return Reading(float(there.mean()), 0.0, len(there))
