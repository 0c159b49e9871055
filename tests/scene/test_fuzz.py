"""Whatever is done to a file, the loaders give a scene or an InputError (failure-catalogue G3).

A seeded sample of the mutations that ran by the ten thousand while the loaders were written.
"""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.config import DirectionalLight, Light
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.lights_file import load_lights
from scene_files import SQUARE, TOML, gltf_tree, ply_text, write_glb, write_picture, write_toml, write_xml

WORDS = [b"nan", b"-1", b"1e400", b"99999999999999999999", b"0", b"../x", b"[]", b"{}", b"null", b"true", b'""', b"$w"]
TOKENS = re.compile(rb'[-\w.]+|\[[^\]]*\]|"[^"]*"')
XML = """<sensor type="perspective"><float name="fov" value="40"/></sensor>
<bsdf type="mask" id="a"><texture type="bitmap" name="opacity"><string name="filename" value="t.png"/></texture>
<bsdf type="twosided"><bsdf type="roughplastic"><string name="int_ior" value="bk7"/></bsdf></bsdf></bsdf>
<shape type="obj"><string name="filename" value="scene.obj"/><ref id="a"/><transform name="to_world">
<rotate x="1" angle="30"/><scale value="2"/></transform></shape>
<emitter type="spot"><transform name="to_world"><translate z="3"/></transform></emitter>
<shape type="rectangle"><emitter type="area"><texture type="bitmap" name="radiance">
<string name="filename" value="t.png"/></texture></emitter></shape>
<shape type="sphere"><float name="radius" value="0.5"/><emitter type="area"/></shape>"""
OBJ = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl a\nf 1/1/1 2/1/1 3/1/1\nf -3 -1 -2\n"


def _write(folder: Path, kind: str) -> Path:
    write_picture(folder / "t.png", np.full((2, 2, 4), 99))
    (folder / "m.mtl").write_text("newmtl a\nKd 0.5 1 0.5\nmap_Kd t.png\nKe 2 1 0\nmap_Ke t.png\nd 0.6\n")
    (folder / "scene.obj").write_text(OBJ)
    (folder / "scene.ply").write_text(ply_text(SQUARE, [(0, 1, 2, 3)]))
    if kind == "glb":
        return write_glb(folder, *gltf_tree())
    if kind == "xml":
        return write_xml(folder, XML)
    return write_toml(folder, TOML) if kind == "toml" else folder / f"scene.{kind}"


def _mutate(data: bytes, rng: random.Random) -> bytes:
    out, at, kind = bytearray(data), rng.randrange(len(data)), rng.random()
    if kind < 0.25:
        out[at] = rng.randrange(256)
    elif kind < 0.4:
        del out[at : at + rng.randrange(1, 20)]
    elif kind < 0.5:
        del out[at + 1 :]
    else:
        first, last = rng.choice([m.span() for m in TOKENS.finditer(data)])
        out[first:last] = rng.choice(WORDS)[: last - first] if data[:4] == b"glTF" else rng.choice(WORDS)
    return bytes(out)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["toml", "xml", "glb", "obj", "ply"])
def test_mutated_files(tmp_path: Path, kind: str) -> None:
    path = _write(tmp_path, kind)
    good = path.read_bytes()
    load_scene(path)
    rng, refused = random.Random(5), 0
    for _ in range(150):
        path.write_bytes(_mutate(good, rng))
        try:
            load_scene(path)
        except InputError as error:
            assert path.name in str(error) and str(error).isprintable()
            refused += 1
    assert refused > 20


LIGHTS = b"""scene = "house"
off = ["moon"]
[lights.sun]
direction = [0.3, -0.5, -1]
irradiance = [1, 0.5, 0.2]
[lights.sky]
type = "image_sky"
file = "t.png"
scale = 2
[lights.lamp]
type = "area"
mesh = "wall"
radiance = [1, 1, 1]
"""


@pytest.mark.filterwarnings("error")
def test_mutated_lights_files(tmp_path: Path) -> None:
    write_picture(tmp_path / "t.png", np.full((2, 2, 4), 99))
    sun = DirectionalLight(type="directional", direction=(0, -1, 0), irradiance=(1, 1, 1))
    base: dict[str, Light] = {"sun": sun, "moon": sun}
    path, rng, refused = tmp_path / "l.toml", random.Random(6), 0
    path.write_bytes(LIGHTS)
    assert list(load_lights(path, "house", base, ["wall"]).lights) == ["sun", "sky", "lamp"]
    for _ in range(300):
        path.write_bytes(_mutate(LIGHTS, rng))
        try:
            load_lights(path, "house", base, ["wall"])
        except InputError as error:
            assert path.name in str(error) and str(error).isprintable()
            refused += 1
    assert refused > 40
