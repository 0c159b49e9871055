"""Direct light on patches light by light: what is kept, what costs rays, lamps near by, and suns in image skies."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.config import SceneSettings
from lightgauge.reference.datatypes import Scene, Sky
from lightgauge.reference.pipeline import bake_surfaces, light_patches
from lightgauge.reference.progress import silent
from lightgauge.reference.sky import sky_radiance, split_peaks
from lightgauge.reference.transport import patch_light
from lightgauge.reference.transport.adaptive import allocate, trace_pilot
from lightgauge.reference.transport.form_factors import patch_form_factors
from lightgauge.reference.transport.gather import upload
from lightgauge.reference.transport.patch_light import DirectLight, direct_on_patches, near_lamp
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.receivers import patch_receivers
from lightgauge.reference.visibility import Geometry
from small_scenes import box, material, quad, scene, surfaces

Array = npt.NDArray[Any]
FLOOR = [[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [4, 0, -4]]
SAMPLES = 16


def point(
    position: tuple[float, float, float], colour: tuple[float, float, float] = (3, 2, 1), **more: Any
) -> dict[str, Any]:
    return {"type": "point", "position": position, "intensity": colour, **more}


def sun(direction: tuple[float, float, float], colour: tuple[float, float, float] = (1, 1, 1)) -> dict[str, Any]:
    return {"type": "directional", "direction": direction, "irradiance": colour}


def relit(s: Scene, **lights: dict[str, Any]) -> Scene:
    """The same scene under other lights."""
    tables = {**s.settings.model_dump(), "lights": lights}
    return dataclasses.replace(s, settings=SceneSettings.model_validate(tables))


def blocked_floor() -> tuple[Scene, Geometry, Patches]:
    lamp = quad([[-4, 3, -4], [-3, 3, -4], [-3, 3, -3], [-4, 3, -3]], emission=(1, 2, 3), engine=True)
    s = scene([quad(FLOOR), box((-1, 0, -1), (1, 1, 1), inward=False), lamp])
    return (s, *surfaces(s, 1.0))


def test_moving_one_light_leaves_the_others_alone() -> None:
    """Rays: one per patch and sample for each light that is new; light: the sum of each by itself, bit for bit."""
    s, g, p = blocked_floor()
    direct = DirectLight(g, p, SAMPLES, 1)
    each = p.count * SAMPLES
    a, b, moved = point((-2, 2, 0)), sun((1, -2, 0.3)), point((2, 1.5, 1))
    first = np.array(direct(relit(s, a=a, b=b), silent))
    assert direct.shadow_rays == 3 * each  # a, b and the lamp
    second = np.array(direct(relit(s, a=moved, b=b), silent))
    assert direct.shadow_rays == 4 * each
    np.testing.assert_array_equal(second, direct_on_patches(relit(s, a=moved, b=b), g, p, SAMPLES, 1, silent))
    np.testing.assert_array_equal(first, direct_on_patches(relit(s, a=a, b=b), g, p, SAMPLES, 1, silent))
    alone = [direct_on_patches(relit(s, x=x), g, p, SAMPLES, 1, silent) for x in (a, moved)]
    np.testing.assert_allclose(second - first, alone[1] - alone[0], atol=1e-12)
    assert (first != second).any(axis=1).mean() > 0.3


def test_colours_cost_no_ray() -> None:
    """Nor does a tag, nor the name, nor the lamp's own colour; other seeds and samples do."""
    s, g, p = blocked_floor()
    direct = DirectLight(g, p, SAMPLES, 1)
    first = np.array(direct(relit(s, a=point((-2, 2, 0)), b=sun((1, -2, 0))), silent))
    rays = direct.shadow_rays
    louder = relit(s, z=point((-2, 2, 0), (6, 0, 1), tag="input"), b=sun((1, -2, 0), (0.5, 0.5, 0)))
    meshes = tuple(dataclasses.replace(m, emission=m.emission * [0, 1, 5]) for m in s.meshes)
    louder = dataclasses.replace(louder, meshes=meshes)
    second = np.array(direct(louder, silent))
    assert direct.shadow_rays == rays and not np.allclose(first, second)
    np.testing.assert_allclose(second, direct_on_patches(louder, g, p, SAMPLES, 1, silent), rtol=1e-12)


def test_lights_that_go_are_forgotten() -> None:
    s, g, p = blocked_floor()
    direct = DirectLight(g, p, SAMPLES, 1)
    direct(relit(s, a=point((-2, 2, 0))), silent)
    direct(relit(s), silent)
    rays = direct.shadow_rays
    back = np.array(direct(relit(s, a=point((-2, 2, 0))), silent))
    assert direct.shadow_rays == rays + p.count * SAMPLES
    np.testing.assert_array_equal(back, direct_on_patches(relit(s, a=point((-2, 2, 0))), g, p, SAMPLES, 1, silent))


def test_repeats_whatever_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    s, g, p = blocked_floor()
    s = relit(s, a=point((-2, 2, 0)), b=sun((1, -2, 0)))
    whole = direct_on_patches(s, g, p, SAMPLES, 1, silent)
    monkeypatch.setattr(patch_light, "POINTS_PER_BATCH", 100)
    np.testing.assert_array_equal(direct_on_patches(s, g, p, SAMPLES, 1, silent), whole)
    assert not np.array_equal(direct_on_patches(s, g, p, SAMPLES, 2, silent), whole)


def test_patches_near_a_lamp_take_its_light_through_their_form_factors() -> None:
    """Unit squares 1 cm apart: F = 0.98063 (Howell C-11). Of 64 pairs of points hardly one is as near as it would have to be;
    with rows the error is that of the rays. Other patches keep theirs."""
    gap = 0.01
    floor = quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    far = quad([[0, 0, -3], [1, 0, -3], [1, 1, -3], [0, 1, -3]], mat=1)
    lamp = quad([[0, 0, gap], [0, 1, gap], [1, 1, gap], [1, 0, gap]], mat=2, emission=1.0, engine=True)
    s = scene([floor, far, lamp], [material()] * 3)
    g, p = surfaces(s, 9.0)
    near = int(np.flatnonzero(np.abs(p.centroid[:, 2]) < 1e-9)[0])
    errors = []
    for seed in range(12):
        rows = upload(patch_form_factors(g, p, 4096, seed, silent))
        without = direct_on_patches(s, g, p, 64, seed, silent)
        with_rows = direct_on_patches(s, g, p, 64, seed, silent, rows)
        errors.append([without[near, 0] / math.pi - 0.98063, with_rows[near, 0] / math.pi - 0.98063])
        others = np.arange(p.count) != near
        np.testing.assert_array_equal(with_rows[others], without[others])
    sampled, gathered = np.sqrt((np.array(errors) ** 2).mean(axis=0))
    assert gathered < 5e-3 and sampled > 0.1, (gathered, sampled)


def room_with_a_lamp() -> Scene:
    """A cube, and in it a lamp of the engine's under the ceiling, half of it 5 cm above a shelf."""
    lamp = quad([[0.3, 0.9, 0.3], [0.7, 0.9, 0.3], [0.7, 0.9, 0.7], [0.3, 0.9, 0.7]], emission=1.0, engine=True)
    shelf = quad([[0.3, 0.85, 0.3], [0.3, 0.85, 0.7], [0.5, 0.85, 0.7], [0.5, 0.85, 0.3]])
    return scene([box((0, 0, 0), (1, 1, 1)), shelf, lamp])


def test_rows_that_read_too_much_do_not_choose_themselves() -> None:
    """Who is near is for the pilot's rays to say: rows of few rays that found the lamp three times too often are those that would be
    taken for near ones."""
    s = room_with_a_lamp()
    g, p = surfaces(s, 0.25)
    rows = patch_form_factors(g, p, 4096, 1, silent)
    lit = direct_on_patches(s, g, p, 64, 1, silent, upload(rows))
    tripled = direct_on_patches(s, g, p, 64, 1, silent, upload(dataclasses.replace(rows, values=3 * rows.values)))
    true = rows.matrix(0)[:, : p.count] @ (p.emitter == 2)
    near = near_lamp(p, trace_pilot(g, p, patch_receivers(g, p), 1), 2)
    misled = (3.0 * true > patch_light.NEAR) & ~near
    assert misled.any() and near[true > 0.5].all() and (true > 0.5).any()
    np.testing.assert_array_equal(tripled[~near], lit[~near])
    np.testing.assert_allclose(tripled[near], 3.0 * lit[near], rtol=1e-6)


def test_patches_near_an_engine_lamp_get_rays_for_its_light() -> None:
    """Nobody else gathers it, so the light that rays are shared out by does not hold it: 0.7 of the shelf's hemisphere."""
    s = room_with_a_lamp()
    settings = s.settings.model_dump() | {"radiosity": {"patch_size": 0.25, "rays": 16384, "noise": 0.01}}
    made = dataclasses.replace(s, settings=SceneSettings.model_validate(settings))
    found = bake_surfaces(made, 1)
    p, pilot = (
        found.patches,
        trace_pilot(found.geometry, found.patches, patch_receivers(found.geometry, found.patches), 1),
    )
    near = near_lamp(p, pilot, 2)
    shelf = np.isclose(p.centroid[:, 1], 0.85) & (p.normal[:, 1] > 0.0)
    assert shelf.any() and near[shelf].all() and not near.all()
    plain = allocate(pilot, found.guess, p.area, 0.01, 16384)
    assert (found.allocation.rays[shelf] >= 4 * plain.rays[shelf]).all(), (
        found.allocation.rays[shelf],
        plain.rays[shelf],
    )
    np.testing.assert_array_equal(found.allocation.rays[~near], plain.rays[~near])


# Suns in image skies


def sky_with_sun(
    row: int, column: int, radiance: float, rotation: float = 0.0, height: int = 64, width: int = 128
) -> Sky:
    picture = np.full((height, width, 3), 0.1, np.float32)
    picture[row, column] += np.float32([1.0, 0.8, 0.5]) * radiance
    return Sky(picture, rotation, False)


def sun_of(sky: Sky) -> Array:
    """Direction (3,) to the brightest texel."""
    height, width = sky.image.shape[:2]
    row, column = np.unravel_index(sky.image.sum(axis=2).argmax(), (height, width))
    return turned(sky, np.array([math.pi * row / (height - 1)]), np.array([(column + 0.5) / width * 2 * math.pi]))[0]


def turned(sky: Sky, theta: Array, phi: Array) -> Array:
    x, z = np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi)
    a = math.radians(sky.rotation_deg)
    return np.stack([math.cos(a) * x + math.sin(a) * z, np.cos(theta), -math.sin(a) * x + math.cos(a) * z], axis=1)


def irradiance_of(sky: Sky, normal: Array) -> Array:
    """∫ L cos dω (3,) by the midpoint rule on 8 × 8 points a texel."""
    height, width = sky.image.shape[:2]
    theta = (np.arange(8 * (height - 1)) + 0.5) / (8 * (height - 1)) * math.pi
    phi = (np.arange(8 * width) + 0.5) / (8 * width) * 2 * math.pi
    d = turned(sky, np.repeat(theta, len(phi)), np.tile(phi, len(theta)))
    weight = np.repeat(np.sin(theta), len(phi)) * np.maximum(d @ normal, 0.0) * (2 * math.pi**2 / len(theta) / len(phi))
    return np.asarray(weight @ sky_radiance(sky, d))


def tilted(degrees: float) -> Array:
    a = math.radians(degrees)
    return np.array(FLOOR, float) @ np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]])


@pytest.mark.parametrize("rotation, tilt", [(0.0, 0.0), (77.0, 0.0), (-150.0, 30.0), (10.0, -20.0), (200.0, 60.0)])
def test_a_sun_of_one_texel(rotation: float, tilt: float) -> None:
    """E = ∫ L cos dω of what exceeds the smooth sky (L × solid angle × cos, but for the texel's width): 64 patches of 64 points
    each. The cosine changes over that width by up to 5 %: so the patches spread, by under 0.5 %; the mean holds to 0.1 %."""
    sky = sky_with_sun(14, 100, 400.0, rotation)
    s = scene([quad(tilted(tilt))], sky=sky)
    g, p = surfaces(s, 1.0)
    e = direct_on_patches(s, g, p, 64, 1, silent)
    excess = split_peaks(sky)[1]
    assert excess is not None
    exact, cosine = irradiance_of(excess, p.normal[0]), float(p.normal[0] @ sun_of(sky))
    solid = math.sin(math.pi * 14 / 63) * math.pi / 63 * 2 * math.pi / 128
    np.testing.assert_allclose(exact, excess.image.max(axis=(0, 1)) * solid * max(cosine, 0.0), rtol=3e-3)
    np.testing.assert_allclose(e.mean(axis=0), exact, rtol=1e-3, atol=1e-12)
    assert abs(cosine) > 0.1 and e[:, 0].std() <= 5e-3 * exact[0]


def test_a_sun_casts_a_sharp_shadow() -> None:
    """A lid 1 m above the floor: its border's shadow lies where the sun's direction says, and the half shadow is no wider than the
    texel and its neighbours' hats (two texels: 5.7°, 0.13 m at this height)."""
    sky = sky_with_sun(14, 96, 3000.0)
    direction = sun_of(sky)
    lid = quad([[-9, 1, -9], [0, 1, -9], [0, 1, 9], [-9, 1, 9]], mat=1)
    s = scene([quad(FLOOR), lid], [material(), material()], sky=sky)
    g, p = surfaces(s, 0.1)
    floor = np.abs(p.centroid[:, 1]) < 1e-9
    e = direct_on_patches(s, g, p, 32, 1, silent)[floor, 0]
    border, x = -direction[0] / direction[1], p.centroid[floor, 0]
    lit = np.median(e[x > border + 0.4])
    assert not e[x < border - 0.2].any() and lit > 0.1
    np.testing.assert_allclose(e[x > border + 0.2], lit, rtol=0.02)
    assert p.area[floor] @ e / lit / 8.0 == pytest.approx(4.0 - border, abs=0.005)
    half = x[(e > 0.02 * lit) & (e < 0.98 * lit)]
    assert len(half) > 50 and half.std() < 0.08


def test_sun_and_sky_add_up_to_the_whole_sky() -> None:
    """Nothing is counted twice: a black floor's irradiance through the whole pipeline against ∫ L cos over the picture."""
    sky = sky_with_sun(14, 100, 400.0, 33.0)
    s = scene([quad(FLOOR)], [material(0.0)], sky=sky, radiosity={"patch_size": 1.0, "rays": 4096, "noise": 0.003})
    baked = bake_surfaces(s, 1)
    irradiance = light_patches(s, baked, 1).radiosity.irradiance.mean(axis=0)
    exact = irradiance_of(sky, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(irradiance, exact, rtol=3e-3)


def test_a_turned_sky_is_another_light() -> None:
    """Its peaks' response is kept while the sky stays, and only its own rays are traced when it turns."""
    sky = sky_with_sun(14, 100, 400.0)
    s = dataclasses.replace(relit(blocked_floor()[0], a=point((-2, 2, 0))), sky=sky)
    g, p = surfaces(s, 1.0)
    direct = DirectLight(g, p, SAMPLES, 1)
    first = np.array(direct(s, silent))
    rays = direct.shadow_rays
    assert np.array_equal(direct(s, silent), first) and direct.shadow_rays == rays
    turned = np.array(direct(dataclasses.replace(s, sky=dataclasses.replace(sky, rotation_deg=90.0)), silent))
    assert direct.shadow_rays == rays + p.count * SAMPLES and not np.allclose(turned, first)


def test_a_smooth_sky_is_no_direct_light() -> None:
    s = scene([quad(FLOOR)], sky=Sky(np.ones((4, 8, 3), np.float32), 0.0, False))
    g, p = surfaces(s, 2.0)
    direct = DirectLight(g, p, SAMPLES, 1)
    assert not direct(s, silent).any() and direct.shadow_rays == 0
