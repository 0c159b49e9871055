"""What is refused at the door, through the command line: exit code 2, and a message with file, key and way out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.primitives import cube
from lightgauge.validation.cli import main
from scene_files import SQUARE, TOML, gltf_tree, ply_of, ply_text, write_glb, write_picture, write_toml

BOX = cube()
POINT = '[lights.bulb]\ntype = "point"\nposition = [{}]\nintensity = [1, 1, 1]\n'
FLAT = [(0, 0, 0), (1, 1, 1), (2, 2, 2)]
SOLID = ply_of(BOX.vertices, BOX.faces)

CASES: dict[str, tuple[str, str | None, list[str]]] = {
    "mesh without area": (TOML, ply_text(FLAT, [(0, 1, 2)]), ["meshes.wall (wall.ply)", "no area", "repair or remove"]),
    "mesh without faces": (TOML, ply_text(SQUARE, []), ["meshes.wall", "empty", "remove"]),
    "no surfaces": ('[materials.grey]\n[meshes]\n[lights.s]\ntype="sky"\nradiance=[1,1,1]', None, ["meshes", "add a"]),
    "albedo 1": (TOML.replace("0.5, 0.4", "1.0, 0.4"), None, ["materials.grey.albedo.0", "less than 1"]),
    "albedo under 0": (TOML.replace("0.5, 0.4", "0.5, -0.1"), None, ["materials.grey.albedo.1", "-0.1"]),
    "light nan": (TOML.replace("[2, 2, 2]", "[nan, 2, 2]"), None, ["lights.sun.irradiance.0", "finite"]),
    "light infinite": (TOML.replace("[1, 1, 1]", "[1, 1, inf]"), None, ["lights.sky.radiance.2", "finite"]),
    "light over single precision": (
        TOML.replace("[2, 2, 2]", "[1e39, 2, 2]"), None, ["lights.sun.irradiance", "1e+39", "limit", "unit"],
    ),
    "emission nan": (TOML.replace("albedo", "emission = [nan, 0, 0]\nalbedo"), None, ["materials.grey.emission.0"]),
    "emission over the limit": (
        TOML.replace("albedo", "emission = [0, 1e20, 0]\nalbedo"), None, ["materials.grey.emission", "1e+20"],
    ),
    "sky over the limit": (TOML.replace("[1, 1, 1]", "[1, 1, 1e13]"), None, ["lights.sky.radiance", "limit"]),
    "light inside a wall": (TOML + POINT.format("0.2, 0.3, -0.1"), SOLID, ["lights.bulb.position", "0.3", "'wall'", "move"]),
    "light on a wall": (TOML + POINT.format("0.2, 1, -0.1"), SOLID, ["lights.bulb.position", "lies on", "'wall'", "move"]),
    "half a front": (TOML, ply_text(SQUARE, [(0, 1, 2), (3, 2, 0)]), ["meshes.wall", "triangles 0, 1", "two_sided"]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_command_line(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    text, ply, words = CASES[case]
    path = write_toml(tmp_path, text, ply)
    code = main(["run", str(path), "--out", str(tmp_path / "out"), "--quiet"])
    shown = capsys.readouterr()
    assert code == 2 and shown.out == "" and not (tmp_path / "out").exists()
    message = shown.err.strip()
    assert message.startswith("lightgauge: error: ") and "\n" not in message
    for word in (str(path), *words):
        assert word in message, message


def test_good_scenes_pass(tmp_path: Path) -> None:
    """The same files without their fault, so that it is the fault which is refused."""
    scene = load_scene(write_toml(tmp_path, TOML + POINT.format("0.2, 1.1, -0.1"), SOLID))
    assert scene.meshes[0].closed and not any("meshes.wall" in note for note in scene.notes)


def test_brightest_light_that_is_taken(tmp_path: Path) -> None:
    scene = load_scene(write_toml(tmp_path, TOML.replace("[1, 1, 1]", "[1, 1, 1e12]")))
    assert scene.sky is not None and np.isfinite(scene.sky.image).all()


def test_glass_alone(tmp_path: Path) -> None:
    """Every static mesh lets light pass: nothing reflects."""
    tree, blob = gltf_tree()
    tree["materials"] = [{"name": "pane", "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}}]
    path = write_glb(tmp_path, tree, blob)
    with pytest.raises(
        InputError, match=r"scene\.glb: meshes: no static mesh is opaque \(square let light pass\); add"
    ):
        load_scene(path)


def test_white_textures_are_clamped_and_said(tmp_path: Path) -> None:
    """Pictures of 255 are common in real files, unlike an albedo of 1 that somebody typed."""
    write_picture(tmp_path / "a.png", np.full((2, 2, 3), 255))
    rows = [(*p, p[0], p[1]) for p in SQUARE]
    text = TOML.replace("albedo", 'texture = "a.png"\nalbedo')
    scene = load_scene(write_toml(tmp_path, text, ply_text(rows, [(0, 1, 2, 3)], uvs=True)))
    assert scene.materials[0].albedo.max() == pytest.approx(0.95)
    assert any("materials.grey.texture: a.png: albedo up to 1.000 clamped to 0.95" in note for note in scene.notes)


def sky_picture(tmp_path: Path, scale: str) -> Path:
    write_picture(tmp_path / "sky.png", np.full((2, 4, 3), 128))
    sky = f'type = "image_sky"\nfile = "sky.png"\nscale = {scale}'
    return write_toml(tmp_path, TOML.replace('type = "sky"\nradiance = [1, 1, 1]', sky))


@pytest.mark.parametrize(("scale", "words"), [("1e13", "lights.sky.scale"), ("nan", "lights.sky.scale")])
def test_sky_scale(tmp_path: Path, scale: str, words: str) -> None:
    assert load_scene(sky_picture(tmp_path, "1.0")).sky is not None
    with pytest.raises(InputError, match=words):
        load_scene(sky_picture(tmp_path, scale))


@pytest.mark.parametrize("radiance", [[1, 1, 1], [0, 0, 0]])
def test_black_pictures_are_no_light(tmp_path: Path, radiance: Any) -> None:
    """A black sky and black emission pictures shine as little as no light at all."""
    write_picture(tmp_path / "glow.png", np.zeros((2, 2, 3)))
    text = TOML[: TOML.index("[lights.sky]")].replace(
        "albedo", 'emission = [1, 1, 1]\nemission_texture = "glow.png"\nalbedo'
    )
    rows = [(*p, p[0], p[1]) for p in SQUARE]
    ply = ply_text(rows, [(0, 1, 2, 3)], uvs=True)
    path = write_toml(tmp_path, text + f'[lights.sky]\ntype = "sky"\nradiance = {radiance}\n', ply)
    if any(radiance):
        assert load_scene(path).materials[0].emission_texture is not None
    else:
        with pytest.raises(InputError, match="no light and no emission"):
            load_scene(path)
