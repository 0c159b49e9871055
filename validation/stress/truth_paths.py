"""What cases F1, F3 and F4 measure: the path-traced truth in closed scenes whose answer is known, beside paths without its remedies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from ...reference.datatypes import F64, Mesh, Scene
from ...reference.progress import silent
from ...reference.scene.load import load_scene
from ...reference.truth.mitsuba_scene import HALF_EXTENT, TruthScene, build_truth_scene
from ...reference.truth.path_traced import Estimate, largest_albedo, path_depth, picture, roulette_depth
from ...reference.truth.points import Points, choose_points
from ...reference.visibility import LIFT, build_geometry
from ..sources import resolve_scene
from .case import Reading
from .scenes import ball, box, grey, mesh, scene_of
from .truth_bounces import Transport, lost_by_mitsuba, transport

TOLERANCE = 1e-3  # of the truth's depth, its default
RECEIVERS, PATHS = 400, 128
CUT_PATHS = 1024  # of F4, in the Cornell box
FEW, EACH, BOUNDED = (
    128,
    1024,
    64,
)  # receivers in the furnace, their paths, and where no roulette plays, all of one worth
TAIL_PATHS, TAIL_SHARE = 1 << 16, 0.006
CAP, EARLY = 0.95, 4  # Mitsuba's largest chance to survive, and the bounce from which roulette plays elsewhere
MOST_INDEX = 10.0
LONGEST = 128
FURNACE, SEEN = 0.8, 16  # albedo; beyond this depth what is lost is less than the noise
SEEN_LOST = 8  # the same of the Cornell box


def path_values(t: TruthScene, points: Points, depth: int, roulette: int, paths: int, seed: int) -> F64:
    """What single paths bring, (N, paths) W·m⁻² of red, directions following the cosine: Mitsuba's path tracer with independent
    random numbers, the emission of the first hit included."""
    import drjit as dr
    import mitsuba as mi

    n = len(points.positions)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, n * paths)
    point = dr.arange(mi.UInt32, n * paths) // paths
    normal = dr.gather(mi.Vector3f, mi.Float(points.normals.astype(np.float32).ravel()), point)
    local = ((points.positions - t.centre) / t.scale).astype(np.float32)
    origin = dr.gather(mi.Point3f, mi.Float(local.ravel()), point) + normal * (LIFT * HALF_EXTENT)
    direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": roulette})
    radiance, _, _ = integrator.sample(t.scene, sampler, mi.RayDifferential3f(mi.Ray3f(origin, direction)))
    return math.pi * np.array(radiance[0], dtype=np.float64).reshape(n, paths)


def _halves(emitting: bool) -> tuple[Mesh, float]:
    """The upper or lower half of a ball seen from inside, and its share of the area; the upper one is a lamp of the engine's."""
    whole = ball(3)
    corners = whole.vertices[whole.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mine = (corners.mean(axis=1)[:, 1] > 0.0) == emitting
    made = mesh(whole.vertices, whole.faces[mine], exitance=math.pi if emitting else 0.0, engine=emitting)
    return made, float(area[mine].sum() / area.sum())


def _on_walls(made: Mesh, count: int, seed: int) -> Points:
    """Receivers in the middle of `count` random triangles."""
    chosen = np.random.default_rng([seed, 30]).choice(len(made.faces), min(count, len(made.faces)), replace=False)
    a, b, c = (made.vertices[made.faces[chosen, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    return Points((a + b + c) / 3.0, n / np.linalg.norm(n, axis=1, keepdims=True), np.zeros(len(chosen), np.int32))


def _noise(variance_of_mean: F64, mean: F64) -> float:
    """RMS standard error over mean, as `Estimate.noise`."""
    return math.sqrt(float(variance_of_mean.mean())) / float(mean.mean())


def gathered(albedo: float, seed: int) -> Mapping[str, Reading]:
    """F1: indirect light in a sphere whose upper half is a lamp, ρ M̄ / (1 - ρ): as the product gathers it, and as the difference
    of two renders with PATHS paths each."""
    (lamp, share), (dark, _) = _halves(True), _halves(False)
    s = scene_of([lamp, dark], [grey(albedo)])
    t, points, depth = build_truth_scene(s), _on_walls(ball(3), RECEIVERS, seed), path_depth(s, TOLERANCE)
    exact = float(albedo * math.pi * share / (1.0 - albedo))
    e = picture(t, points, PATHS, depth, seed, silent)
    whole = path_values(t, points, depth, roulette_depth(depth), PATHS, 2 * seed)
    direct = path_values(t, points, 1, depth, PATHS, 2 * seed)
    other = path_values(t, points, 1, depth, PATHS, 2 * seed + 1)
    apart = (whole.var(axis=1, ddof=1) + other.var(axis=1, ddof=1)) / PATHS
    paired = (whole - direct).var(axis=1, ddof=1) / PATHS
    n = e.mean[:, 0].size
    ours = _noise(e.variance_of_mean[:, 0], e.mean[:, 0])
    return {
        "error of the mean": Reading(float(e.mean[:, 0].mean()) / exact - 1.0, ours / math.sqrt(n), n * PATHS),
        "noise, difference of renders": Reading(_noise(apart, whole.mean(axis=1) - other.mean(axis=1)) / ours, 0.0, n),
        "noise, same seed": Reading(_noise(paired, whole.mean(axis=1) - direct.mean(axis=1)) / ours, 0.0, n),
    }


@cache
def _furnace(albedo: float) -> tuple[Scene, TruthScene]:
    """A room of 1 m whose walls emit 1 W·m⁻²·sr⁻¹: E = π / (1 - ρ) everywhere."""
    s = scene_of([box((0, 0, 0), (1, 1, 1), exitance=math.pi)], [grey(albedo)])
    return s, build_truth_scene(s)


def _in_air(count: int, seed: int) -> Points:
    rng = np.random.default_rng([seed, 31])
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return Points(rng.uniform(0.2, 0.8, (count, 3)), n, np.full(count, -1, np.int32))


def roulette(albedo: float, seed: int) -> Mapping[str, Reading]:
    """F3: the furnace at one albedo: error of the truth, and how heavy the tail of single paths is, by Hill's estimator: with the
    product's roulette and with roulette from bounce EARLY on."""
    s, t = _furnace(albedo)
    depth = path_depth(s, TOLERANCE)
    plays = roulette_depth(depth) < depth
    paths = EACH if plays else BOUNDED
    e = picture(t, _in_air(FEW, seed), paths, depth, seed, silent)
    each = e.irradiance[:, :, 0].mean(axis=0)
    se = float(each.std(ddof=1)) / math.sqrt(FEW)
    exact = math.pi / (1.0 - albedo)
    found = {"error": Reading(float(each.mean()) / exact - 1.0, se / exact, FEW * paths, FEW - 1)}
    runs = (("tail index", roulette_depth(depth), plays), ("tail index, early roulette", EARLY, True))
    for name, start, long in runs:
        values = path_values(
            t, _in_air(16, seed), depth, start, (TAIL_PATHS if long else TAIL_PATHS >> 6) // 16, seed
        ).ravel()
        found[name] = tail_index(values, TAIL_SHARE)
    return found


def tail_index(values: F64, share: float) -> Reading:
    """Hill 1975, "A simple general approach to inference about the tail of a distribution": a in P(X > x) ~ x^-a from the largest
    `share` of `values` (N,), all positive; at most MOST_INDEX. The variance is finite for a > 2 alone."""
    k = max(2, round(share * len(values)))
    top = np.sort(values)[-k - 1 :]
    mean = float(np.log(top[1:] / top[0]).mean())
    index = min(1.0 / mean, MOST_INDEX) if mean > 0.0 else MOST_INDEX
    return Reading(index, index / math.sqrt(k) if index < MOST_INDEX else 0.0, k)


def early_index(albedo: float) -> float:
    """Tail index that roulette with survival capped at CAP gives [A]: a path grows by ρ / CAP a bounce and survives with CAP."""
    return -math.log(CAP) / math.log(albedo / CAP) if albedo > CAP else math.inf


@cache
def _cornell(seed: int) -> tuple[Scene, TruthScene, Points]:
    s = load_scene(resolve_scene("cornell"))
    points = choose_points(s, build_geometry(s), RECEIVERS, seed)["camera"]
    return s, build_truth_scene(s), points


@cache
def _at_depth(furnace: bool, depth: int, seed: int) -> Estimate:
    """Paths of at most `depth`; those of two depths are the same paths, cut."""
    t, points = (_furnace(FURNACE)[1], _in_air(FEW, seed)) if furnace else _cornell(seed)[1:]
    return picture(t, points, EACH if furnace else CUT_PATHS, depth, seed, silent)


def _lost(furnace: bool, depth: int, seed: int) -> Reading:
    """Share of the light that paths longer than `depth` bring, from the same paths with and without their ends."""
    short, long = (_at_depth(furnace, d, seed).mean.mean(axis=1) for d in (depth, LONGEST))
    share = 1.0 - short.sum() / long.sum()
    se = float((long - short - share * long).std(ddof=1)) * math.sqrt(len(long)) / float(long.sum())
    return Reading(float(share), se, len(long), len(long) - 1)


@cache
def _bounces(seed: int) -> Transport:
    s, _, points = _cornell(seed)
    return transport(s, points, seed)


def _over_solved(depth: int, seed: int) -> Reading:
    """Light of the paths longer than `depth` in the Cornell box, over what a dense solve says of the same receivers. What these have by
    their places is no noise: the standard error is that of what is left of each beside the solve."""
    short, long = (_at_depth(False, d, seed).mean.mean(axis=1) for d in (depth, LONGEST))
    late, expected = long - short, _bounces(seed).late(depth)
    ratio = float(late.sum() / expected.sum())
    se = float((late - ratio * expected).std(ddof=1)) * math.sqrt(len(late)) / float(expected.sum())
    return Reading(ratio, se, len(late), len(late) - 1)


def depth(longest: float, seed: int) -> Mapping[str, Reading]:
    """F4: light lost at one depth in the Cornell box (and over what a dense radiosity solve loses there), in Mitsuba's own box, and in
    the furnace; and at the depth that the product takes for a tolerance of ten times what the Cornell box's largest albedo leaves at
    this depth, over that tolerance."""
    d, s = round(longest), _cornell(seed)[0]
    tolerance = min(10.0 * largest_albedo(s) ** d, 0.5)
    own, box = _lost(False, min(path_depth(s, tolerance), LONGEST), seed), _lost(False, d, seed)
    found = {
        "Cornell box": box,
        "Mitsuba's own box": lost_by_mitsuba(d, seed),
        "own depth, over the tolerance": Reading(own.value / tolerance, own.se / tolerance, own.n, own.df),
    }
    if d <= SEEN_LOST:
        found["Cornell box, over bounces solved"] = _over_solved(d, seed)
    return {**found, "furnace": _lost(True, d, seed)} if d <= SEEN else found
