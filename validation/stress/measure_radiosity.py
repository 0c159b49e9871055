"""Cases B1, B2, B3, B7: solvers against exact answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy import sparse

from ...reference.datatypes import F64, Scene
from ...reference.progress import silent
from ...reference.transport.form_factors import FormFactors, patch_form_factors
from ...reference.transport.gather import upload
from ...reference.transport.hybrid import hybrid_form_factors
from ...reference.transport.patches import Patches, build_patches
from ...reference.transport.radiosity import solve as solve_scene
from ...reference.transport.reconcile import reconcile
from ...reference.transport.solver_types import System, matrix_system
from ...reference.transport.solvers import METHODS, OneBounce, solve
from ...reference.transport.spectral import bounce_count
from ...reference.truth.analytic import closed_sphere_radiosity
from ...reference.visibility import build_geometry
from .case import Reading
from .scenes import ball, box, grey, mesh, plate, quads_mesh, scene_of

# B1 ------------------------------------------------------------------------------------------------------------------

STEP_TOLERANCE = 1e-3


@lru_cache
def _cube(seed: int) -> tuple[Patches, FormFactors]:
    s = scene_of([box((0, 0, 0), (1, 1, 1))])
    g = build_geometry(s)
    p = build_patches(s, g, 0.5)
    return p, patch_form_factors(g, p, 256, seed, silent)


def _furnace(albedo: float, seed: int) -> System:
    """A closed cube whose walls all send 1 W·m⁻² by themselves."""
    p, rows = _cube(seed)
    return matrix_system(rows, np.full((p.count, 3), albedo), np.ones((p.count, 3)), p.area)


def _lamp_in_cube(albedo: float, seed: int) -> System:
    """The same cube, one wall of which sends 1 W·m⁻²: its radiosity differs from patch to patch."""
    p, rows = _cube(seed)
    shines = np.tile((p.normal[:, 1:2] > 0.5).astype(np.float64), (1, 3))
    return matrix_system(rows, np.full((p.count, 3), albedo), shines, p.area)


def off_dense(system: System, radiosity: F64) -> float:
    """Σ A |B - (1 - ρF)⁻¹ S| over Σ A (1 - ρF)⁻¹ S, worst colour: what a solver that stopped too early has left out."""
    rows = system.rows("dense").toarray()
    worst = 0.0
    for c in range(3):
        exact = np.linalg.solve(np.eye(system.patches) - system.albedo[:, c, None] * rows, system.source[:, c])
        worst = max(worst, float(system.area @ np.abs(radiosity[:, c] - exact)) / float(system.area @ exact))
    return worst


def slow_convergence(loss: float, seed: int) -> Mapping[str, Reading]:
    """A furnace of albedo 1 - `loss`: row operations per patch until a thousandth of the source is left, by method, and
    whether the solver refuses it; the error of the radiosity there, of the thousandth that it must be under; and how far the same
    cube lit by one wall is off a dense solve, of that thousandth."""
    system = _furnace(1.0 - loss, seed)
    found: dict[str, Reading] = {}
    refused, worst, apart = 0.0, 0.0, 0.0
    lamp = _lamp_in_cube(1.0 - loss, seed)
    for name in ("jacobi", "gauss-seidel", "southwell"):
        try:
            done = solve(system, METHODS[name], STEP_TOLERANCE)
        except ValueError:
            refused += 1.0 / 3.0
            continue
        found[name] = Reading(done.row_operations / system.patches)
        worst = max(worst, float(np.abs(done.radiosity * loss - 1.0).max()) / STEP_TOLERANCE)
        lit = solve(lamp, METHODS[name], STEP_TOLERANCE).radiosity
        apart = max(apart, off_dense(lamp, lit) / STEP_TOLERANCE)
    if found:
        found["error left, of the tolerance"] = Reading(worst)
        found["off a dense solve, of the tolerance"] = Reading(apart)
    return {**found, "refused": Reading(refused)}


# B2 ------------------------------------------------------------------------------------------------------------------

SPHERE_ALBEDO, EXACT_NOISE = 0.6, 1e-4


def sphere(subdivisions: float, seed: int) -> Mapping[str, Reading]:
    """Inside of a ball that sends 1 + y by itself, made of facets with form factors of their own. The irradiance should be the
    same everywhere; y that is left in it, as a share of y (the error as a whole), its order, and the deviation from facet to facet,
    root mean square. And the error of every solver with a ball's F_ij = A_j / A."""
    level = int(subdivisions)
    harmonic, deviation = _facet_error(level, seed)
    found = {
        "solvers": Reading(_solver_error(level)),
        "whole": Reading(harmonic),
        "single facets": Reading(deviation),
    }
    if level > 0:
        found["order of the whole"] = Reading(math.log2(_facet_error(level - 1, seed)[0] / harmonic))
    return found


@lru_cache
def _facets(level: int, seed: int) -> tuple[Patches, FormFactors]:
    """Every facet a patch (each is a mesh with a material of its own), form factors by closed forms."""
    whole = ball(level)
    pieces = [mesh(c, [[0, 1, 2]], material=i) for i, c in enumerate(whole.vertices[whole.faces])]
    s = scene_of(pieces, [grey(SPHERE_ALBEDO)] * len(pieces))
    g = build_geometry(s)
    p = build_patches(s, g, 100.0)
    raw = patch_form_factors(g, p, 64, seed, silent)
    return p, hybrid_form_factors(g, p, raw, EXACT_NOISE, seed, silent).laws.rows


def _exitance(p: Patches) -> F64:
    """1 + y on the ball, (P, 3) W·m⁻²: its mean is 1."""
    up = p.centroid[:, 1:2] / np.linalg.norm(p.centroid, axis=1, keepdims=True)
    return np.tile(1.0 + up, (1, 3))


@lru_cache
def _facet_error(level: int, seed: int) -> tuple[float, float]:
    """Of the irradiance on facets, 1 / (1 - ρ) everywhere in a ball: |share of y| in it, and root mean square, both relative."""
    p, rows = _facets(level, seed)
    own = _exitance(p)
    b = solve(matrix_system(rows, np.full(own.shape, SPHERE_ALBEDO), own, p.area), tolerance=1e-7).radiosity
    off = ((b - own) / SPHERE_ALBEDO)[:, 0] * (1.0 - SPHERE_ALBEDO) - 1.0
    up, area = own[:, 0] - 1.0, p.area
    return abs(float(area @ (off * up) / (area @ up**2))), float(np.sqrt(area @ off**2 / area.sum()))


def _solver_error(level: int) -> float:
    """Of all solvers where the form factors are those of a ball: what is left is the solver's own."""
    s = scene_of([ball(level)], [grey(SPHERE_ALBEDO)])
    g = build_geometry(s)
    p = build_patches(s, g, 0.4)
    own, albedo = _exitance(p), np.full((p.count, 3), SPHERE_ALBEDO)
    ball_rows = sparse.csr_array(np.tile(p.area / p.area.sum(), (p.count, 1)))
    exact = closed_sphere_radiosity(p.area, albedo, own)
    found = [solve(matrix_system(ball_rows, albedo, own, p.area), m, 1e-7).radiosity for m in METHODS.values()]
    return float(max(np.abs(b / exact - 1.0).max() for b in found))


# B3 ------------------------------------------------------------------------------------------------------------------

RUNS, ENERGY_TOLERANCE = 3, 1e-6
ENERGY_ALBEDOS = ((0.8, 0.7, 0.6), (0.3, 0.5, 0.7), (0.6, 0.1, 0.1))


def energy(rays: float, seed: int) -> Mapping[str, Reading]:
    """|Σ A (B (1 - ρ) - M)| / Σ A M, worst colour, in a closed room of several colours with a lamp, a pillar and a table, with
    `rays` per patch: of reconciled rows, and of rows as the rays found them (the worst of RUNS). And how far the solution is
    off a dense solve of the reconciled rows, of the tolerance that the solver was asked for."""
    room = box((0, 0, 0), (3, 2, 2))
    pillar = box((1.0, 0.0, 0.8), (1.3, 2.0, 1.1), inward=False, material=1)
    table = quads_mesh([plate((1.8, 2.6), (0.5, 1.3), 0.7, up=True)], material=2)
    lamp = quads_mesh([plate((0.3, 0.6), (0.3, 0.6), 1.9, up=False)], material=1, exitance=10.0)
    materials = [grey(a, two_sided=i == 2) for i, a in enumerate(ENERGY_ALBEDOS)]
    s = scene_of([room, pillar, table, lamp], materials)
    g = build_geometry(s)
    p = build_patches(s, g, 0.35)
    raw = patch_form_factors(g, p, int(rays), seed, silent)
    kept = reconcile(raw, p.area).rows
    ours = _energy_defect(s, p, kept)
    plain = [_energy_defect(s, p, raw)]
    plain += [
        _energy_defect(s, p, patch_form_factors(g, p, int(rays), 1000 * seed + k, silent)) for k in range(1, RUNS)
    ]
    n = int(rays) * p.count
    return {
        "reconciled (ours)": Reading(ours, 0.0, n),
        "rays as they are": Reading(max(plain), 0.0, RUNS * n),
        "off a dense solve, of the tolerance": Reading(_off_dense_scene(s, p, kept) / ENERGY_TOLERANCE, 0.0, p.count),
    }


def _off_dense_scene(s: Scene, p: Patches, rows: FormFactors) -> float:
    """How far the product's radiosity of a scene is off a dense solve of the same rows."""
    solved = solve_scene(s, p, upload(rows), np.zeros((p.count, 3)), ENERGY_TOLERANCE)
    return off_dense(matrix_system(rows, p.albedo, p.exitance, p.area), solved.radiosity)


def _energy_defect(s: Scene, p: Patches, rows: FormFactors) -> float:
    """|absorbed and lost to black backs - sent| / sent, worst colour."""
    solved = solve_scene(s, p, upload(rows), np.zeros((p.count, 3)), ENERGY_TOLERANCE)
    absorbed = p.area @ ((1.0 - p.albedo) * solved.irradiance)
    black = rows.matrix()[:, p.count :].sum(axis=1)  # the back of the lamp
    power = p.area @ p.exitance
    return float((np.abs(absorbed + (p.area * black) @ solved.radiosity - power) / power).max())


# B7 ------------------------------------------------------------------------------------------------------------------

FRAMES = 5000


def lag(albedo: float, seed: int) -> Mapping[str, Reading]:
    """Updates of one bounce each until a furnace is within 1 % after its light was switched on, and off (of the light it had);
    and what the product foretells."""
    system = _furnace(albedo, seed)
    full = 1.0 / (1.0 - albedo)
    on = OneBounce(system)
    rising = _updates(on, system.source, full, full)
    off = OneBounce(system, np.full(system.source.shape, full))
    falling = _updates(off, np.zeros_like(system.source), 0.0, full)
    return {"on": Reading(rising), "off": Reading(falling), "foretold": Reading(bounce_count(albedo, 0.01))}


def _updates(run: OneBounce, source: F64, goal: float, scale: float) -> float:
    for frame in range(1, FRAMES + 1):
        if float(np.abs(run.step(source) - goal).max()) <= 0.01 * scale * (1.0 + 1e-5):
            return frame
    return math.inf
