"""Cases A1, A2, A7, A11: where rays go, and how many it takes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...reference.datatypes import F64
from ...reference.progress import silent
from ...reference.sky import SKY_BINS
from ...reference.transport.form_factors import (
    FormFactors,
    patch_form_factors,
    point_form_factors,
    probe_form_factors,
)
from ...reference.transport.patches import build_patches
from ...reference.variant import ensure_variant
from ...reference.visibility import Geometry, build_geometry, cast, mitsuba_mesh, to_box, vectors
from .case import Reading
from .scenes import box, grey, plate, quads_mesh, scene_of

UP = np.array([0.0, 1.0, 0.0])


def _share_of_sky(rows: FormFactors) -> float:
    """Rays of all receivers that left the scene, of all rays."""
    outside = rows.matrix()[:, rows.patches : rows.patches + SKY_BINS].sum(axis=1)
    return float(rows.rays @ outside / rows.rays.sum())


# A1 ------------------------------------------------------------------------------------------------------------------

EDGE, EDGE_RAYS = 0.2, 1 << 19


def closed_edges(offset: float, seed: int) -> Mapping[str, Reading]:
    """Share of the rays within a closed box of 0.2 m, its corner `offset` m from the origin, that leave it: the worst of three
    subdivisions; and of rays that Mitsuba's default caster traces in the same box where it stands."""
    worst, rays, loose = 0.0, 0, 0.0
    for cuts in (1, 4, 13):
        corner = np.full(3, offset)
        scene = scene_of([box(corner, corner + EDGE, cuts=cuts)])
        g = build_geometry(scene)
        rows = patch_form_factors(g, build_patches(scene, g, EDGE / 2), 4096, seed, silent)
        inside = corner + EDGE * np.random.default_rng([seed, 1]).uniform(0.1, 0.9, (64, 3))
        probes = probe_form_factors(g, build_patches(scene, g, EDGE / 2), inside, 4096, seed, silent)
        lost = float((probes.columns >= probes.patches).any())  # a probe's entries are no shares: any is one too many
        worst, rays = max(worst, _share_of_sky(rows), lost), rays + int(rows.rays.sum() + probes.rays.sum())
        loose = max(loose, _default_caster(g, seed))
    return {"ours": Reading(worst, 0.0, rays), "Mitsuba's default": Reading(loose, 0.0, 3 * EDGE_RAYS)}


def _default_caster(g: Geometry, seed: int) -> float:
    """Share of rays from within the box that the default, not robust, caster lets out of the box where it stands."""
    import drjit as dr
    import mitsuba as mi

    caster = mi.load_dict({"type": "scene", "mesh": mitsuba_mesh("box", g.vertices, g.faces)})
    rng = np.random.default_rng([seed, 2])
    # Single precision keeps no point inside a box far away: the middle, which is on the grid of it, is.
    single = g.vertices.astype(np.float32)
    middle = 0.5 * (single.min(axis=0) + single.max(axis=0))
    d = rng.normal(size=(EDGE_RAYS, 3))
    origins = mi.Point3f(*(dr.full(mi.Float, float(c), EDGE_RAYS) for c in middle))
    missed = ~np.array(caster.ray_test(mi.Ray3f(origins, vectors(d / np.linalg.norm(d, axis=1, keepdims=True)))))
    return float(missed.mean())


# A2 ------------------------------------------------------------------------------------------------------------------

GAP_POINTS, GAP_RAYS = 64, 1024


def thin_gap(gap: float, seed: int) -> Mapping[str, Reading]:
    """What arrives below an opaque plate `gap` m above the floor, of what arrives on the open floor beside it; the gap is shut
    at its rim. A sky shines; the scene is 2 m wide."""
    lid = box((-0.5, 0.0, -0.5), (0.5, gap, 0.5), inward=True, material=1)
    floor = quads_mesh([plate((-1, 1), (-1, 1), 0.0, up=True)])
    s = scene_of([floor, lid], [grey(), grey(two_sided=True)])
    g = build_geometry(s)
    inner = np.random.default_rng([seed, 3]).uniform(-0.4, 0.4, (GAP_POINTS, 3)) * (1.0, 0.0, 1.0)
    normals = np.tile(UP, (GAP_POINTS, 1))
    rows = point_form_factors(g, build_patches(s, g, 0.5), inner, normals, GAP_RAYS, seed, silent)
    light = float(rows.matrix()[:, rows.patches : rows.patches + SKY_BINS].sum() / GAP_POINTS)
    n = GAP_POINTS * GAP_RAYS
    return {"ours": Reading(light, 0.0, n), "Mitsuba's irradiance meter": Reading(_meter(g, seed), 0.0, GAP_RAYS)}


def _meter(g: Geometry, seed: int) -> float:
    """The same by an `irradiancemeter` on the floor under the plate, of what the open sky would give."""
    import drjit as dr
    import mitsuba as mi

    plates = mitsuba_mesh("plates", g.vertices, g.faces)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(0.4)
    meter = {"type": "irradiancemeter", "film": film, "sampler": {"type": "independent", "sample_count": GAP_RAYS}}
    below = {"type": "rectangle", "to_world": turn, "sensor": meter}  # at the floor's height: it is the floor
    sky = {"type": "constant", "radiance": 1.0}
    scene = mi.load_dict({"type": "scene", "plates": plates, "below": below, "sky": sky})
    image = mi.render(scene, sensor=scene.sensors()[0], integrator=mi.load_dict({"type": "direct"}), seed=seed)
    return float(dr.mean(image.array)[0]) / math.pi


# A7 ------------------------------------------------------------------------------------------------------------------

GRID, INNER, REACH = 16, 8, 4


def regular_directions(rays: float, seed: int) -> Mapping[str, Reading]:
    """Receivers over the middles of the cells of a patch grid all see the same cells. Root mean square over cells of the error of
    the mean over receivers, of that of one receiver: 1/√receivers where they err independently, 1 where all err alike."""
    n = int(rays)
    tiles = [quads_mesh([plate((i, i + 1), (j, j + 1), 0.0, up=True)], material=GRID * i + j)
             for i in range(GRID) for j in range(GRID)]  # fmt: skip
    s = scene_of(tiles, [grey()] * len(tiles))
    g = build_geometry(s)
    p = build_patches(s, g, 1.0)
    cell = np.zeros(p.count, np.int64)
    cell[p.element_patch] = g.mesh[p.element_triangle]
    lo = (GRID - INNER) // 2
    at = np.stack(np.meshgrid(np.arange(lo, lo + INNER), np.arange(lo, lo + INNER), indexing="ij"), -1).reshape(-1, 2)
    positions = np.column_stack([at[:, 0] + 0.5, np.ones(len(at)), at[:, 1] + 0.5])
    rows = point_form_factors(g, p, positions, np.tile(-UP, (len(at), 1)), n, seed, silent)
    found = np.zeros((len(at), GRID * GRID))
    found[:, cell] = rows.matrix()[:, : p.count].toarray()
    regular = np.stack([_hemicube(g, q, n) for q in positions])
    return {
        "ours": _common_share(found, at, len(at) * n),
        "one regular pattern": _common_share(regular, at, len(at) * n),
    }


def _common_share(found: F64, at: Any, n: int) -> Reading:
    """`regular_directions` from form factors (receivers, cells)."""
    step = np.arange(-REACH, REACH)
    dx, dz = (m.ravel() for m in np.meshgrid(step, step, indexing="ij"))
    cells = (at[:, :1] + dx) * GRID + at[:, 1:] + dz
    error = np.take_along_axis(found, cells, axis=1) - _exact_cells(dx, dz)
    return Reading(float(np.sqrt((error.mean(axis=0) ** 2).mean() / (error**2).mean())), 0.0, n)


def _exact_cells(dx: Any, dz: Any) -> F64:
    """Form factors (N,) from a point 1 m over the middle of a cell to the cells of 1 m that lie dx, dz further."""

    def corner(a: F64, b: F64) -> F64:  # Howell B-4: element parallel to a rectangle, over its corner
        p, q = np.sqrt(1.0 + a * a), np.sqrt(1.0 + b * b)
        return np.asarray((a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2.0 * math.pi))

    x0, z0 = dx - 0.5, dz - 0.5
    return np.asarray(corner(x0 + 1, z0 + 1) - corner(x0, z0 + 1) - corner(x0 + 1, z0) + corner(x0, z0))


def _hemicube(g: Geometry, position: F64, rays: int) -> F64:
    """Form factors (cells,) from a regular grid of cosine directions that is the same at every receiver."""
    side = round(math.sqrt(rays))
    u, v = (m.ravel() for m in np.meshgrid(*[(np.arange(side) + 0.5) / side] * 2))
    x, z = np.sqrt(u) * np.cos(2 * np.pi * v), np.sqrt(u) * np.sin(2 * np.pi * v)
    d = np.column_stack([x, -np.sqrt(1.0 - u), z])
    hits = cast(g, to_box(g, np.tile(position, (len(d), 1))), vectors(d))
    met = g.mesh[np.array(hits.triangle)[np.array(hits.hit)]]
    return np.bincount(met, minlength=GRID * GRID) / len(d)


# A11 -----------------------------------------------------------------------------------------------------------------


def units(scale: float, seed: int) -> Mapping[str, Reading]:
    """Largest difference between form factors of a room with a crate and of the same room `scale` times as large."""
    small, large = _room_rows(1.0, seed, True), _room_rows(scale, seed, True)
    fixed = _room_rows(scale, seed, False)
    n = len(small) * UNIT_RAYS
    return {
        "ours": Reading(float(np.abs(large - small).max()), 0.0, n),
        "rays in metres": Reading(float(np.abs(fixed - small).max()), 0.0, n),
    }


UNIT_RAYS = 2048


def _room_rows(scale: float, seed: int, unit_box: bool) -> F64:
    """Form factors between the patches of a room of 1 m × `scale`; unit_box: traced as the product does, else in metres."""
    room = box((0, 0, 0), np.array([1.0, 0.8, 0.6]) * scale)
    crate = box(np.array([0.3, 0.0, 0.2]) * scale, np.array([0.6, 0.3, 0.4]) * scale, inward=False, material=1)
    s = scene_of([room, crate], [grey(), grey()])
    g = build_geometry(s)
    p = build_patches(s, g, 0.21 * scale)
    if not unit_box:
        g = _in_metres(g)
    return np.asarray(patch_form_factors(g, p, UNIT_RAYS, seed, silent).matrix().toarray()[:, : p.count])


def _in_metres(g: Geometry) -> Geometry:
    """The same geometry without the unit box: lifts and single precision then are what they are in metres."""
    ensure_variant()
    import mitsuba as mi

    mesh = mitsuba_mesh("metres", g.vertices, g.faces)
    caster = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "mesh": mesh})
    return dataclasses.replace(g, centre=np.zeros(3), scale=1.0, caster=caster)
