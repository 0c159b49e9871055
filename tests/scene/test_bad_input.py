"""Bad input: one message of one line that names the file, the element and the way out, and nothing but InputError."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from scene_files import SQUARE, TOML, gltf_tree, ply_text, write_glb, write_picture, write_toml, write_xml


def refused(path: Path, *words: str, overrides: dict[str, Any] | None = None) -> str:
    """The message, which must name the file and all `words` and stay on one line."""
    with pytest.raises(InputError) as caught:
        load_scene(path, overrides)
    message = str(caught.value)
    for word in (path.name if path.suffix else "scene.toml", *words):
        assert word in message, message
    assert message.isprintable(), message
    return message


TOML_CASES = {
    "unknown key": (TOML + "radiense = 3\n", ["lights.sun.radiense", "unknown key"]),
    "unknown table": ("[camras.a]\n" + TOML, ["camras", "did you mean 'cameras'"]),
    "unknown light": (TOML.replace('"sky"', '"skyy"'), ["lights.sky.type", "image_sky"]),
    "light without type": (TOML.replace('type = "sky"', ""), ["lights.sky", "type"]),
    "wrong value": (TOML.replace("[1, 1, 1]", '["a", 1, 1]'), ["lights.sky.radiance.0", "number"]),
    "text for a number": (TOML.replace("[1, 1, 1]", '["1", 1, 1]'), ["lights.sky.radiance.0"]),
    "nan": (TOML.replace("[2, 2, 2]", "[nan, 2, 2]"), ["lights.sun.irradiance.0"]),
    "infinity": (TOML.replace("[2, 2, 2]", "[inf, 2, 2]"), ["lights.sun.irradiance.0"]),
    "albedo 1": (TOML.replace("0.5, 0.4, 0.3", "1.0, 0.4, 0.3"), ["materials.grey.albedo.0"]),
    "negative light": (TOML.replace("[2, 2, 2]", "[-2, 2, 2]"), ["lights.sun.irradiance.0"]),
    "no material": (TOML.replace('material = "grey"', 'material = "gray"'), ["meshes.wall.material", "gray", "grey"]),
    "no meshes": ('[materials.grey]\n[meshes]\n[lights.s]\ntype="sky"\nradiance=[1,1,1]', ["meshes", "empty"]),
    "all moving": (TOML.replace('file = "wall', 'role = "moving"\nfile = "wall'), ["meshes", "moving"]),
    "no light": (TOML[: TOML.index("[lights.sky]")], ["lights", "no light"]),
    "black light": (TOML.replace("[1, 1, 1]", "[0, 0, 0]").replace("[2, 2, 2]", "[0, 0, 0]"), ["no light"]),
    "two skies": (TOML + '[lights.b]\ntype = "sky"\nradiance = [1, 1, 1]\n', ["only one sky", "sky, b"]),
    "area on nothing": (TOML + '[lights.a]\ntype = "area"\nmesh = "w"\nradiance = [1,1,1]\n', ["lights.a.mesh", "'w'"]),
    "lit twice": (
        TOML + "".join(f'[lights.{n}]\ntype = "area"\nmesh = "wall"\nradiance = [1,1,1]\n' for n in "ab"),
        ["lights.b.mesh", "'a'"],
    ),
    "emits and is lit": (
        TOML.replace("albedo", "emission = [1,0,0]\nalbedo")
        + '[lights.a]\ntype = "area"\nmesh = "wall"\nradiance = [1,1,1]\n',
        ["lights.a.mesh", "grey", "emission"],
    ),
    "missing mesh file": (TOML.replace("wall.ply", "gone.ply"), ["meshes.wall.file", "gone.ply", "no such file"]),
    "no file at all": (TOML.replace('file = "wall.ply"', ""), ["meshes.wall.file", "missing"]),
    "missing texture": (TOML.replace("albedo", 'texture = "a.png"\nalbedo'), ["materials.grey.texture", "a.png"]),
    "missing sky": (TOML + '[lights.i]\ntype = "image_sky"\nfile = "a.exr"\n', ["only one sky"]),
    "wrong kind of file": (TOML.replace("wall.ply", "scene.toml"), ["meshes.wall.file", ".obj"]),
    "broken TOML": ("[materials", ["not valid TOML"]),
    "not text": ("\udcff", ["not valid TOML"]),
    "hostile name": (TOML.replace("meshes.wall", 'meshes."<script>"'), ["meshes", "printable"]),
    "escape in name": (TOML.replace("meshes.wall", 'meshes."\\u001b[31m"'), ["meshes", "printable"]),
    "table for a list": (TOML.replace("[lights.sun]", "[[lights.sun]]"), ["lights.sun"]),
}


@pytest.mark.parametrize("case", TOML_CASES)
def test_toml(tmp_path: Path, case: str) -> None:
    text, words = TOML_CASES[case]
    path = write_toml(tmp_path, "")
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    refused(path, *words)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"lights": {"sum": {"direction": [0, -1, 0]}}}, ["lights.sum", "no such light"]),
        ({"lights": {"sun": {"direktion": [0, -1, 0]}}}, ["lights.sun.direktion", "did you mean 'direction'"]),
        ({"lights": {"sun": {"direction": [0, 0, 0]}}}, ["lights.sun", "zero length"]),
        ({"placement": {"rays": "many"}}, ["placement.rays", "integer", '"many"']),
        ({"unit_m": 0}, ["unit_m"]),
        ({"materials": {"new": {}}, "meshes": {"wall": {"material": "newer"}}}, ["meshes.wall.material", "newer"]),
    ],
)
def test_override(tmp_path: Path, overrides: dict[str, Any], words: list[str]) -> None:
    refused(write_toml(tmp_path), *words, overrides=overrides)


PLY = ply_text(SQUARE, [(0, 1, 2, 3)])
MESH_CASES = {
    "nan": (ply_text([(0, 0, "nan"), *SQUARE[1:]], [(0, 1, 2)]), ["vertex 0", "not finite"]),
    "infinity": (ply_text([(0, 0, "inf"), *SQUARE[1:]], [(0, 1, 2)]), ["vertex 0", "not finite"]),
    "index past the end": (ply_text(SQUARE, [(0, 1, 2), (0, 1, 4)]), ["face 1", "out of range", "4 vertices"]),
    "negative index": (ply_text(SQUARE, [(0, 1, -1)]), ["face 0", "out of range"]),
    "index over 32 bits": (ply_text(SQUARE, [(0, 1, 2**32)]), ["face 0", "out of range"]),
    "two corners": (ply_text(SQUARE, [(0, 1)]), ["face 0", "2 corners"]),
    "too few vertices": (PLY.replace("vertex 4", "vertex 9"), ["vertex", "corners"][:1]),
    "too few faces": (PLY.replace("face 1", "face 7"), ["7 rows of 'face'"]),
    "rows left over": (PLY + "3 0 1 2\n", ["left"]),
    "huge count": (PLY.replace("face 1", "face 99999999999"), ["rows"]),
    "no faces": (ply_text(SQUARE, []), ["empty"]),
    "no vertices": (ply_text([], []), ["empty"]),
    "no area": (ply_text([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [(0, 1, 2)]), ["no area"]),
    "far away": (ply_text([(0, 0, 1e12), *SQUARE[1:]], [(0, 1, 2)]), ["vertex 0", "unit_m"]),
    "not a ply": ("obj", ["not a PLY"]),
    "no format": ("ply\nend_header\n", ["format"]),
    "no x": (PLY.replace("property float x", "property float q"), ["'x'"]),
    "letters": (PLY.replace("0.0 0.0 0.0", "a b c"), ["vertex 0"]),
}


@pytest.mark.parametrize("case", MESH_CASES)
def test_mesh(tmp_path: Path, case: str) -> None:
    text, words = MESH_CASES[case]
    refused(write_toml(tmp_path, ply=text), "meshes.wall", *words)


@pytest.mark.parametrize("cut", [1, 5, 13, -4])
def test_binary_ply_of_wrong_length(tmp_path: Path, cut: int) -> None:
    head = ply_text(SQUARE, [(0, 1, 2)]).split("end_header")[0].replace("ascii", "binary_little_endian")
    data = head.encode() + b"end_header\n" + np.array(SQUARE, "<f4").tobytes() + struct.pack("<B3i", 3, 0, 1, 2)
    path = write_toml(tmp_path)
    (tmp_path / "wall.ply").write_bytes(data)
    assert len(load_scene(path).meshes[0].faces) == 1
    (tmp_path / "wall.ply").write_bytes(data[:-cut] if cut > 0 else data + b"\0" * -cut)
    refused(path, "meshes.wall", "wall.ply", "export it again")


V = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OBJ_CASES = {
    "index past the end": (V + "f 1 2 4\n", ["face 1", "index 4", "has 3"]),
    "index zero": (V + "f 0 1 2\n", ["face 1", "index 0"]),
    "negative index too far": (V + "f -1 -2 -4\n", ["face 1", "index -4"]),
    "texture index": (V + "vt 0 0\nf 1/1 2/1 3/2\n", ["face 1", "texture coordinate index 2"]),
    "words": (V + "f a b c\n", ["face corner"]),
    "three slashes": (V + "vt 0 0\nvn 0 0 1\nf 1/1/1/1 2/1 3/1/1\n", ["face corner", "slashes"]),
    "huge index": (V + "f 1 2 99999999999999999999999\n", ["face corner"]),
    "two corners": (V + "f 1 2\n", ["face 1", "2 corners"]),
    "short vertex": ("v 0 0\n" + V + "f 1 2 3\n", ["vertex 1"]),
    "nan": (V + "v nan 0 0\nf 1 2 4\n", ["vertex 2", "not finite"]),
    "empty": ("# nothing\n", ["empty"]),
    "no mtl": ("mtllib gone.mtl\n" + V + "f 1 2 3\n", ["mtllib", "gone.mtl"]),
    "mtl outside": ("mtllib ../gone.mtl\n" + V + "f 1 2 3\n", ["mtllib", "leaves the scene's folder"]),
    "no such material": ("mtllib m.mtl\nusemtl b\n" + V + "f 1 2 3\n", ["usemtl", "'b'", "m.mtl"]),
    "texture gone": ("mtllib m.mtl\nusemtl t\n" + V + "vt 0 0\nf 1/1 2/1 3/1\n", ["materials.t.texture", "gone.png"]),
    "mtl with words": ("mtllib w.mtl\n" + V + "f 1 2 3\n", ["w.mtl line 2"]),
}


@pytest.mark.parametrize("case", OBJ_CASES)
def test_obj(tmp_path: Path, case: str) -> None:
    text, words = OBJ_CASES[case]
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl t\nmap_Kd gone.png\n")
    (tmp_path / "w.mtl").write_text("newmtl a\nKd one 0 0\n")
    (tmp_path / "x.obj").write_text(text)
    refused(tmp_path / "x.obj", *words)


def _texture(file: str) -> str:
    return (
        '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        f'<string name="filename" value="{file}"/></texture></bsdf></shape>'
    )


XML_CASES = {
    "library as type": ('<bsdf type="/tmp/evil.so"/>', ["unknown plugin type", "evil.so", "roughplastic"]),
    "path as type": ('<integrator type="../evil"/>', ["unknown plugin type", "evil"]),
    "path deep inside": ('<sensor type="perspective"><sampler type="a/b"/></sensor>', ["unknown plugin type"]),
    "unknown type": ('<shape type="hair"/>', ["unknown plugin type", "hair"]),
    "sky model": ('<emitter type="sunsky"/>', ["sunsky", "envmap"]),
    "serialized": ('<shape type="serialized"/>', ["serialized", "obj"]),
    "no type": ("<bsdf/>", ["unknown plugin type"]),
    "include": ('<include filename="other.xml"/>', ["include", "write its content"]),
    "path element": ('<path value="/etc"/>', ["<path>", "remove it"]),
    "lost reference": ('<shape type="cube"><ref id="gone"/></shape>', ["gone", "no element has the id"]),
    "same id twice": ('<bsdf id="a" type="diffuse"/><bsdf id="a" type="diffuse"/>', ['id="a"', "taken"]),
    "circle": ('<bsdf id="a" type="twosided"><ref id="a"/></bsdf><shape type="cube"><ref id="a"/></shape>', ["circle"]),
    "missing mesh": ('<shape type="obj"><string name="filename" value="gone.obj"/></shape>', ["gone.obj"]),
    "mesh outside": ('<shape type="ply"><string name="filename" value="/etc/passwd"/></shape>', ["leaves the scene"]),
    "missing texture": (_texture("gone.png"), ["gone.png", "no such file"]),
    "texture outside": (_texture("../gone.png"), ["gone.png", "leaves the scene's folder"]),
    "texture is text": (_texture("scene.xml"), ["cannot decode the picture"]),
    "nan": ('<shape type="sphere"><float name="radius" value="nan"/></shape>', ["radius", "finite"]),
    "words": ('<shape type="sphere"><float name="radius" value="$r"/></shape>', ["radius", "finite"]),
    "negative radius": ('<shape type="sphere"><float name="radius" value="-1"/></shape>', ["radius"]),
    "matrix": ('<shape type="cube"><transform name="to_world"><matrix value="1 2"/></transform></shape>', ["matrix"]),
    "flat": ('<shape type="cube"><transform name="to_world"><scale y="0"/></transform></shape>', ["flattens"]),
    "unknown metal": (
        '<shape type="cube"><bsdf type="conductor"><string name="material" value="../x"/></bsdf></shape>',
        ["unknown metal", "Au"],
    ),
    "spectrum file": (
        '<shape type="cube"><bsdf type="diffuse"><spectrum name="reflectance" filename="a.spd"/></bsdf></shape>',
        ["spectra"],
    ),
    "negative light": ('<emitter type="point"><rgb name="intensity" value="-1"/></emitter>', ["intensity", "negative"]),
    "area in the air": ('<emitter type="area"/>', ["inside a shape"]),
    "fov": ('<sensor type="perspective"><float name="fov" value="200"/></sensor>', ["fov"]),
    "two skies": ('<emitter type="constant"/>', ["only one sky"]),
    "deep": ("<bsdf type='twosided'>" * 40 + "</bsdf>" * 40, ["nested"]),
    "growing default": (
        '<default name="a" value="xxxxxxxxxxxxxxxx"/>'
        + "".join(f'<default name="{n}" value="{f"${m}" * 8}"/>' for m, n in ("ab", "bc", "cd", "de")),
        ["substitution"],
    ),
}


@pytest.mark.parametrize("case", XML_CASES)
def test_xml(tmp_path: Path, case: str) -> None:
    body, words = XML_CASES[case]
    refused(write_xml(tmp_path, body), *words)


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE s [<!ENTITY a "x"><!ENTITY b "&a;&a;">]><scene version="3.0.0">&b;</scene>',
        '<!DOCTYPE s SYSTEM "file:///etc/passwd"><scene version="3.0.0"/>',
        '<!DOCTYPE s><scene version="3.0.0"/>',
        "<scene",
        "<other/>",
        '<scene version="3.0.0"/>',
        "",
    ],
)
def test_xml_document(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.xml").write_text(text)
    refused(tmp_path / "scene.xml")


def test_xml_without_light(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><shape type="cube"/></scene>')
    refused(tmp_path / "scene.xml", "no light")


def _changed(table: str, index: int, **values: Any) -> dict[str, Any]:
    tree = gltf_tree()[0]
    tree[table][index] |= values
    return {table: tree[table]}


GLTF_CASES = {
    "count lies": (_changed("accessors", 0, count=400), ["accessors[0]", "400"]),
    "count is huge": (_changed("accessors", 0, count=10**12), ["accessors[0]", "count"]),
    "count is negative": (_changed("accessors", 0, count=-1), ["accessors[0]", "count"]),
    "view too long": (_changed("bufferViews", 0, byteLength=10**6), ["bufferViews[0]"]),
    "buffer too long": (_changed("buffers", 0, byteLength=10**6), ["buffers[0]"]),
    "index out of range": (_changed("accessors", 0, count=3), ["3 positions"]),
    "no such mesh": (_changed("nodes", 0, mesh=7), ["meshes[7]"]),
    "no such material": (
        _changed("meshes", 0, primitives=[{"attributes": {"POSITION": 0}, "material": 3}]),
        ["materials[3]"],
    ),
    "node circle": (_changed("nodes", 0, children=[0]), ["circle"]),
    "zero rotation": (_changed("nodes", 0, rotation=[0, 0, 0, 0]), ["nodes[0]", "quaternion"]),
    "words in translation": (_changed("nodes", 0, translation=["a", 0, 0]), ["nodes[0]", "translation"]),
    "draco": ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, ["extensionsRequired", "draco"]),
    "texture outside": ({"images": [{"uri": "../a.png"}]}, ["images[0]", "leaves the scene's folder"]),
    "texture gone": ({"images": [{"uri": "a%20b.png"}]}, ["images[0]", "a b.png"]),
    "texture is noise": ({"images": [{"uri": "data:image/png;base64,AAAA"}]}, ["images[0]", "cannot decode"]),
    "no meshes": ({"nodes": [{}, {}, {}]}, ["meshes", "empty"]),
    "old version": ({"asset": {"version": "1.0"}}, ["asset.version"]),
}


@pytest.mark.parametrize("case", GLTF_CASES)
def test_gltf(tmp_path: Path, case: str) -> None:
    changes, words = GLTF_CASES[case]
    tree, blob = gltf_tree(**changes)
    refused(write_glb(tmp_path, tree, blob), *words)


@pytest.mark.parametrize("at", [8, 12])
def test_glb_with_lying_lengths(tmp_path: Path, at: int) -> None:
    path = write_glb(tmp_path, *gltf_tree())
    data = bytearray(path.read_bytes())
    data[at : at + 4] = struct.pack("<I", 2**31)
    path.write_bytes(data)
    refused(path, "promises")


def test_glb_with_nan(tmp_path: Path) -> None:
    tree, blob = gltf_tree()
    refused(write_glb(tmp_path, tree, struct.pack("<f", np.nan) + blob[4:]), "meshes.square", "not finite")


def test_path_escapes(tmp_path: Path) -> None:
    """Absolute paths, `..`, and links that lead outside."""
    inside = tmp_path / "scene"
    inside.mkdir()
    (tmp_path / "out.ply").write_text(ply_text(SQUARE, [(0, 1, 2)]))
    (inside / "link.ply").symlink_to(tmp_path / "out.ply")
    (inside / "loop.ply").symlink_to(inside / "loop.ply")
    for name in (
        "../out.ply",
        str(tmp_path / "out.ply"),
        "link.ply",
        "loop.ply",
        "..\\\\out.ply",
        "C:\\\\out.ply",
        ".",
        "",
    ):
        refused(write_toml(inside, TOML.replace("wall.ply", name)), "meshes.wall.file")


def test_missing_and_unknown_scenes(tmp_path: Path) -> None:
    refused(tmp_path / "gone.toml", "no such file")
    refused(tmp_path, "scene.toml", "no such file")
    (tmp_path / "a.blend").write_text("x")
    refused(tmp_path / "a.blend", "cannot tell the format", ".glb")


def test_file_over_the_limit(tmp_path: Path) -> None:
    path = write_toml(tmp_path)
    with (tmp_path / "wall.ply").open("wb") as file:
        file.truncate((512 << 20) + 1)  # sparse: takes no room
    refused(path, "meshes.wall.file", "limit")


def test_picture_bomb(tmp_path: Path) -> None:
    """A small PNG that says it is 100,000 × 100,000."""
    write_picture(tmp_path / "a.png", np.zeros((2, 2, 3)))
    data = bytearray((tmp_path / "a.png").read_bytes())
    data[16:24] = struct.pack(">2I", 100_000, 100_000)
    import zlib

    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    (tmp_path / "a.png").write_bytes(data)
    refused(
        write_toml(tmp_path, TOML.replace("albedo", 'texture = "a.png"\nalbedo')), "materials.grey.texture", "large"
    )


def test_texture_without_coordinates(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", np.zeros((2, 2, 3)))
    path = write_toml(tmp_path, TOML.replace("albedo", 'texture = "a.png"\nalbedo'))
    refused(path, "meshes.wall", "texture coordinates")
