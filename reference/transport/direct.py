"""Direct light at points, with shadow rays.

Point: E = I/d² · cosθ. Spot: the same times a ramp linear in angle between beam and cutoff. Directional: E⊥ · cosθ.
Area lights: one point of the lamp per receiving point, E = L cosθ cosθ' A / d². Peaks of an image sky: directions by the sky's
luminance, E = L cosθ / density.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..config import DirectionalLight, PointLight, Punctual, SpotLight
from ..datatypes import F64, Scene, Sky
from ..sky import sample_sky, sky_radiance
from ..visibility import Geometry, occluded, points_on_triangles, to_box, vectors


def punctual_lights(scene: Scene, tag: str) -> list[Punctual]:
    """The scene's point, spot and directional lights with this tag, in the order of the file."""
    lights = scene.settings.lights.values()
    return [v for v in lights if isinstance(v, PointLight | SpotLight | DirectionalLight) and v.tag == tag]


def arriving(light: Punctual, points: F64) -> tuple[F64, F64, F64]:
    """Unoccluded light at `points` (N, 3): direction to the light (N, 3), distance (N,) m, irradiance on a plane that
    faces it (N, 3) W·m⁻²."""
    towards, distance, strength = _falling(light, points)
    return towards, distance, strength[:, None] * colour_of(light)


def colour_of(light: Punctual) -> F64:
    """Intensity, or irradiance of a directional light, (3,)."""
    return np.asarray(light.irradiance if isinstance(light, DirectionalLight) else light.intensity, dtype=np.float64)


def _falling(light: Punctual, points: F64) -> tuple[F64, F64, F64]:
    """Direction (N, 3), distance (N,) and irradiance (N,) on a plane that faces the light, for a light of colour 1."""
    n = len(points)
    if isinstance(light, DirectionalLight):
        towards = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        return np.tile(towards, (n, 1)), np.full(n, np.inf), np.ones(n)
    offset = np.asarray(light.position) - points
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    towards = offset / distance[:, None]
    strength = 1.0 / distance**2
    if isinstance(light, SpotLight):
        axis = np.asarray(light.direction) / np.linalg.norm(light.direction)
        angle = np.arccos(np.clip(-towards @ axis, -1.0, 1.0))
        cutoff, beam = math.radians(light.cutoff_deg), math.radians(light.beam_deg)
        strength = strength * np.clip((cutoff - angle) / (cutoff - beam), 0.0, 1.0)
    return towards, distance, strength


def visible(g: Geometry, points: F64, normals: F64 | None, towards: F64, distance: F64) -> npt.NDArray[np.bool_]:
    """Whether nothing lies between `points` (N, 3) and the light."""
    reach = np.minimum(distance / g.scale, 1e6) * (1.0 - 1e-5)
    return ~np.array(occluded(g, to_box(g, points, normals), vectors(towards), reach.astype(np.float32)))


def punctual_response(g: Geometry, light: Punctual, points: F64, normals: F64) -> F64:
    """Shadowed irradiance (N,) of a light of colour 1 at `points` with unit `normals` (N, 3)."""
    towards, distance, strength = _falling(light, points)
    cosine = np.maximum(np.einsum("ni,ni->n", towards, normals), 0.0)
    lit = (cosine > 0.0) & visible(g, points, normals, towards, distance)
    return np.asarray(strength * cosine * lit)


def punctual_irradiance(g: Geometry, light: Punctual, points: F64, normals: F64) -> F64:
    """Shadowed irradiance (N, 3), W·m⁻², of one light at `points` with unit `normals` (N, 3)."""
    return punctual_response(g, light, points, normals)[:, None] * colour_of(light)


def peak_irradiance(g: Geometry, peaks: Sky, points: F64, normals: F64, xi: npt.NDArray[np.floating]) -> F64:
    """Irradiance (N, 3) from one direction each towards the sky's peaks, chosen with `xi` (N, 2) uniform."""
    towards, density = sample_sky(peaks, xi)
    cosine = np.maximum(np.einsum("ni,ni->n", towards, normals), 0.0)
    seen = visible(g, points, normals, towards, np.full(len(points), np.inf))
    return np.asarray((cosine * seen / density)[:, None] * sky_radiance(peaks, towards))


def lamp_response(g: Geometry, lamp: int, points: F64, normals: F64, xi: npt.NDArray[np.floating]) -> F64:
    """Irradiance (N,) from one point each of mesh `lamp`, were its radiance 1, chosen by area with `xi` (N, 3) uniform."""
    triangles = np.flatnonzero(g.mesh == lamp)
    if len(triangles) == 0:
        return np.zeros(len(points))
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
    return np.asarray(kernel * seen)
