"""Direct light: inverse squares, cosines, the spot's ramp against Mitsuba's, shadows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.config import DirectionalLight, PointLight, SpotLight
from lightgauge.reference.progress import silent
from lightgauge.reference.transport.direct import arriving, punctual_irradiance, punctual_lights
from lightgauge.reference.transport.patch_light import direct_on_patches
from lightgauge.reference.truth.mitsuba_scene import _punctual
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, material, quad, random_units, scene, surfaces

FLOOR = [[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [4, 0, -4]]
UP = np.array([0.0, 1.0, 0.0])


def point(**more: Any) -> PointLight:
    return PointLight.model_validate({"type": "point", "position": (0, 2, 0), "intensity": (3, 2, 1), **more})


def spot(**more: Any) -> SpotLight:
    base = {
        "type": "spot",
        "position": (0, 2, 0),
        "direction": (0, -3, 0),
        "intensity": (3, 2, 1),
        "cutoff_deg": 40,
        "beam_deg": 10,
    }
    return SpotLight.model_validate({**base, **more})


def test_inverse_square_and_cosine() -> None:
    """E = I cosθ / d², with cosθ = h / d over a floor."""
    g = build_geometry(scene([quad(FLOOR)]))
    x = np.linspace(-3.9, 3.9, 25)
    p = np.stack([x, 0 * x, 0.5 * x], axis=1)
    e = punctual_irradiance(g, point(), p, np.tile(UP, (25, 1)))
    d = np.sqrt(4 + (p**2).sum(axis=1))
    np.testing.assert_allclose(e, (2 / d**3)[:, None] * [3, 2, 1], rtol=1e-12)
    assert not punctual_irradiance(g, point(), p, np.tile(-UP, (25, 1))).any()


def test_directional_light() -> None:
    g = build_geometry(scene([quad(FLOOR)]))
    light = DirectionalLight.model_validate({"type": "directional", "direction": (3, -4, 0), "irradiance": (10, 5, 1)})
    towards, distance, facing = arriving(light, np.zeros((1, 3)))
    np.testing.assert_allclose(towards, [[-0.6, 0.8, 0]])
    assert np.isinf(distance).all() and facing.tolist() == [[10, 5, 1]]
    np.testing.assert_allclose(punctual_irradiance(g, light, np.zeros((1, 3)), UP[None]), [[8, 4, 0.8]])


def mitsuba_facing(light: PointLight | SpotLight | DirectionalLight, points: np.ndarray, scale: float) -> np.ndarray:
    """Irradiance on a plane that faces the light, by Mitsuba's own emitter in a scaled and shifted scene."""
    ensure_variant()
    import mitsuba as mi

    centre = np.array([0.3, -0.2, 0.1])
    sphere = {"type": "sphere", "center": [0, 0, 1e3], "radius": 1e-3}
    built = mi.load_dict({"type": "scene", "l": _punctual(light, centre, scale), "ball": sphere})
    it = mi.SurfaceInteraction3f()
    it.p = mi.Point3f(np.ascontiguousarray(((points - centre) / scale).T, dtype=np.float32))
    it.n = mi.Normal3f(0, 1, 0)
    _, weight = built.emitters()[0].sample_direction(it, mi.Point2f(0.5, 0.5))
    return np.array(weight).T


@pytest.mark.parametrize("scale", [1.0, 0.125])
def test_strength_is_mitsubas(scale: float) -> None:
    """Spot ramp, inverse square and the rescaling of the truth scene, at random points below the light."""
    points = np.array([0, 2.0, 0]) + random_units(2000, 3) * np.random.default_rng(1).uniform(0.5, 5, (2000, 1))
    directional = DirectionalLight.model_validate(
        {"type": "directional", "direction": (1, -2, 0.5), "irradiance": (2, 3, 4)}
    )
    for light in (point(), spot(), spot(direction=(1, -1, 0.3), cutoff_deg=25, beam_deg=24), directional):
        _, _, ours = arriving(light, points)
        truth = mitsuba_facing(light, points, scale)
        # the ramp's borders are sensitive to float32
        close = np.isclose(ours, truth, rtol=2e-4, atol=2e-4 * ours.max()).all(axis=1)
        assert close.mean() > 0.998, (light, ours[~close][:3], truth[~close][:3])


def test_spot_ramp_is_linear_in_angle() -> None:
    angle = np.radians([0.0, 9.9, 10.0, 17.5, 25.0, 32.5, 39.99, 40.01, 80, 180])
    p = np.stack([np.sin(angle), 2 - np.cos(angle), 0 * angle], axis=1)
    _, distance, facing = arriving(spot(), p)
    np.testing.assert_allclose(distance, 1.0)
    np.testing.assert_allclose(facing[:, 2], [1, 1, 1, 0.75, 0.5, 0.25, 1 / 3000, 0, 0, 0], atol=1e-9)


def test_shadows() -> None:
    lid = quad(np.array([[-1, 1, -1], [-1, 1, 1], [1, 1, 1], [1, 1, -1.0]]))
    g = build_geometry(scene([quad(FLOOR), lid]))
    p = np.array([[0, 0, 0], [1.9, 0, 0], [2.1, 0, 0], [0, 1.5, 0]])
    lit = punctual_irradiance(g, point(), p, np.tile(UP, (4, 1))).any(axis=1)
    assert lit.tolist() == [False, False, True, True]
    sun = DirectionalLight.model_validate({"type": "directional", "direction": (1, -1, 0), "irradiance": (1, 1, 1)})
    p = np.array([[0.1, 0, 0], [1.9, 0, 0], [2.1, 0, 0], [-0.1, 0, 0]])
    lit = punctual_irradiance(g, sun, p, np.tile(UP, (4, 1))).any(axis=1)
    assert lit.tolist() == [False, False, True, True]


def test_a_light_beyond_a_wall_is_shadowed_and_one_before_it_is_not() -> None:
    g = build_geometry(scene([box((0, 0, 0), (1, 1, 1))]))
    p, n = np.array([[0.5, 0.0, 0.5]]), UP[None]
    assert punctual_irradiance(g, point(position=(0.5, 0.999, 0.5)), p, n).any()
    assert not punctual_irradiance(g, point(position=(0.5, 1.001, 0.5)), p, n).any()


def test_mean_over_a_patch() -> None:
    """A point light h over a square of side 2a: flux I Ω, Ω = 4 atan(a² / (h √(2a² + h²))). 64 rotated Sobol points on each of
    64 patches: within 1 %."""
    s = scene([quad(np.array(FLOOR) / 4)], lights={"l": point(position=(0, 0.5, 0), intensity=(1, 1, 1)).model_dump()})
    g, p = surfaces(s, 0.25)
    e = direct_on_patches(s, g, p, 64, 1, silent)
    solid = 4 * math.atan(1 / (0.5 * math.sqrt(2 + 0.25)))
    assert (p.area @ e)[0] == pytest.approx(solid, rel=0.01)


def test_area_lamp_is_the_form_factor() -> None:
    """Unit squares facing at distance 1: E = π L F with F = 0.199825 (C-11). 1,024 samples on each of 16 patches."""
    floor = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    lamp = quad([[0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]], mat=1, emission=(1, 2, 0), engine=True)
    s = scene([floor, lamp], [material(), material()])
    g, p = surfaces(s, 0.25)
    e = direct_on_patches(s, g, p, 1024, 1, silent)
    low = p.centroid[:, 2] < 0.5
    np.testing.assert_allclose(e[low].mean(axis=0), math.pi * 0.199825 * np.array([1, 2, 0]), rtol=0.01)
    assert not e[~low].any()


def test_a_lamp_does_not_shine_backwards() -> None:
    floor = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    lamp = quad([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], emission=1.0, engine=True)
    s = scene([floor, lamp])
    g, p = surfaces(s, 0.5)
    assert not direct_on_patches(s, g, p, 64, 1, silent).any()


def test_lights_by_tag_in_order() -> None:
    lights = {"b": point().model_dump(), "a": spot(tag="input").model_dump(), "c": point(intensity=(1, 1, 1)).model_dump(),
              "sky": {"type": "sky", "radiance": (1, 1, 1)}}  # fmt: skip
    s = scene([quad(FLOOR)], lights=lights)
    assert [v.type for v in punctual_lights(s, "engine")] == ["point", "point"]
    assert [v.type for v in punctual_lights(s, "input")] == ["spot"]
