"""Direct light: what punctual lights send to points, and what they and lamps tagged `engine` put on patches.

Point: E = I/d² · cosθ. Spot: the same times a ramp linear in angle between beam and cutoff. Directional: E⊥ · cosθ.
Area lights tagged `engine`: one point of the lamp per sample of the patch, E = L cosθ cosθ' A / d² (all with shadow rays).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..config import DirectionalLight, PointLight, Punctual, SpotLight
from ..datatypes import F64, Scene
from ..directions import rotate, rotations, sobol
from ..progress import Progress
from ..sky import SKY_BINS
from ..visibility import Geometry, occluded, points_on_triangles, to_box, vectors
from .gather import DeviceRows, gather
from .patches import Patches, surface_samples

NEAR = 0.1  # share of a patch's hemisphere


def punctual_lights(scene: Scene, tag: str) -> list[Punctual]:
    """The scene's point, spot and directional lights with this tag, in the order of the file."""
    lights = scene.settings.lights.values()
    return [v for v in lights if isinstance(v, PointLight | SpotLight | DirectionalLight) and v.tag == tag]


def arriving(light: Punctual, points: F64) -> tuple[F64, F64, F64]:
    """Unoccluded light at `points` (N, 3): direction to the light (N, 3), distance (N,) m, irradiance on a plane that
    faces it (N, 3) W·m⁻²."""
    if isinstance(light, DirectionalLight):
        towards = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        n = len(points)
        return np.tile(towards, (n, 1)), np.full(n, np.inf), np.tile(np.asarray(light.irradiance), (n, 1))
    offset = np.asarray(light.position) - points
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    towards = offset / distance[:, None]
    strength = 1.0 / distance**2
    if isinstance(light, SpotLight):
        axis = np.asarray(light.direction) / np.linalg.norm(light.direction)
        angle = np.arccos(np.clip(-towards @ axis, -1.0, 1.0))
        cutoff, beam = math.radians(light.cutoff_deg), math.radians(light.beam_deg)
        strength = strength * np.clip((cutoff - angle) / (cutoff - beam), 0.0, 1.0)
    return towards, distance, strength[:, None] * np.asarray(light.intensity)


def visible(g: Geometry, points: F64, normals: F64 | None, towards: F64, distance: F64) -> npt.NDArray[np.bool_]:
    """Whether nothing lies between `points` (N, 3) and the light."""
    reach = np.minimum(distance / g.scale, 1e6) * (1.0 - 1e-5)
    return ~np.array(occluded(g, to_box(g, points, normals), vectors(towards), reach.astype(np.float32)))


def punctual_irradiance(g: Geometry, light: Punctual, points: F64, normals: F64) -> F64:
    """Shadowed irradiance (N, 3), W·m⁻², of one light at `points` with unit `normals` (N, 3)."""
    towards, distance, facing = arriving(light, points)
    cosine = np.maximum(np.einsum("ni,ni->n", towards, normals), 0.0)
    lit = (cosine > 0.0) & visible(g, points, normals, towards, distance)
    return facing * (cosine * lit)[:, None]


def direct_on_patches(
    scene: Scene,
    g: Geometry,
    p: Patches,
    samples: int,
    seed: int,
    progress: Progress,
    rows: DeviceRows | None = None,
) -> F64:
    """Mean irradiance (P, 3), W·m⁻², of every patch from point, spot and directional lights and area lights tagged `engine`.

    rows: patch form factors. With them, patches whose hemisphere holds more than NEAR of a lamp take its light through
    them: there area sampling is heavy-tailed (failure-catalogue A5), and cosine rays are good.
    """
    lights = punctual_lights(scene, "engine") + punctual_lights(scene, "input")  # both are reflected
    lamps = [i for i, m in enumerate(scene.meshes) if m.engine_lit and m.static and m.emission.any()]
    total, from_lamps = np.zeros((p.count, 3)), np.zeros((p.count, 3))
    if not lights and not lamps:
        return total
    table, offsets = sobol(samples, 6, seed + 1), rotations(p.count, 6, seed + 1)
    step = max(1, (1 << 20) // samples)
    for begin in range(0, p.count, step):
        part = np.arange(begin, min(begin + step, p.count))
        xi = rotate(table[None], offsets[part][:, None, :])
        points, normals = (a.reshape(-1, 3) for a in surface_samples(g, p, part, xi[..., :3]))
        for item in lights:
            light = punctual_irradiance(g, item, points, normals)
            total[part] += light.reshape(len(part), samples, 3).mean(axis=1)
        for lamp in lamps:
            light = _lamp_irradiance(scene, g, lamp, points, normals, xi[..., 3:].reshape(-1, 3))
            from_lamps[part] += light.reshape(len(part), samples, 3).mean(axis=1)
        progress("direct light", int(part[-1]) + 1, p.count)
    if rows is not None and lamps:
        dark = np.zeros((SKY_BINS + 1, 3))
        share = gather(rows, np.concatenate([p.engine_exitance > 0.0, dark]))[:, 0].max(axis=1)
        through_rows = gather(rows, np.concatenate([p.engine_exitance, dark]))[:, 0]
        from_lamps = np.where((share > NEAR)[:, None], through_rows, from_lamps)
    return total + from_lamps


def _lamp_irradiance(
    scene: Scene, g: Geometry, lamp: int, points: F64, normals: F64, xi: npt.NDArray[np.floating]
) -> F64:
    """Irradiance (N, 3) from one point each of emitting mesh `lamp`, chosen by area with `xi` (N, 3) uniform."""
    triangles = np.flatnonzero(g.mesh == lamp)
    if len(triangles) == 0:
        return np.zeros_like(points)
    cumulative = np.cumsum(g.areas[triangles])
    pick = triangles[np.searchsorted(cumulative[:-1], xi[:, 0] * cumulative[-1], side="right")]
    fold = xi[:, 1:].sum(axis=1, keepdims=True) > 1.0
    source = points_on_triangles(g, pick, np.where(fold, 1.0 - xi[:, 1:], xi[:, 1:]).astype(np.float64))
    offset = source - points
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9 * g.scale)
    towards = offset / distance[:, None]
    cos_here = np.maximum(np.einsum("ni,ni->n", towards, normals), 0.0)
    cos_lamp = np.maximum(-np.einsum("ni,ni->n", towards, g.normals[pick]), 0.0)
    kernel = cos_here * cos_lamp * cumulative[-1] / distance**2
    seen = visible(g, points, normals, towards, distance)
    return np.asarray((kernel * seen)[:, None] * scene.meshes[lamp].emission)
