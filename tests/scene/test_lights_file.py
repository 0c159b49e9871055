"""Lights files: laid over a scene's lights, or refused with file and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.config import ConstantSky, DirectionalLight, ImageSky, Light, PointLight
from lightgauge.reference.datatypes import Sky
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.lights_file import Lighting, load_lights
from scene_files import write_exr

SCENES = Path(__file__).resolve().parents[2] / "scenes"
SUN = DirectionalLight(type="directional", direction=(0, -1, 0), irradiance=(3, 3, 3))
BULB = PointLight(type="point", position=(1, 2, 3), intensity=(5, 5, 5), tag="input")
SKY = ConstantSky(type="sky", radiance=(0.5, 0.6, 0.7))
BASE: dict[str, Light] = {"sun": SUN, "bulb": BULB, "sky": SKY}
MESHES = ("wall", "floor")
HEAD = 'scene = "house"\n'


def load(folder: Path, text: str, base: dict[str, Light] | None = None, sky: Sky | None = None) -> Lighting:
    (folder / "new.toml").write_text(text, encoding="utf-8")
    return load_lights(folder / "new.toml", "house", BASE if base is None else base, MESHES, sky)


def test_nothing_said_is_the_scenes_light(tmp_path: Path) -> None:
    got = load(tmp_path, HEAD)
    assert got.lights == BASE and list(got.lights) == list(BASE) and got.notes == ()
    assert got.sky is not None and got.sky.image == pytest.approx(np.array([[[0.5, 0.6, 0.7]]]))


def test_keys_are_laid_over(tmp_path: Path) -> None:
    got = load(tmp_path, HEAD + "[lights.sun]\nirradiance = [1, 0, 0]\n[lights.bulb]\nposition = [0, 0, 9]\n")
    sun, bulb = got.lights["sun"], got.lights["bulb"]
    assert sun == SUN.model_copy(update={"irradiance": (1.0, 0.0, 0.0)})
    assert isinstance(bulb, PointLight) and bulb.position == (0, 0, 9) and bulb.intensity == (5, 5, 5)
    assert bulb.tag == "input", "what the file leaves out stays"


def test_another_type_is_another_light(tmp_path: Path) -> None:
    got = load(tmp_path, HEAD + '[lights.bulb]\ntype = "directional"\ndirection = [1, 0, 0]\nirradiance = [1, 1, 1]\n')
    bulb = got.lights["bulb"]
    assert isinstance(bulb, DirectionalLight) and bulb.tag == "engine"
    with pytest.raises(InputError, match=r"new\.toml: lights\.bulb\.irradiance: missing"):
        load(tmp_path, HEAD + '[lights.bulb]\ntype = "directional"\ndirection = [1, 0, 0]\n')


def test_off_and_new(tmp_path: Path) -> None:
    lamp = '[lights.lamp]\ntype = "area"\nmesh = "wall"\nradiance = [1, 1, 1]\n'
    got = load(tmp_path, 'off = ["sky", "sun"]\n' + HEAD + lamp)
    assert list(got.lights) == ["bulb", "lamp"] and got.sky is None


def test_everything_off_is_dark(tmp_path: Path) -> None:
    got = load(tmp_path, HEAD + 'off = ["sky", "sun", "bulb"]')
    assert got == Lighting({}, None, ())


CASES = {
    "another scene": ('scene = "cornell"\n', ["scene", "'cornell'", "'house'", "take a lights file for"]),
    "no scene": ("[lights]\n", ["scene: missing"]),
    "scene is a number": ("scene = 3\n", ["scene", "string"]),
    "unknown key": (HEAD + "ligths = 3\n", ["ligths: unknown key", "did you mean 'lights'"]),
    "unknown key of a light": (HEAD + "[lights.sun]\nradiense = 3\n", ["lights.sun.radiense: unknown key"]),
    "key of another light": (HEAD + "[lights.sun]\nintensity = [1, 1, 1]\n", ["lights.sun.intensity: unknown key"]),
    "new without type": (HEAD + "[lights.new]\nradiance = [1, 1, 1]\n", ["lights.new", "type"]),
    "unknown type": (HEAD + '[lights.sun]\ntype = "suun"\n', ["lights.sun.type", "directional"]),
    "nan": (HEAD + "[lights.sun]\nirradiance = [nan, 1, 1]\n", ["lights.sun.irradiance.0", "finite"]),
    "too much": (HEAD + "[lights.sun]\nirradiance = [1e30, 1, 1]\n", ["lights.sun.irradiance", "limit"]),
    "negative": (HEAD + "[lights.bulb]\nintensity = [1, -1, 1]\n", ["lights.bulb.intensity.1"]),
    "off unknown": (HEAD + 'off = ["moon"]\n', ["off", "'moon'", "sun, bulb, sky"]),
    "off and on": (HEAD + 'off = ["sun"]\n[lights.sun]\nirradiance = [1, 1, 1]\n', ["off", "'sun'", "keep one"]),
    "off is a word": (HEAD + 'off = "sun"\n', ["off"]),
    "second sky": (HEAD + '[lights.moon]\ntype = "sky"\nradiance = [1, 1, 1]\n', ["only one sky", "sky, moon"]),
    "area on nothing": (
        HEAD + '[lights.a]\ntype = "area"\nmesh = "roof"\nradiance = [1, 1, 1]\n', ["lights.a.mesh", "'roof'", "wall"],
    ),
    "lit twice": (
        HEAD + "".join(f'[lights.{n}]\ntype = "area"\nmesh = "wall"\nradiance = [1, 1, 1]\n' for n in "ab"),
        ["lights.b.mesh", "'a'"],
    ),
    "lights is a list": (HEAD + "[[lights]]\n", ["lights"]),
    "light is a number": (HEAD + "[lights]\nsun = 3\n", ["lights.sun"]),
    "hostile name": (HEAD + '[lights."<b>"]\ntype = "sky"\nradiance = [1, 1, 1]\n', ["printable"]),
    "hostile scene": ('scene = "\\u001b[31m"\n', ["scene"]),
    "picture outside": (
        HEAD + '[lights.sky]\ntype = "image_sky"\nfile = "../a.exr"\n', ["lights.sky.file", "leaves the scene's folder"],
    ),
    "picture missing": (HEAD + '[lights.sky]\ntype = "image_sky"\nfile = "a.exr"\n', ["lights.sky.file", "no such file"]),
    "not TOML": ("scene", ["not valid TOML"]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused(tmp_path: Path, case: str) -> None:
    text, words = CASES[case]
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.isprintable()
    for word in (str(tmp_path / "new.toml"), *words):
        assert word in message, message


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        load_lights(tmp_path / "gone.toml", "house", BASE, MESHES)


def test_new_picture_comes_from_the_files_folder(tmp_path: Path) -> None:
    image = np.random.default_rng(1).random((600, 8, 3)).astype(np.float32)
    write_exr(tmp_path / "dusk.exr", image)
    got = load(tmp_path, HEAD + '[lights.sky]\ntype = "image_sky"\nfile = "dusk.exr"\nscale = 2\nrotation_deg = 30\n')
    assert got.sky is not None and got.sky.image.shape == (512, 8, 3) and got.sky.rotation_deg == 30
    assert got.sky.image.mean() == pytest.approx(2 * image.mean(), rel=1e-5)
    assert len(got.notes) == 1 and "sky averaged" in got.notes[0]


PICTURE = np.random.default_rng(2).random((4, 8, 3)).astype(np.float32)
IMAGE_BASE: dict[str, Light] = {"sky": ImageSky(type="image_sky", file="base.exr", scale=2.0, rotation_deg=10.0)}
BASE_SKY = Sky(PICTURE * np.float32(2.0), 10.0, False)


def test_the_scenes_own_picture_stays_and_can_be_turned(tmp_path: Path) -> None:
    """It does not lie in the lights file's folder, so it comes with the bake."""
    same = load(tmp_path, HEAD, IMAGE_BASE, BASE_SKY).sky
    assert same is not None and np.array_equal(same.image, BASE_SKY.image) and same.rotation_deg == 10.0
    text = HEAD + '[lights.sky]\nscale = 0.5\nrotation_deg = 90\ntag = "engine"\n'
    turned = load(tmp_path, text, IMAGE_BASE, BASE_SKY).sky
    assert turned is not None and turned.engine_lit and turned.rotation_deg == 90.0
    assert np.allclose(turned.image, 0.5 * PICTURE, rtol=1e-6)
    assert load(tmp_path, HEAD + 'off = ["sky"]', IMAGE_BASE, BASE_SKY).sky is None


def test_the_scenes_own_picture_is_not_at_hand(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lights\.sky\.file: missing"):
        load(tmp_path, HEAD, IMAGE_BASE)


def test_evening_in_the_house() -> None:
    """The example beside the scene: its sun shines in by the door and the windows, low, and nothing is brighter."""
    scene = load_scene(SCENES / "house")
    got = load_lights(
        SCENES / "house" / "evening.toml", scene.name, scene.settings.lights, scene.settings.meshes, scene.sky
    )
    day, evening = scene.settings.lights["sun"], got.lights["sun"]
    assert isinstance(day, DirectionalLight) and isinstance(evening, DirectionalLight)
    assert list(got.lights) == list(scene.settings.lights) and evening.tag == day.tag
    down = -evening.direction[1] / np.linalg.norm(evening.direction)
    assert 0.1 < down < 0.35 and evening.direction[0] < 0 and evening.direction[2] < 0
    assert evening.irradiance[0] > 2 * evening.irradiance[2], "warm"
    assert got.sky is not None and scene.sky is not None and np.all(got.sky.image < 0.4 * scene.sky.image)
    assert got.sky.image[0, 0, 2] > 2 * got.sky.image[0, 0, 0], "blue"
    with pytest.raises(InputError, match=r"'house'.*'valley'"):
        load_lights(SCENES / "house" / "evening.toml", "valley", {}, ())
