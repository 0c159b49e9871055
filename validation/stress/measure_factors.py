"""Cases A3 to A6: the laws that form factors keep, and form factors with a closed form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...reference.datatypes import F64, Mesh
from ...reference.progress import silent
from ...reference.sky import SKY_BINS
from ...reference.transport.closed_forms.pair import mesh_form_factor
from ...reference.transport.flows import flows_of_rays, rows_of_flows, without_entries
from ...reference.transport.form_factors import FormFactors, patch_form_factors
from ...reference.transport.gather import upload
from ...reference.transport.patch_light import direct_on_patches
from ...reference.transport.patches import Patches, build_patches
from ...reference.transport.reconcile import reconcile
from ...reference.transport.solver_types import System, device_system
from ...reference.transport.solvers import solve
from ...reference.visibility import build_geometry
from .case import Reading
from .scenes import ball, box, box_faces, grey, mesh, plate, quads_mesh, scene_of

# A3 ------------------------------------------------------------------------------------------------------------------

CLOSURE_RAYS, DEFECT, TOLERANCE = 256, 0.01, 1e-5
FURNACE_ERROR = 1e-3  # what the closure of rows shall allow


class _Closed(NamedTuple):
    """A closed scene: raw rows from rays, the same reconciled, and max |row sum - 1| of these."""

    patches: Patches
    raw: FormFactors
    reconciled: FormFactors
    defect: float


@lru_cache
def _closed_scenes(seed: int) -> tuple[_Closed, ...]:
    found = []
    for piece, size in ((box((0, 0, 0), (1, 2, 3)), 0.5), (ball(2), 0.6)):
        s = scene_of([piece])
        g = build_geometry(s)
        p = build_patches(s, g, size)
        raw = patch_form_factors(g, p, CLOSURE_RAYS, seed, silent)
        laws = reconcile(raw, p.area)
        found.append(_Closed(p, raw, laws.rows, laws.closure))
    return tuple(found)


def closure(albedo: float, seed: int) -> Mapping[str, Reading]:
    """Worst relative error of the radiosity in furnaces, B = M / (1 - ρ), of a box and a ball: with the product's rows, with rows
    that are averaged but not closed, with rows one per cent too large (of which the formula of the amplification is taken off)."""
    ours, open_rows, scaled = [], [], []
    for scene in _closed_scenes(seed):
        p = scene.patches
        averaged = rows_of_flows(flows_of_rays(scene.raw, p.area)[0], p.area, without_entries(scene.raw))
        ours.append(_furnace(scene.reconciled, p, albedo, 1.0))
        open_rows.append(_furnace(averaged, p, albedo, 1.0))
        if albedo * (1.0 + DEFECT) < 0.998:
            scaled.append(_furnace(scene.reconciled, p, albedo, 1.0 + DEFECT))
    n = sum(s.raw.rows for s in _closed_scenes(seed)) * CLOSURE_RAYS
    limit = FURNACE_ERROR * (1.0 - albedo) / albedo
    found = {
        "ours": Reading(max(ours), 0.0, n),
        "averaged, not closed": Reading(max(open_rows), 0.0, n),
        "closure, of its limit": Reading(max(s.defect for s in _closed_scenes(seed)) / limit, 0.0, n),
    }
    if scaled:
        foretold = DEFECT * albedo / (1.0 - albedo * (1.0 + DEFECT))
        found["one per cent too much, over the formula"] = Reading(max(scaled) / foretold, 0.0, n)
    return found


def _furnace(rows: FormFactors, p: Patches, albedo: float, factor: float) -> float:
    """Largest |B (1 - ρ) / M - 1|, or 1 (all is lost) where the solver refuses the system."""
    s = device_system(upload(rows), np.full((p.count, 3), albedo), np.ones((p.count, 3)), p.area)
    system = System(lambda light: factor * s.product(light), s.albedo, s.source, s.area)
    try:
        b = solve(system, tolerance=TOLERANCE * (1.0 - albedo)).radiosity
    except ValueError:
        return 1.0
    return float(np.abs(b * (1.0 - albedo) - 1.0).max())


# A4 ------------------------------------------------------------------------------------------------------------------

RECIPROCITY_RAYS = 1 << 17


def reciprocity(ratio: float, seed: int) -> Mapping[str, Reading]:
    """Σ|A_i F_ij - A_j F_ji| over all pairs of the walls of a room and a small plate, 1 : `ratio` of a wall's area: of what the
    standard errors of both let expect, for rays; and of Σ A_i F_ij, after reconciling."""
    half = 0.5 / math.sqrt(ratio)
    walls = [quads_mesh(face, material=i) for i, face in enumerate(box_faces((0, 0, 0), (1, 1, 1)))]
    small = plate((0.5 - half, 0.5 + half), (0.5 - half, 0.5 + half), 0.4, up=True)
    s = scene_of([*walls, quads_mesh([small], material=6)], [*[grey()] * 6, grey(two_sided=True)])
    g = build_geometry(s)
    p = build_patches(s, g, 10.0)
    raw = patch_form_factors(g, p, RECIPROCITY_RAYS, seed, silent)
    m = raw.matrix()[:, : p.count].toarray().astype(np.float64)
    se = _standard_errors(raw, p.count)
    flow, squared = p.area[:, None] * m, (p.area[:, None] * se) ** 2
    i, j = np.triu_indices(p.count, 1)
    different = np.abs(flow - flow.T)[i, j]
    expected = math.sqrt(2.0 / math.pi) * np.sqrt(squared + squared.T)[i, j]  # mean |x| of a normal x
    laws = reconcile(raw, p.area)
    n = RECIPROCITY_RAYS * p.count
    kept = laws.rows.matrix()[:, : p.count].toarray().astype(np.float64) * p.area[:, None]
    return {
        "rays, over their noise": Reading(float(different.sum() / expected.sum()), 0.0, n),
        "reconciled": Reading(float(np.abs(kept - kept.T).sum() / kept.sum()), 0.0, n),
        "rays": Reading(float(2.0 * different.sum() / flow.sum()), 0.0, n),
    }


def _standard_errors(rows: FormFactors, patches: int) -> F64:
    """(R, P) standard error of each form factor."""
    from scipy import sparse

    shape = (rows.rows, rows.patches + SKY_BINS + 1)
    full = sparse.csr_array((rows.se[:, 0].astype(np.float64), rows.columns, rows.indptr), shape=shape)
    return np.asarray(full.toarray()[:, :patches])


# A5 ------------------------------------------------------------------------------------------------------------------

SEEDS = 24


def opposite_squares(gap: float) -> float:
    """Form factor of facing unit squares (Howell C-11)."""
    x = 1.0 / gap
    y = math.sqrt(1.0 + x * x)
    log = math.log(y * y / math.sqrt(1.0 + 2.0 * x * x))
    return 2.0 / (math.pi * x * x) * (log + 2.0 * x * y * math.atan(x / y) - 2.0 * x * math.atan(x))


OPPOSITE = opposite_squares(1.0)  # 0.199825
ADJACENT = (1.0 - OPPOSITE) / 4.0  # 0.200044: closure and symmetry of the cube


def common_edge(rays: float, seed: int) -> Mapping[str, Reading]:
    """Form factors between the faces of a cube. Relative root mean square error of those of adjacent faces over seeds, of what
    independent cosine rays give; the same with points chosen by area on both; the closed form's error; and the row sums'."""
    n = int(rays)
    walls = [quads_mesh(face, material=i) for i, face in enumerate(box_faces((0, 0, 0), (1, 1, 1)))]
    s = scene_of(walls, [grey()] * 6)
    g = build_geometry(s)
    p = build_patches(s, g, 10.0)
    beside = p.normal @ p.normal.T == 0.0
    errors, sums = [], []
    for k in range(SEEDS):
        m = patch_form_factors(g, p, n, 1000 * seed + k, silent).matrix()[:, :6].toarray().astype(np.float64)
        errors.append(m[beside] - ADJACENT)
        sums.append(np.abs(m.sum(axis=1) - 1.0).max())
    binomial = math.sqrt(ADJACENT * (1.0 - ADJACENT) / n)
    areas = np.array([_by_area(n, np.random.default_rng([seed, k])) for k in range(SEEDS * 6)])
    closed = max(_closed_error(walls[0], walls[2], ADJACENT), _closed_error(walls[0], walls[1], OPPOSITE))
    ours, area = np.array(errors), areas - ADJACENT
    return {
        "cosine rays (ours)": _ratio(ours.ravel(), binomial, n),
        "points by area": Reading(
            _ratio(area, binomial, n).value, 0.0, n * len(area)
        ),  # no variance, so no standard error
        "closed form (ours)": Reading(closed),
        "row sums (ours)": Reading(float(max(sums)), 0.0, n),
    }


def _ratio(errors: F64, unit: float, n: int) -> Reading:
    """Root mean square of errors over `unit`, with its standard error."""
    square = errors**2
    value = float(np.sqrt(square.mean()))
    se = float(square.std(ddof=1) / math.sqrt(len(errors)) / (2.0 * value))
    return Reading(value / unit, se / unit, n * len(errors))


def _by_area(n: int, rng: np.random.Generator) -> float:
    """Form factor of two squares with a common edge from `n` pairs of points chosen by area: Σ cosθ cosθ' / (π r² n)."""
    x, y, z, w = rng.random((4, n))  # (x, 0, z) and (0, y, w)
    square = x * x + y * y + (z - w) ** 2
    return float((x * y / (math.pi * square**2)).mean())


def _closed_error(one: Mesh, other: Mesh, exact: float) -> float:
    return abs(mesh_form_factor(one, other, rays=1024).value - exact) / exact


# A6 ------------------------------------------------------------------------------------------------------------------

LAMP_SAMPLES, NEAR_RAYS = 256, 1 << 20


def near_field(gap: float, seed: int) -> Mapping[str, Reading]:
    """Form factor of facing unit squares over its exact value: closed form, rays, a lamp's direct light, and A / π r²."""
    exact = opposite_squares(gap)
    floor, ceiling = plate((0, 1), (0, 1), 0.0, up=True), plate((0, 1), (0, 1), gap, up=False)
    one, two = quads_mesh([floor]), quads_mesh([ceiling], material=1)
    s = scene_of([one, two], [grey(), grey()])
    g = build_geometry(s)
    p = build_patches(s, g, 10.0)
    rows = patch_form_factors(g, p, NEAR_RAYS, seed, silent)
    between = rows.matrix()[:, :2].toarray().max(axis=1)
    lit = [_lamp(gap, seed + k) / math.pi / exact for k in range(8)]
    se = float(np.std(lit, ddof=1) / math.sqrt(8))
    return {
        "closed form (ours)": Reading(mesh_form_factor(one, two, rays=1024).value / exact),
        "rays (ours)": Reading(float(between.mean()) / exact, float(rows.se.max()) / exact, 2 * NEAR_RAYS),
        "a lamp's direct light (ours)": Reading(float(np.mean(lit)), se, 8 * LAMP_SAMPLES, len(lit) - 1),
        "A / π r²": Reading(1.0 / (math.pi * gap * gap) / exact),
    }


def _lamp(gap: float, seed: int) -> float:
    """Mean irradiance, W·m⁻², of a floor of one patch under an engine's lamp of radiance 1."""
    lamp = mesh(plate((0, 1), (0, 1), gap, up=False), [[0, 1, 2], [0, 2, 3]], 1, math.pi, engine=True)
    s = scene_of([quads_mesh([plate((0, 1), (0, 1), 0.0, up=True)]), lamp], [grey(), grey()])
    g = build_geometry(s)
    p = build_patches(s, g, 0.25)
    rows = upload(patch_form_factors(g, p, 1024, seed, silent))
    direct = direct_on_patches(s, g, p, LAMP_SAMPLES, seed, silent, rows)
    mine = p.emitter < 0
    return float(p.area[mine] @ direct[mine, 0] / p.area[mine].sum())
