"""Ground truth: indirect irradiance at points, path traced by Mitsuba (`llvm_ad_rgb`, robust Embree).

At a point with normal n, rays gather what comes from their first hit without the emission of lights tagged `engine`
(failure-catalogue F1: far less noise than the difference of two renders):

    E      = ∫ L(ω) max(n·ω, 0) dω       directions follow the cosine
    E_L1   = ∫ L(ω) (1/4 + n·ω/2) dω     what exact L1 radiance SH at the very point would give: the
                                         floor of the method

`BATCHES` independent randomisations give means, standard errors and two independent halves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config import TruthSettings
from ..datatypes import F64, Scene
from ..device_arrays import to_f32
from ..directions import sobol
from ..progress import Progress
from ..visibility import LIFT
from .mitsuba_scene import HALF_EXTENT, TruthScene
from .points import Points

BATCHES = 8
LANES = 1 << 20  # paths per launch
FIRST_SAMPLES, SAMPLES = 16, 64  # per point and randomisation in the first and in later passes: stratified together
FLOOR_NOISE = 0.05  # enough beside floors of a few per cent, because it cancels in the cross-half estimator
ROULETTE_DEPTH, NO_ROULETTE, MAX_DEPTH = 4, 184, 1024
SHINY = 0.9  # albedo that a material kept for the truth counts with in the depth of paths


@dataclass(frozen=True, eq=False)
class Estimate:
    """irradiance (B, N, 3), W·m⁻², from B independent randomisations; l1 (B, N, 3): the same from exact L1 SH at the
    point, or None. spp: paths per point. depth: longest path."""

    irradiance: F64
    l1: F64 | None
    spp: int
    depth: int

    @property
    def mean(self) -> F64:
        """Best estimate, (N, 3)."""
        return np.asarray(self.irradiance.mean(axis=0))

    @property
    def variance_of_mean(self) -> F64:
        """(N, 3), from the spread of the randomisations."""
        return np.asarray(self.irradiance.var(axis=0, ddof=1) / len(self.irradiance))

    @property
    def halves(self) -> tuple[F64, F64]:
        """Two independent estimates, (N, 3) each."""
        return self.irradiance[0::2].mean(axis=0), self.irradiance[1::2].mean(axis=0)

    @property
    def noise(self) -> float:
        """RMS standard error over mean; 0 where everything is dark."""
        mean = float(self.mean.mean())
        return math.sqrt(float(self.variance_of_mean.mean())) / mean if mean > 0 else 0.0


def largest_albedo(scene: Scene) -> float:
    """Largest albedo a path may meet. Mirrors and glass reflect or pass nearly all, whatever their diffuse part says."""
    diffuse = max(float(m.texture.max()) if m.texture is not None else float(m.albedo.max()) for m in scene.materials)
    return min(max(diffuse, 0.05, *(SHINY for m in scene.materials if m.truth_bsdf is not None)), 0.9999)


def path_depth(scene: Scene, tolerance: float) -> int:
    """Depth D with ρ^D under a tenth of `tolerance` for the largest albedo ρ, 8 … MAX_DEPTH (failure-catalogue F3, F4)."""
    return int(np.clip(math.ceil(math.log(tolerance / 10) / math.log(largest_albedo(scene))), 8, MAX_DEPTH))


def roulette_depth(depth: int) -> int:
    """Bounce after which roulette may end a path: early, but never where albedos are so high that paths need more than
    NO_ROULETTE bounces: Mitsuba's survival chance is capped at 0.95, and its variance is unbounded near ρ = 0.975."""
    return ROULETTE_DEPTH if depth <= NO_ROULETTE else depth


def estimate(t: TruthScene, points: Points, s: TruthSettings, depth: int, seed: int, progress: Progress) -> Estimate:
    """Trace until the noise of the irradiance is at most `s.noise`, or `s.max_spp` paths per point; the L1 floor
    until its noise is FLOOR_NOISE."""
    found = _until(t, points, s.noise, s.max_spp, depth, seed, False, progress)
    floor = _until(t, points, FLOOR_NOISE, s.max_spp, depth, seed, True, progress)
    return Estimate(found.irradiance, floor.irradiance, found.spp, depth)


def irradiance_at(
    t: TruthScene, points: Points, noise: float, max_spp: int, depth: int, seed: int, progress: Progress
) -> Estimate:
    """Trace the irradiance alone, without the L1 floor, until its relative noise is at most `noise` or `max_spp` paths per point
    are spent: a second, finer look at some of the points. Another seed than `estimate`'s gives independent paths."""
    return _until(t, points, noise, max_spp, depth, seed, False, progress)


def _until(
    t: TruthScene, points: Points, noise: float, max_spp: int, depth: int, seed: int, l1: bool, progress: Progress
) -> Estimate:
    """Passes until `noise` or `max_spp`. Each pass is an unbiased mean, weighted by its paths."""
    stage = "ground truth: L1 floor" if l1 else "ground truth"
    total, spp, each = np.zeros((BATCHES, len(points.positions), 3)), 0, FIRST_SAMPLES
    while True:
        each = min(each, (max_spp - spp * BATCHES) // BATCHES)
        total += each * _trace_all(t, points, depth, each, BATCHES, [seed, int(l1), spp], l1)
        spp, each = spp + each, SAMPLES
        result = Estimate(total / spp, None, spp * BATCHES, depth)
        needed = max(result.spp, min(max_spp, math.ceil(result.spp * (result.noise / noise) ** 2)))
        progress(stage, result.spp, needed)
        if result.noise <= noise or result.spp > max_spp - BATCHES:
            return result


def picture(t: TruthScene, points: Points, spp: int, depth: int, seed: int, progress: Progress) -> Estimate:
    """Irradiance at every pixel's point from `spp` paths, in two independent halves, without the L1 floor."""
    each = max(1, spp // 2)
    n = len(points.positions)
    step = max(1, LANES // (2 * each))
    parts = []
    for begin in range(0, n, step):
        part = points.part(slice(begin, begin + step))
        parts.append(_trace(t, part, depth, each, 2, [seed, 1 << 20, begin], False))
        progress("truth picture", min(begin + step, n), n)
    return Estimate(np.concatenate(parts, axis=1), None, 2 * each, depth)


def _trace_all(t: TruthScene, points: Points, depth: int, each: int, batches: int, seed: list[int], l1: bool) -> F64:
    """`_trace` in launches of at most about LANES paths."""
    step = max(1, LANES // (each * batches))
    parts = []
    for begin in range(0, len(points.positions), step):
        part = points.part(slice(begin, begin + step))
        parts.append(_trace(t, part, depth, each, batches, [*seed, begin], l1))
    return np.concatenate(parts, axis=1)


def _trace(t: TruthScene, points: Points, depth: int, each: int, batches: int, seed: list[int], l1: bool) -> F64:
    """One launch: mean over `each` paths, (batches, N, 3) f64, of the irradiance or, with `l1`, of E_L1."""
    import drjit as dr
    import mitsuba as mi

    n = len(points.positions)
    lanes = n * batches * each
    rng = np.random.default_rng([*seed, 5])
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(int(rng.integers(1 << 31)), lanes)
    lane = dr.arange(mi.UInt32, lanes)
    point, s = lane // (batches * each), lane % each
    normal = dr.gather(mi.Vector3f, to_f32(points.normals), point)
    local = (points.positions - t.centre) / t.scale
    origin = dr.gather(mi.Point3f, to_f32(local), point) + normal * (LIFT * HALF_EXTENT)
    xi = _stratified(each, lane // each, s, n * batches, rng)
    cosine_direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(xi))
    if l1:
        # Half the net follows the cosine, half the sphere (balance heuristic; Veach 1997). Not by parity: the even
        # points of a Sobol net fill one half of the square.
        direction = dr.select(s < each // 2, cosine_direction, mi.warp.square_to_uniform_sphere(xi))
        cosine = dr.dot(normal, direction)
        weight = (0.25 + 0.5 * cosine) / (0.5 * dr.maximum(cosine, 0.0) * dr.inv_pi + 0.5 * dr.inv_four_pi)
    else:
        direction, weight = cosine_direction, mi.Float(dr.pi)
    radiance = _indirect_radiance(t, mi.RayDifferential3f(mi.Ray3f(origin, direction)), sampler, depth)
    lit = [radiance[c] * weight for c in range(3)]
    dr.eval(lit)  # together: each sum by itself would trace all paths again
    sums = [np.array(dr.block_sum(values, each), dtype=np.float64).reshape(n, batches).T / each for values in lit]
    return np.stack(sums, axis=-1)


def _stratified(each: int, group: Any, s: Any, groups: int, rng: np.random.Generator) -> Any:
    """Sobol points, rotated at random per point and batch: mi.Point2f."""
    import drjit as dr
    import mitsuba as mi

    table = to_f32(sobol(each, 2, int(rng.integers(1 << 31))))
    turn = to_f32(rng.random((groups, 2), dtype=np.float32))
    xi = dr.gather(mi.Point2f, table, s) + dr.gather(mi.Point2f, turn, group)
    return dr.minimum(xi - dr.floor(xi), 1.0 - 2.0**-24)


def _indirect_radiance(t: TruthScene, ray: Any, sampler: Any, depth: int) -> Any:
    """Radiance along `ray`, without what lights tagged `engine` emit towards it."""
    import drjit as dr
    import mitsuba as mi

    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": roulette_depth(depth)})
    radiance, _, _ = integrator.sample(t.scene, sampler, ray)
    first = t.scene.ray_intersect(ray)
    hit = first.is_valid()
    shape = dr.reinterpret_array(mi.UInt32, first.shape)
    engine = dr.gather(mi.Bool, t.engine_shapes, shape, hit)
    engine = dr.select(hit, engine, t.engine_sky)
    emitted = first.emitter(t.scene).eval(first)
    return radiance - dr.select(engine, emitted, 0.0)
