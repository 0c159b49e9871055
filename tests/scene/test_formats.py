"""Known numbers through each format, and what the loaders add, clamp and say."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from lightgauge.reference.config import scene_json_schema
from lightgauge.reference.scene import load_scene
from scene_files import SQUARE, TOML, gltf_tree, ply_text, write_glb, write_picture, write_toml


def said(notes: tuple[str, ...], *words: str) -> bool:
    return any(all(w in note for w in words) for note in notes)


def test_toml(tmp_path: Path) -> None:
    scene = load_scene(write_toml(tmp_path))
    mesh = scene.meshes[0]
    assert scene.name == tmp_path.name
    assert np.array_equal(mesh.vertices, SQUARE)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert (mesh.static, mesh.lit_by_probes, mesh.engine_lit, mesh.closed) == (True, True, False, False)
    assert scene.materials[mesh.material].albedo.tolist() == [0.5, 0.4, 0.3]
    assert scene.sky is not None and scene.sky.image.tolist() == [[[1.0, 1.0, 1.0]]]
    assert scene.notes == ()


def test_folder_stands_for_its_scene(tmp_path: Path) -> None:
    assert load_scene(write_toml(tmp_path)).content_hash == load_scene(tmp_path).content_hash


def test_minimal_scene_fits_the_schema() -> None:
    import tomllib

    schema = scene_json_schema()
    jsonschema.validate(tomllib.loads(TOML), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads("radiense = 1\n" + TOML), schema)


def test_overrides(tmp_path: Path) -> None:
    path = write_toml(tmp_path)
    over = {"lights": {"sun": {"direction": [1, 0, 0]}}, "unit_m": 2.0, "radiosity": {"rays": 64}}
    scene = load_scene(path, over)
    sun = scene.settings.lights["sun"]
    assert sun.type == "directional" and sun.direction == (1, 0, 0) and sun.irradiance == (2, 2, 2)
    assert scene.settings.radiosity.rays == 64
    assert scene.meshes[0].vertices.max() == 2.0  # unit_m scales vertices
    assert scene.content_hash != load_scene(path).content_hash


def test_area_light_and_emission(tmp_path: Path) -> None:
    area = '[lights.a]\ntype = "area"\nmesh = "wall"\nradiance = [1, 2, 3]\n'
    mesh = load_scene(write_toml(tmp_path, TOML + area)).meshes[0]
    assert mesh.emission.tolist() == [1, 2, 3] and mesh.engine_lit
    mesh = load_scene(write_toml(tmp_path, TOML + area + 'tag = "input"\n')).meshes[0]
    assert mesh.emission.tolist() == [1, 2, 3] and not mesh.engine_lit
    mesh = load_scene(write_toml(tmp_path, TOML.replace("albedo", "emission = [4, 5, 6]\nalbedo"))).meshes[0]
    assert mesh.emission.tolist() == [4, 5, 6] and not mesh.engine_lit


def test_texture_is_linear_and_clamped(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", [[[255, 0, 128], [255, 0, 128]]])
    text = TOML.replace("albedo", 'texture = "a.png"\nalbedo')
    rows = [(*p, p[0], p[1]) for p in SQUARE]
    scene = load_scene(write_toml(tmp_path, text, ply_text(rows, [(0, 1, 2, 3)], uvs=True)))
    texture = scene.materials[0].texture
    assert texture is not None and texture.shape == (1, 2, 3)
    assert texture[0, 0] == pytest.approx([0.95, 0.0, 0.2158605], abs=1e-6)
    assert scene.materials[0].albedo == pytest.approx([0.95, 0.0, 0.2158605], abs=1e-6)
    assert said(scene.notes, "clamped to 0.95", "a.png")
    uvs = scene.meshes[0].uvs
    assert uvs is not None and uvs.tolist() == [[p[0], p[1]] for p in SQUARE]


def test_content_hash_sees_arrays(tmp_path: Path) -> None:
    one = load_scene(write_toml(tmp_path)).content_hash
    moved = ply_text([(0.0, 0.0, 1e-6), *SQUARE[1:]], [(0, 1, 2, 3)])
    assert load_scene(write_toml(tmp_path, ply=moved)).content_hash != one
    assert load_scene(write_toml(tmp_path)).content_hash == one


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("mixed", [False, True])
def test_binary_ply(tmp_path: Path, order: str, mixed: bool) -> None:
    """Little and big endian; polygons of equal length and of mixed length take different ways through the reader."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"ply\nformat {name} 1.0\ncomment x\nelement vertex 4\nproperty double x\nproperty double y\n"
    head += "property double z\nproperty uchar red\nelement face 2\nproperty list uchar uint vertex_index\nend_header\n"
    data = head.encode() + b"".join(struct.pack(f"{order}3dB", *p, 7) for p in SQUARE)
    polygons = [(0, 2, 3), (0, 1, 2, 3)] if mixed else [(0, 1, 2), (0, 2, 3)]
    data += b"".join(struct.pack(f"{order}B{len(p)}I", len(p), *p) for p in polygons)
    (tmp_path / "a.ply").write_bytes(data)
    mesh = load_scene(tmp_path / "a.ply").meshes[0]
    assert np.array_equal(mesh.vertices, SQUARE)
    assert mesh.faces.tolist() == ([[0, 2, 3], [0, 1, 2]] if mixed else [[0, 1, 2], [0, 2, 3]])  # once each


def test_mesh_only_gets_light_and_camera(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(ply_text(SQUARE, [(0, 1, 2, 3)]))
    scene = load_scene(tmp_path / "a.ply", {"lights": {"sun": {"direction": [0, -1, 0]}}})
    assert set(scene.settings.lights) == {"sun", "sky"} and set(scene.settings.cameras) == {"view"}
    assert said(scene.notes, "`sun`", "`sky`") and said(scene.notes, "`view`")
    assert scene.materials[0].two_sided
    camera = scene.settings.cameras["view"]
    assert np.allclose(camera.target, [0.5, 0.5, 0.0])
    assert np.linalg.norm(np.subtract(camera.origin, camera.target)) > np.sqrt(0.5)


def test_added_camera_follows_the_unit(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(ply_text(SQUARE, [(0, 1, 2, 3)]))
    camera = load_scene(tmp_path / "a.ply", {"unit_m": 10.0}).settings.cameras["view"]
    assert np.allclose(camera.target, [5.0, 5.0, 0.0])


OBJ = """mtllib my lib.mtl
v 0 0 0
v 1 0 0 \\
  1.0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0 0
vt 1 1
vn 0 0 1
usemtl red paint
f -4/1/1 -3/2/1 -2/3/1 -1//1
usemtl lamp
f 1 2 3 # comment
usemtl glass
f 1//1 3//1 4//1
"""
MTL = """newmtl red paint
Kd 1 0.5 0.25
map_Kd -s 2 2 2 -o 0 pic ture.png
newmtl lamp
Kd 0.1 0.1 0.1
Ke 3 2 1
newmtl glass
d 0.2
newmtl unused
map_Kd gone.png
"""


def test_obj_with_materials(tmp_path: Path) -> None:
    (tmp_path / "my lib.mtl").write_text(MTL)
    (tmp_path / "a.obj").write_text(OBJ)
    write_picture(tmp_path / "pic ture.png", [[[0, 0, 0]]])
    scene = load_scene(tmp_path / "a.obj")
    meshes = {m.name: m for m in scene.meshes}
    materials = {m.name: m for m in scene.materials}
    assert set(meshes) == {"red paint", "lamp", "glass"}
    paint = meshes["red paint"]
    assert paint.faces.tolist() == [[0, 1, 2], [0, 2, 3]] and np.array_equal(paint.vertices, SQUARE)
    assert paint.uvs is not None and paint.uvs.tolist() == [[0, 0], [1, 0], [1, 1], [0, 0]]
    assert materials["red paint"].texture is not None
    assert meshes["lamp"].emission.tolist() == [3, 2, 1]
    assert materials["glass"].passes_light and materials["glass"].truth_bsdf is not None
    assert all(m.two_sided for m in scene.materials) and said(scene.notes, "both")


def test_gltf(tmp_path: Path) -> None:
    scene = load_scene(write_glb(tmp_path, *gltf_tree()))
    mesh, material = scene.meshes[0], scene.materials[0]
    assert mesh.name == "square" and material.name == "paint" and material.two_sided
    assert np.allclose(mesh.vertices, np.array(SQUARE) * 2 + [0, 0, 5])
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.uvs is not None and np.allclose(mesh.uvs, [[p[0], 1 - p[1]] for p in SQUARE])
    assert mesh.emission.tolist() == [4, 0, 0]
    linear = 0.2158605
    assert material.texture is not None and np.allclose(material.texture[0, 0], [linear, linear / 2, linear], atol=1e-6)
    assert material.truth_bsdf == {
        "type": "principled", "base_color": "@texture", "metallic": 0.5, "roughness": 0.3,
    }  # fmt: skip
    lamp = scene.settings.lights["lamp"]
    assert lamp.type == "spot" and lamp.position == (0, 3, 0) and lamp.direction == (0, 0, -1)
    assert lamp.intensity == (50, 25, 0) and lamp.cutoff_deg == pytest.approx(np.degrees(0.5))
    eye = scene.settings.cameras["eye"]
    assert eye.origin == (0, 0, 9) and eye.target == (0, 0, 8) and (eye.width, eye.height) == (256, 128)
    assert eye.fov_deg == pytest.approx(np.degrees(2 * np.arctan(2 * np.tan(0.5))))
    assert said(scene.notes, "candela") and scene.sky is None


def test_gltf_as_json_with_files(tmp_path: Path) -> None:
    tree, blob = gltf_tree(buffers=[{"byteLength": len(gltf_tree()[1]), "uri": "a%20b.bin"}])
    (tmp_path / "a b.bin").write_bytes(blob)
    (tmp_path / "scene.gltf").write_text(json.dumps(tree))
    scene, glb = load_scene(tmp_path / "scene.gltf"), load_scene(write_glb(tmp_path, *gltf_tree()))
    assert scene.content_hash == glb.content_hash


def test_gltf_mirrored_node_keeps_its_front(tmp_path: Path) -> None:
    tree, blob = gltf_tree()
    tree["nodes"][0]["scale"] = [-1, 1, 1]
    mesh = load_scene(write_glb(tmp_path, tree, blob)).meshes[0]
    p = mesh.vertices[mesh.faces]
    assert (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] > 0).all()


@pytest.mark.parametrize(
    ("mode", "alpha", "passes"), [("MASK", 0.3, False), ("BLEND", 0.3, True), ("BLEND", 0.9, False)]
)
def test_gltf_alpha(tmp_path: Path, mode: str, alpha: float, passes: bool) -> None:
    tree, blob = gltf_tree()
    pbr = {"baseColorFactor": [0.5, 0.5, 0.5, alpha], "metallicFactor": 0}
    tree["materials"] = [{"alphaMode": mode, "emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": pbr}, {}]
    wall = {"attributes": {"POSITION": 0}, "indices": 2, "material": 1}
    tree["meshes"][0]["primitives"].append(wall)  # a scene of glass alone is refused
    material = load_scene(write_glb(tmp_path, tree, blob)).materials[0]
    assert material.opacity is not None and material.truth_bsdf is not None
    expected = 0.0 if mode == "MASK" else alpha
    assert material.opacity.max() == pytest.approx(expected) and material.passes_light == passes
    assert material.truth_bsdf["opacity"] == pytest.approx(expected)


def test_overridden_reflectance_holds_in_the_truth_too(tmp_path: Path) -> None:
    path = write_glb(tmp_path, *gltf_tree())
    scene = load_scene(path, {"materials": {"paint": {"albedo": [0.1, 0.1, 0.1]}}})
    assert scene.materials[0].truth_bsdf is None and said(scene.notes, "overridden")


def test_scene_is_frozen(tmp_path: Path) -> None:
    scene = load_scene(write_toml(tmp_path))
    assert replace(scene, name="x").name == "x"
    with pytest.raises(AttributeError):
        scene.name = "y"  # type: ignore[misc]
