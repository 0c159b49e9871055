"""What cases R1 … R4 measure: errors of the product's stages at several sizes, and the exponents fitted to them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from ...fastpath.sampler import Sampler
from ...reference.datatypes import F32, F64
from ...reference.lattice import Grid
from ...reference.low_discrepancy import mixed, scrambled
from ...reference.placement.octree import uniform_octree
from ...reference.progress import silent
from ...reference.transport import accumulate
from ...reference.transport.form_factors import form_factors, patch_form_factors
from ...reference.transport.patch_light import direct_on_patches
from ...reference.transport.patches import Patches, build_patches, surface_samples
from ...reference.transport.receivers import area_receivers, patch_receivers, point_receivers
from ...reference.transport.reconcile import reconcile
from ...reference.transport.solver_types import System, matrix_system
from ...reference.transport.solvers import METHODS
from ...reference.visibility import Geometry, build_geometry
from .case import Reading
from .cases_rates import R1, R2, R4
from .rates_fit import EACH, Law, exponents
from .scenes import ball, box, box_faces, grey, plate, quads_mesh, scene_of
from .texture_worlds import device, flat_light, units, world
from .until_decided import mean_of

Floats = npt.NDArray[np.floating]
FACET_RAYS = 1 << 11  # twice
RISE = 0.5  # of the light with height, over its mean
EDGE = 1.1  # m, of the facets of an icosphere before it is subdivided
FLOOR, SHADOW_RAYS, PER_PATCH = 4.0, 64, 64
ROOTS = 2.0 ** (-0.5 * np.arange(5))  # patch sizes of one fit, over its coarsest
RAYS_STEPS = np.array([1, 4])
RECEIVERS = 96
SWEEPS = np.arange(6, 14)
READS = 20_000


def patch_size(size: float, seed: int) -> Mapping[str, Reading]:
    """R1: exponents in h, from `size` m downwards: irradiance in a sphere of flat facets, whole and single, and a shadow's edge."""
    level = 1 + max(0, round(math.log2(EDGE / size)))  # facets half as long, to be small beside the sphere
    sizes = size * ROOTS
    halves = EDGE / 2.0 ** np.array([level, level + 1])
    steps = (level, level + 1)
    found = exponents(R1, size, {
        "sphere of facets": (halves, lambda r: [_facets(k, seed, r) for k in steps]),
        "single facets": (halves, lambda r: [_single(k, seed, r) for k in steps]),
        "edge of a shadow": (sizes, lambda r: [_shadow(float(h), seed, r) for h in sizes]),
    })  # fmt: skip
    return {**found, "single facets, over theory": _of_theory(level + 1, seed)}


@cache
def _sphere(level: int) -> tuple[Geometry, Patches, F64]:
    """A ball of 20 · 4^level facets, and a radiosity (P,) of its patches that rises evenly with height: where every point of a sphere
    sees every other alike, the irradiance is its mean, 1."""
    s = scene_of([ball(level)], [grey()])
    g = build_geometry(s)
    p = build_patches(s, g, EDGE / 2.0**level)
    return g, p, 1.0 + RISE * p.centroid[:, 1]


@cache
def _deviation(level: int, seed: int, number: int) -> F64:
    """Irradiance of every facet (T,) from FACET_RAYS rays of its own, less that inside of a sphere, 1."""
    g, p, light = _sphere(level)
    whole = np.arange(len(g.faces))
    receivers = area_receivers(g, g.vertices[g.faces], g.normals, whole, whole + 1)
    rows = form_factors(g, p, receivers, FACET_RAYS, 10_000 * seed + number, silent, "facets").matrix()
    return np.asarray(rows[:, : p.count] @ light - 1.0, dtype=np.float64)


def _facets(level: int, seed: int, repeat: int) -> float:
    """Part of the radiosity's rise with height that is left in the irradiance of the facets, each a receiver: 0 in a sphere."""
    g = _sphere(level)[0]
    middle = g.vertices[g.faces].mean(axis=1)[:, 1]
    off = 0.5 * (_deviation(level, seed, 2 * repeat) + _deviation(level, seed, 2 * repeat + 1))
    return abs(float((g.areas * middle) @ off) / float((g.areas * middle) @ (RISE * middle)))


def _single(level: int, seed: int, repeat: int) -> float:
    """RMS over facets of their single deviations, the noise of the rays cancelled between two sets of them."""
    area = _sphere(level)[0].areas
    square = area @ (_deviation(level, seed, 2 * repeat) * _deviation(level, seed, 2 * repeat + 1)) / area.sum()
    return math.sqrt(max(float(square), np.finfo(np.float64).tiny))


def _of_theory(level: int, seed: int) -> Reading:
    """How much of `tilts` the single deviations hold, least squares, from EACH repetitions: 1 if theory is right."""
    tilt = tilts(level)
    return mean_of([float(_deviation(level, seed, k) @ tilt) / float(tilt @ tilt) for k in range(2 * EACH)])


def tilts(level: int) -> F64:
    """What a facet's normal n, apart from the sphere's s at its centroid, adds to its irradiance (T,) [A].

    Inside of a sphere whose light is 1 + a y, direction ω from x brings 1 + a (x_y + 2 (s·ω) ω_y). To first order in t = n - (n·s) s

        E(n) - E(s) = 1/π ∫ L (t·ω) dω = 2a/π t_y ∫ cos θ sin² θ cos² φ dω = a t_y / 2
    """
    g = _sphere(level)[0]
    middle = g.vertices[g.faces].mean(axis=1)
    s = -middle / np.linalg.norm(middle, axis=1, keepdims=True)
    inwards = g.normals * np.sign(np.einsum("ni,ni->n", g.normals, s))[:, None]
    tilt = inwards - np.einsum("ni,ni->n", inwards, s)[:, None] * s
    return np.asarray(0.5 * RISE * tilt[:, 1], dtype=np.float64)


@cache
def _shadow(size: float, seed: int, repeat: int) -> float:
    """Mean absolute error of patch-wise constant sunlight on a floor half in the shadow of a slanting edge, over the sun's."""
    rng = np.random.default_rng([seed, 51, repeat])
    angle, shift = rng.uniform(0.2, 1.3), rng.uniform(-0.5, 0.5)
    along, across = (
        np.array([math.cos(angle), 0.0, math.sin(angle)]),
        np.array([-math.sin(angle), 0.0, math.cos(angle)]),
    )
    far = 2.0 * FLOOR
    roof = [shift * across - far * along, shift * across + far * along, (shift + far) * across + far * along,
            (shift + far) * across - far * along]  # fmt: skip
    half = FLOOR / 2.0
    meshes = [
        quads_mesh([plate((-half, half), (-half, half), 0.0, True)]),
        quads_mesh([np.array(roof) + np.array([0.0, 1.0, 0.0])]),
    ]
    sun = {"sun": {"type": "directional", "direction": (0.0, -1.0, 0.0), "irradiance": (1.0, 1.0, 1.0)}}
    s = scene_of(meshes, [grey(0.5)], lights=sun)
    g = build_geometry(s)
    p = build_patches(s, g, size)
    floor = np.flatnonzero(np.abs(p.centroid[:, 1]) < 0.5)
    light = direct_on_patches(s, g, p, SHADOW_RAYS, seed, silent)[floor, 0]
    at, _ = surface_samples(g, p, floor, rng.random((len(floor), PER_PATCH, 3)))
    lit = at @ across < shift
    return float(p.area[floor] @ np.abs(lit - light[:, None]).mean(axis=1) / p.area[floor].sum())


def rays(least: float, seed: int) -> Mapping[str, Reading]:
    """R2: exponents in the number of rays from `least` to four times as many: form factors of points and of patches, and of patches
    with independent rays in place of scrambled Sobol points."""
    counts = (round(least) * RAYS_STEPS).tolist()

    def law(points: bool, source: Any) -> Law:
        def errors(r: int) -> list[float]:
            with patch.object(accumulate, "scrambled", source):
                return [_spread(points, n, 1000 * seed + 2 * r) for n in counts]

        return np.array(counts, dtype=np.float64), errors

    return exponents(R2, least, {
        "points": law(True, scrambled), "patches": law(False, scrambled), "independent rays": law(False, _independent),
    })  # fmt: skip


def _independent(table: Any, index: Any, seed: Any, dimension: int) -> Any:
    """In place of `scrambled`: numbers in [0, 1) that know nothing of each other."""
    import mitsuba as mi

    return mi.Float(mixed(mixed(index + (0x9E3779B9 * (dimension + 1) & 0xFFFFFFFF)) ^ seed) >> 8) * (1.0 / (1 << 24))


@cache
def _furnished() -> tuple[Geometry, Patches]:
    """A closed room with a block in it."""
    s = scene_of([box((0, 0, 0), (1, 1, 1)), box((0.3, 0.0, 0.4), (0.7, 0.5, 0.8), inward=False)])
    g = build_geometry(s)
    return g, build_patches(s, g, 0.25)


def _spread(points: bool, count: int, seed: int) -> float:
    """RMS error of an entry of a row, from two independent sets of `count` rays a row."""
    g, p = _furnished()
    rng = np.random.default_rng(52)
    at = np.column_stack(
        [rng.uniform(0.05, 0.25, (RECEIVERS, 1)), np.full(RECEIVERS, 0.3), rng.uniform(0.05, 0.95, (RECEIVERS, 1))]
    )
    receivers = point_receivers(g, at, units(RECEIVERS, 52).astype(np.float64)) if points else patch_receivers(g, p)
    a, b = (form_factors(g, p, receivers, count, seed + k, silent, "rays").matrix() for k in (0, 1))
    return math.sqrt(float((a - b).power(2).mean()) / 2.0)


@cache
def _room(seed: int) -> tuple[Patches, Any]:
    """A closed room whose floor emits, and its reconciled rows."""
    faces = box_faces((0, 0, 0), (1, 1.5, 2), cuts=3)
    s = scene_of([quads_mesh(faces[2], exitance=1.0), quads_mesh(np.concatenate(faces[:2] + faces[3:]))])
    g = build_geometry(s)
    p = build_patches(s, g, 0.4)
    return p, reconcile(patch_form_factors(g, p, 1024, seed, silent), p.area).rows


def bounces(albedo: float, seed: int) -> Mapping[str, Reading]:
    """R3: factor by which a sweep of each solver shrinks the error, over the albedo, from the errors after SWEEPS sweeps."""
    p, rows = _room(seed)
    rho = np.full((p.count, 3), albedo)
    system = matrix_system(rows, rho, p.exitance, p.area)
    dense = system.rows("dense").toarray()
    exact = np.linalg.solve(np.eye(p.count) - albedo * dense, p.exitance[:, 0])
    return {name: _shrinking(system, METHODS[name], exact, albedo) for name in ("jacobi", "one-bounce", "gauss-seidel")}


def _shrinking(system: System, method: Any, exact: Floats, albedo: float) -> Reading:
    sweep = method.prepare(system)
    b, r = np.zeros_like(system.source), system.source.astype(np.float64)
    errors = []
    for _ in range(int(SWEEPS[-1]) + 1):
        sweep(b, r)
        errors.append(float(np.sqrt(system.area @ (b[:, 0] - exact) ** 2)))
    steps = np.diff(np.log(np.array(errors)[SWEEPS]))
    factor = math.exp(float(steps.mean())) / albedo
    return Reading(factor, factor * float(steps.std(ddof=1)) / math.sqrt(len(steps)), len(steps), len(steps) - 1)


def voxel_size(size: float, seed: int) -> Mapping[str, Reading]:
    """R4: exponents in h, from `size` m to half of it: light that varies smoothly, the same read half a texel off, a step of light."""
    sizes = size * np.array([1.0, 0.5])

    def law(offset: float, step: bool) -> Law:
        return sizes, lambda r: [_interpolated(float(h), offset, step, seed, r) for h in sizes]

    return exponents(R4, size, {
        "smooth light": law(0.0, False), "half a texel off": law(0.5, False), "step of light": law(0.0, True),
    })  # fmt: skip


def _field(at: F64, seed: int, repeat: int, step: bool) -> F64:
    """Light (N,) at positions (N, 3) m in a cube of 1 m: two waves of about a period, or 1 and 3 on the sides of a plane."""
    rng = np.random.default_rng([seed, 53, repeat])
    k = rng.normal(size=(2, 3))
    k *= 2.0 * math.pi / np.linalg.norm(k, axis=1, keepdims=True)
    if step:
        return np.where((at - 0.5) @ k[0] > rng.uniform(-0.5, 0.5), 3.0, 1.0)
    return np.asarray(2.5 + np.sin(at @ k[0] + rng.uniform(0.0, 6.0)) + np.cos(at @ k[1]))


@cache
def _interpolated(size: float, offset: float, step: bool, seed: int, repeat: int) -> float:
    """RMS error over mean of irradiance sampled from probes every `size` m, read `offset` voxels to the side."""
    level = round(-math.log2(size))
    tree = uniform_octree(Grid(np.zeros(3), size, level, np.full(3, 1 << level, dtype=np.int64)))
    w = world(tree, flat_light(_field(tree.positions, seed, repeat, step)), np.ones(len(tree.corners), dtype=bool))
    p = np.random.default_rng([seed, 54]).uniform(0.1, 0.9, (READS, 3))
    n: F32 = units(READS, seed)
    got = Sampler(device(), w.texture, "float32", "packed")(p + offset * size, n).irradiance[:, 0]
    exact = math.sqrt(math.pi) / 2.0 * _field(p, seed, repeat, step)
    return float(np.sqrt(np.mean((got - exact) ** 2)) / exact.mean())
