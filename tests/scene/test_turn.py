"""`scene.rotation`: everything of a scene turns, once, and light does not notice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.config import ImageSky, SceneSettings
from lightgauge.reference.datatypes import Scene, Sky
from lightgauge.reference.errors import InputError
from lightgauge.reference.progress import silent
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.lights_file import load_lights
from lightgauge.reference.scene.turn import turned_settings
from lightgauge.reference.sky import sky_radiance
from lightgauge.reference.truth.mitsuba_scene import build_truth_scene
from lightgauge.reference.truth.path_traced import picture
from lightgauge.reference.truth.points import choose_points
from lightgauge.reference.turned import rotation_matrix, turned
from lightgauge.reference.visibility import build_geometry
from lightgauge.validation.leaks.measured import dark_boxes

TWO_ROOMS = Path(__file__).resolve().parents[2] / "scenes" / "two-rooms"
QUICK: dict[str, Any] = {
    "radiosity": {"patch_size": 0.4, "rays": 1024},
    "truth": {"points": 96},
}


def two_rooms(rotation: Any = None, **more: Any) -> Scene:
    turn = {} if rotation is None else {"scene": {"rotation": rotation}}
    return load_scene(TWO_ROOMS, {**QUICK, **turn, **more})


def test_no_turn_changes_no_bit() -> None:
    plain, zero, whole = two_rooms(), two_rooms(0), two_rooms(360)
    assert zero.content_hash == plain.content_hash
    for a, b in zip(plain.meshes, whole.meshes, strict=True):
        assert np.array_equal(a.vertices, b.vertices)
    assert whole.settings.lights == plain.settings.lights and whole.settings.cameras == plain.settings.cameras


def test_all_of_the_scene_turns() -> None:
    turn = (10.0, 30.0, -5.0)
    m, maps = rotation_matrix(turn), {"cubemaps": {"c": {"position": [1.0, 2.0, 0.5]}}}
    plain, tilted = two_rooms(**maps), two_rooms(list(turn), **maps)
    assert tilted.content_hash != plain.content_hash
    for a, b in zip(plain.meshes, tilted.meshes, strict=True):
        np.testing.assert_allclose(b.vertices, a.vertices @ m.T, atol=1e-12)
        assert np.array_equal(a.faces, b.faces) and a.closed == b.closed
    old, new = plain.settings, tilted.settings
    np.testing.assert_allclose(new.lights["shelf"].position, m @ old.lights["shelf"].position)  # type: ignore[union-attr]
    np.testing.assert_allclose(new.cubemaps["c"].position, m @ old.cubemaps["c"].position)
    for name, camera in old.cameras.items():
        for key in ("origin", "target", "up"):
            np.testing.assert_allclose(getattr(new.cameras[name], key), m @ getattr(camera, key), atol=1e-12)
    sealed = dark_boxes(tilted)[0]
    np.testing.assert_allclose(sealed.corners, dark_boxes(plain)[0].corners @ m.T, atol=1e-12)


def test_the_points_turn_with_it() -> None:
    plain, tilted = two_rooms(), two_rooms(30.0)
    m = rotation_matrix(30.0)
    a, b = (choose_points(s, build_geometry(s), 96, 1) for s in (plain, tilted))
    assert list(a) == list(b) == ["camera", "surface", "volume"]
    np.testing.assert_allclose(b["volume"].positions, turned(a["volume"].positions, m), atol=1e-12)
    np.testing.assert_allclose(b["volume"].normals, turned(a["volume"].normals, m), atol=1e-12)
    np.testing.assert_allclose(b["surface"].positions, turned(a["surface"].positions, m), atol=1e-9)


def test_light_does_not_notice() -> None:
    """Radiosity and ground truth of the turned scene, within noise. A light or a mesh left behind would change both by tens of
    percent."""
    mean, truth = [], []
    for scene in (two_rooms(), two_rooms(30.0)):
        surfaces = pipeline.bake_surfaces(scene, 0)
        light = pipeline.light_patches(scene, surfaces, 0)
        patches = surfaces.patches
        mean.append(patches.area @ light.radiosity.radiosity / patches.area.sum())
        points = choose_points(scene, surfaces.geometry, 96, 0)["camera"]
        traced = build_truth_scene(scene)
        truth.append(np.concatenate([picture(traced, points, 64, 8, n, silent).irradiance for n in range(6)]))
    np.testing.assert_allclose(mean[1], mean[0], rtol=5e-3)  # six times what another seed changes
    a, b = (batches.mean(axis=(1, 2)) for batches in truth)  # (B,) means over all points, independent batches
    noise = np.hypot(*(x.std(ddof=1) / np.sqrt(len(x)) for x in (a, b)))
    assert abs(a.mean() - b.mean()) < 5.0 * noise < 0.12 * a.mean()


def sky_settings(rotation: Any, sky: dict[str, Any]) -> SceneSettings:
    tables = {"scene": {"rotation": rotation}, "materials": {}, "meshes": {}, "lights": {"sky": sky}}
    return SceneSettings.model_validate_json(json.dumps(tables), strict=True)


def test_sky_pictures_turn_about_y_and_are_never_tilted() -> None:
    picture = {"type": "image_sky", "file": "a.exr", "rotation_deg": 20.0}
    sky = turned_settings(sky_settings(30.0, picture), "f").lights["sky"]
    assert isinstance(sky, ImageSky) and sky.rotation_deg == pytest.approx(50.0)
    image = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    d = np.random.default_rng(1).normal(size=(40, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    before, after = (
        sky_radiance(Sky(image, 20.0, False), d),
        sky_radiance(Sky(image, 50.0, False), turned(d, rotation_matrix(30.0))),
    )
    np.testing.assert_allclose(after, before, rtol=1e-6)  # the light from a direction comes from the turned one
    with pytest.raises(InputError, match=r"f: lights\.sky: scene\.rotation would tilt"):
        turned_settings(sky_settings([1.0, 0.0, 0.0], picture), "f")
    half = turned_settings(sky_settings([180.0, 0.0, 180.0], picture), "f").lights[
        "sky"
    ]  # half about x and z is half about y
    assert isinstance(half, ImageSky) and half.rotation_deg % 360.0 == pytest.approx(200.0)
    even = {"type": "sky", "radiance": [1.0, 1.0, 1.0]}
    assert turned_settings(sky_settings([1.0, 2.0, 3.0], even), "f").lights["sky"].radiance == (1.0, 1.0, 1.0)  # type: ignore[union-attr]


def test_a_lights_file_is_turned_like_the_scene(tmp_path: Path) -> None:
    """What the file gives is written in the scene's own axes, what it leaves out stays where it was."""
    scene, m = two_rooms(30.0), rotation_matrix(30.0)
    path = tmp_path / "new.toml"
    path.write_text(
        'scene = "two-rooms"\n[lights.shelf]\nintensity = [9.0, 9.0, 9.0]\n'
        '[lights.new]\ntype = "point"\nposition = [1.0, 1.0, 1.0]\nintensity = [1.0, 1.0, 1.0]\n'
    )
    lights = load_lights(path, "two-rooms", scene.settings.lights, ["lamp"], None, 30.0).lights
    np.testing.assert_allclose(lights["shelf"].position, scene.settings.lights["shelf"].position, atol=1e-12)  # type: ignore[union-attr]
    np.testing.assert_allclose(lights["new"].position, m @ np.ones(3))  # type: ignore[union-attr]
    assert lights["ceiling"] == scene.settings.lights["ceiling"]
