"""The path-traced end of the waterfall: paths enough that their noise does not hide what the links explain.

The share of the squared error that is the reference's own noise shrinks with its paths: with noise σ and error e, both relative,
it is σ² / (e² + σ²). Paths are chosen for REMAINDER of it, from the error that the run's own points read, and capped; a chain that
would need more says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, Scene
from ...reference.progress import Progress
from ...reference.transport.direct import punctual_irradiance, punctual_lights
from ...reference.truth.mitsuba_scene import build_truth_scene
from ...reference.truth.path_traced import irradiance_at, path_depth
from ...reference.truth.points import Points
from ...reference.visibility import Geometry, build_geometry
from .. import cache
from ..metrics.error import cross_half_mse
from .kept import Parts

REMAINDER = 0.03  # of the squared error may be the reference's noise
UNEXPLAINED = 0.05  # more than that is said, with what it would take
MOST_PATHS = 16_000_000
MOST_SPP = 1 << 18
LEAST_ERROR = 1e-3  # relative: less is not taken apart
SEED = 5000


@dataclass(frozen=True, eq=False)
class Reference:
    """irradiance (B, N, 3) f64 W·m⁻², B independent batches; spp: paths per point behind it; needed: that REMAINDER takes, where the
    cap was in the way, else 0."""

    irradiance: F64
    spp: int
    needed: int = 0


def finer(
    scene: Scene, g: Geometry, points: Points, first: Reference, ours: F64, seed: int, progress: Progress, parts: Parts
) -> Reference:
    """The reference `first` (B, N, 3) at `points` with as many more paths as REMAINDER takes, given what is sampled there (N, 3): for
    all points together and for those of each camera. parts: keeps them."""
    groups = [np.ones(len(ours), dtype=np.bool_)]
    if points.camera is not None:
        groups += [points.camera == camera for camera in np.unique(points.camera)]
    times = max(_times(ours[mine], first.irradiance[:, mine]) for mine in groups)
    if times <= 1.0:
        return first
    # The variance falls a little faster than with one over the paths, as passes are stratified: the prediction is on the safe side.
    more = math.ceil(first.spp * (times - 1.0))
    allowed = min(MOST_SPP, max(MOST_PATHS // len(points.positions), 512))
    noise = relative_noise(first.irradiance) * math.sqrt(first.spp / more)
    found = kept_paths(
        parts, "reference", lambda: paths(scene, g, points, noise, min(more, allowed), seed + SEED, progress)
    )
    share = found.spp / (found.spp + first.spp)
    both = share * found.irradiance + (1.0 - share) * first.irradiance
    return Reference(both, found.spp + first.spp, first.spp + more if more > allowed else 0)


def _times(ours: F64, batches: F64) -> float:
    """How many times the paths of `batches` (B, N, 3) it takes; 0 where it is dark."""
    mean = float(batches.mean())
    if mean <= 0.0:
        return 0.0
    square = max(cross_half_mse(ours, batches), (LEAST_ERROR * mean) ** 2)
    return (relative_noise(batches) * mean) ** 2 * (1.0 - REMAINDER) / (REMAINDER * square)


def paths(
    scene: Scene, g: Geometry, points: Points, noise: float, spp: int, seed: int, progress: Progress
) -> Reference:  # fmt: skip
    """Indirect irradiance at points until `noise`, or `spp` paths each; punctual lights tagged `input` are added exactly."""
    depth = path_depth(scene, scene.settings.truth.tolerance)
    found = irradiance_at(build_truth_scene(scene), points, noise, max(spp, 128), depth, seed, progress)
    return Reference(found.irradiance + punctual(scene, g, points), found.spp)


def kept_paths(parts: Parts, name: str, work: Callable[[], Reference]) -> Reference:
    """The paths of `work`, kept as the part `name`."""

    def arrays() -> cache.Arrays:
        found = work()
        return {"irradiance": found.irradiance, "spp": np.array(found.spp)}

    kept = parts.arrays(name, arrays)
    return Reference(kept["irradiance"], int(kept["spp"]))


def punctual(scene: Scene, g: Geometry, points: Points) -> F64:
    """Direct light (N, 3) of punctual lights tagged `input`, which no path meets."""
    total = np.zeros_like(points.positions)
    for light in punctual_lights(scene, "input"):
        total += punctual_irradiance(g, light, points.positions, points.normals)
    return total


def geometry_of(scene: Scene) -> Geometry:
    """What blocks punctual light in the path tracer: moving meshes too."""
    return build_geometry(scene, moving=True)


def paths_needed(spp: int, remainder: float) -> int:
    """Paths a point that leave REMAINDER of the squared error, where `spp` leave `remainder` (0 to 1) of it; 0 where that is at most
    UNEXPLAINED, or where there is nothing but noise. The noise's square falls with one over the paths, the error stays."""
    if not UNEXPLAINED < remainder < 1.0:
        return 0
    return math.ceil(spp * remainder * (1.0 - REMAINDER) / ((1.0 - remainder) * REMAINDER))


def relative_noise(batches: F64) -> float:
    """Standard error of the mean of batches (B, N, 3), root mean square over the mean."""
    variance = float((batches.var(axis=0, ddof=1) / len(batches)).mean())
    return math.sqrt(variance) / float(batches.mean())
