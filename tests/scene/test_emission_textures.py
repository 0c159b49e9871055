"""Emission pictures from every format: the factor stays on the mesh, the picture on the material, and both are linear."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from scene_files import SQUARE, TOML, gltf_tree, ply_text, write_exr, write_glb, write_picture, write_toml, write_xml

MID = 0.2158605  # linear light of 128
UV_ROWS = [(*p, p[0], p[1]) for p in SQUARE]
WITH_UVS = ply_text(UV_ROWS, [(0, 1, 2, 3)], uvs=True)
GLOWING = TOML.replace("albedo", 'emission = [2, 4, 8]\nemission_texture = "glow.png"\nalbedo')


def glow(folder: Path) -> None:
    """Two columns: mid grey and black red, row 0 white."""
    write_picture(folder / "glow.png", [[[255, 255, 255]] * 2, [[128, 128, 128], [128, 0, 0]]])


def test_toml(tmp_path: Path) -> None:
    glow(tmp_path)
    scene = load_scene(write_toml(tmp_path, GLOWING, WITH_UVS))
    mesh, material = scene.meshes[0], scene.materials[0]
    assert mesh.emission.tolist() == [2, 4, 8] and not mesh.engine_lit and mesh.uvs is not None
    assert material.emission_texture is not None and material.emission_texture.dtype == np.float32
    assert np.allclose(material.emission_texture, [[[1, 1, 1], [1, 1, 1]], [[MID] * 3, [MID, 0, 0]]], atol=1e-6)
    assert material.texture is None


def test_emission_may_exceed_one(tmp_path: Path) -> None:
    """High dynamic range is neither clamped nor shrunk in sum."""
    image = np.random.default_rng(1).random((8, 8, 3)).astype(np.float32) * 100
    write_exr(tmp_path / "glow.exr", image)
    scene = load_scene(write_toml(tmp_path, GLOWING.replace("glow.png", "glow.exr"), WITH_UVS))
    assert np.array_equal(scene.materials[0].emission_texture, image)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_broken_pictures(tmp_path: Path, value: float) -> None:
    image = np.ones((2, 2, 3), np.float32)
    image[1, 1, 1] = value
    write_exr(tmp_path / "glow.exr", image)
    with pytest.raises(InputError, match=r"materials\.grey\.emission_texture: glow\.exr"):
        load_scene(write_toml(tmp_path, GLOWING.replace("glow.png", "glow.exr"), WITH_UVS))


def test_over_the_limit(tmp_path: Path) -> None:
    write_exr(tmp_path / "glow.exr", np.full((2, 2, 3), 1e12, np.float32))
    with pytest.raises(InputError, match=r"materials\.grey: emits up to 8e\+12"):
        load_scene(write_toml(tmp_path, GLOWING.replace("glow.png", "glow.exr"), WITH_UVS))


def test_missing_and_outside(tmp_path: Path) -> None:
    for name, words in (("gone.png", "no such file"), ("../glow.png", "leaves the scene's folder")):
        path = write_toml(tmp_path, GLOWING.replace("glow.png", name), WITH_UVS)
        with pytest.raises(InputError, match=rf"materials\.grey\.emission_texture: .*{words}"):
            load_scene(path)


def test_factor_zero_turns_it_off(tmp_path: Path) -> None:
    glow(tmp_path)
    path = write_toml(tmp_path, GLOWING, WITH_UVS)
    scene = load_scene(path, {"materials": {"grey": {"emission": [0, 0, 0]}}})
    assert scene.materials[0].emission_texture is None and not scene.meshes[0].emission.any()
    assert any("glow.png: emission is 0" in note for note in scene.notes)


def test_area_lights_have_no_picture(tmp_path: Path) -> None:
    """With the factor off an area light may stand on the mesh; with both, one has to go."""
    glow(tmp_path)
    light = '[lights.a]\ntype = "area"\nmesh = "wall"\nradiance = [1, 2, 3]\n'
    with pytest.raises(InputError, match="emits too"):
        load_scene(write_toml(tmp_path, GLOWING + light, WITH_UVS))
    scene = load_scene(write_toml(tmp_path, GLOWING.replace("[2, 4, 8]", "[0, 0, 0]") + light, WITH_UVS))
    assert scene.materials[0].emission_texture is None and scene.meshes[0].emission.tolist() == [1, 2, 3]


def test_toml_mesh_without_coordinates(tmp_path: Path) -> None:
    glow(tmp_path)
    with pytest.raises(InputError, match=r"meshes\.wall: material 'grey' has a texture, the mesh no texture coord"):
        load_scene(write_toml(tmp_path, GLOWING))


def test_content_hash_sees_the_picture(tmp_path: Path) -> None:
    glow(tmp_path)
    path = write_toml(tmp_path, GLOWING, WITH_UVS)
    before = load_scene(path).content_hash
    write_picture(tmp_path / "glow.png", [[[255, 255, 254]] * 2, [[128, 128, 128], [128, 0, 0]]])
    assert load_scene(path).content_hash != before


def gltf(folder: Path, **material: Any) -> Path:
    tree, blob = gltf_tree()
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 4}}
    tree["materials"] = [{"name": "paint", "extensions": strength, **material}]
    return write_glb(folder, tree, blob)


def test_gltf(tmp_path: Path) -> None:
    scene = load_scene(gltf(tmp_path, emissiveFactor=[1, 0.5, 0], emissiveTexture={"index": 0}))
    picture = scene.materials[0].emission_texture
    assert scene.meshes[0].emission.tolist() == [4, 2, 0] and picture is not None
    assert np.allclose(picture, MID, atol=1e-6) and picture.shape == (2, 2, 3)


def test_gltf_factor_is_black_unless_given(tmp_path: Path) -> None:
    scene = load_scene(gltf(tmp_path, emissiveTexture={"index": 0}))
    assert scene.materials[0].emission_texture is None and not scene.meshes[0].emission.any()


MTL = "newmtl a\nKd 0.5 0.5 0.5\nmap_Ke -s 1 1 1 glow.png\n{}"
OBJ = "mtllib m.mtl\nusemtl a\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in SQUARE)
OBJ_UV = OBJ + "".join(f"vt {x} {y}\n" for x, y, _ in SQUARE) + "f 1/1 2/2 3/3 4/4\n"


@pytest.mark.parametrize(("ke", "factor"), [("", [1, 1, 1]), ("Ke 3 2 1\n", [3, 2, 1])])
def test_mtl(tmp_path: Path, ke: str, factor: list[float]) -> None:
    glow(tmp_path)
    (tmp_path / "m.mtl").write_text(MTL.format(ke))
    (tmp_path / "a.obj").write_text(OBJ_UV)
    scene = load_scene(tmp_path / "a.obj")
    assert scene.meshes[0].emission.tolist() == factor
    picture = scene.materials[0].emission_texture
    assert picture is not None and picture[1, 0] == pytest.approx(MID, abs=1e-6)


def test_mtl_mesh_without_coordinates_glows_as_the_mean(tmp_path: Path) -> None:
    glow(tmp_path)
    (tmp_path / "m.mtl").write_text(MTL.format("Ke 3 2 1\n"))
    (tmp_path / "a.obj").write_text(OBJ + "f 1 2 3 4\n")
    scene = load_scene(tmp_path / "a.obj")
    mesh = scene.meshes[0]
    material = scene.materials[mesh.material]
    assert material.emission_texture is None and material.name == "a (plain)"
    mean = np.array([2 + 2 * MID, 2 + MID, 2 + MID]) / 4
    assert mesh.emission == pytest.approx(np.array([3, 2, 1]) * mean, rel=1e-6)


def bitmap(name: str, file: str, extra: str = "") -> str:
    return f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{extra}</texture>'


def xml_lamp(folder: Path, radiance: str, bsdf: str = "") -> Path:
    glow(folder)
    write_picture(folder / "wall.png", np.full((2, 2, 3), 128))
    emitter = f'<emitter type="area">{radiance}</emitter>'
    bodies = f'<bsdf type="diffuse" id="grey">{bitmap("reflectance", "wall.png")}</bsdf>'
    bodies += '<shape type="rectangle" id="wall"><ref id="grey"/></shape>'
    bodies += f'<shape type="rectangle" id="lamp">{bsdf}{emitter}</shape>'
    return write_xml(folder, bodies)


def test_xml(tmp_path: Path) -> None:
    """The lamp gets a material of its own; what shares its bsdf does not glow."""
    scene = load_scene(xml_lamp(tmp_path, bitmap("radiance", "glow.png"), '<ref id="grey"/>'))
    meshes = {m.name: m for m in scene.meshes}
    lamp, wall = (scene.materials[meshes[name].material] for name in ("lamp", "wall"))
    assert lamp.emission_texture is not None and lamp.emission_texture[1, 1, 0] == pytest.approx(MID, abs=1e-6)
    assert wall.emission_texture is None and lamp.texture is not None and wall.texture is not None
    assert meshes["lamp"].emission.tolist() == [1, 1, 1] and not meshes["lamp"].engine_lit
    assert not meshes["wall"].emission.any() and "lamp" not in scene.settings.lights
    assert any("input to the radiosity" in note for note in scene.notes)


def test_xml_raw_bitmap_on_a_shape_without_bsdf(tmp_path: Path) -> None:
    scene = load_scene(xml_lamp(tmp_path, bitmap("radiance", "glow.png", '<boolean name="raw" value="true"/>')))
    lamp = scene.materials[next(m for m in scene.meshes if m.name == "lamp").material]
    assert lamp.emission_texture is not None
    assert lamp.emission_texture[1, 1, 0] == pytest.approx(128 / 255)


def test_xml_transform_of_the_picture(tmp_path: Path) -> None:
    """It moves the mesh's coordinates; where the reflectance has another one, that cannot be."""
    to_uv = '<transform name="to_uv"><scale x="3"/></transform>'
    scene = load_scene(xml_lamp(tmp_path, bitmap("radiance", "glow.png", to_uv)))
    uvs = next(m for m in scene.meshes if m.name == "lamp").uvs
    assert uvs is not None and uvs[:, 0].max() == 3.0
    with pytest.raises(InputError, match=r'mesh lamp: <emitter type="area">: its to_uv differs'):
        load_scene(xml_lamp(tmp_path, bitmap("radiance", "glow.png", to_uv), '<ref id="grey"/>'))


def test_xml_checkerboard_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a bitmap"):
        load_scene(xml_lamp(tmp_path, '<texture type="checkerboard" name="radiance"/>'))
