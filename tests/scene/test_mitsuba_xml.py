"""Mitsuba XML: numbers of both dialects, and that the ground truth's dictionaries are ones that Mitsuba takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.config import AreaLight, DirectionalLight, ImageSky, PointLight, SpotLight
from lightgauge.reference.datatypes import Material, Mesh, Scene
from lightgauge.reference.scene import load_scene
from lightgauge.reference.scene.primitives import PRIMITIVES
from lightgauge.reference.scene.sky_turn import directions, rotation_about_y, turned
from lightgauge.reference.scene.surfaces import plain_twin
from lightgauge.reference.scene.xml_camera import horizontal_fov
from lightgauge.reference.scene.xml_materials import METALS
from scene_files import write_picture, write_xml

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


def load(folder: Path, body: str, version: str = "3.0.0") -> Scene:
    return load_scene(write_xml(folder, body, version))


def mesh(scene: Scene, name: str) -> Mesh:
    return next(m for m in scene.meshes if m.name == name)


def area_vector(m: Mesh) -> np.ndarray:
    """Sum of area × normal."""
    p = m.vertices[m.faces]
    return np.asarray(0.5 * np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).sum(axis=0))


def material(scene: Scene, name: str) -> Material:
    return scene.materials[mesh(scene, name).material]


SENSOR = """<sensor type="perspective"><float name="fov" value="{fov}"/><string name="{axis}" value="y"/>
<transform name="{world}"><{look} origin="1, 2, 3" target="1, 2, -1" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="1024"/><integer name="height" value="512"/></film></sensor>"""


@pytest.mark.parametrize(
    ("version", "names"),
    [
        ("0.6.0", {"axis": "fovAxis", "world": "toWorld", "look": "lookAt"}),
        ("3.0.0", {"axis": "fov_axis", "world": "to_world", "look": "lookat"}),
    ],
)
def test_camera_of_both_dialects(tmp_path: Path, version: str, names: dict[str, str]) -> None:
    scene = load(tmp_path, SENSOR.format(fov=60, **names), version)
    camera = scene.settings.cameras["camera"]
    assert camera.origin == (1, 2, 3)
    assert np.allclose(np.subtract(camera.target, camera.origin), [0, 0, -1])
    assert np.allclose(camera.up, [0, 1, 0])
    assert (camera.width, camera.height) == (512, 256)
    assert camera.fov_deg == pytest.approx(np.degrees(2 * np.arctan(2 * np.tan(np.radians(30)))))
    assert any("1024 x 512 to 512 x 256" in note for note in scene.notes)


def test_fov_axes() -> None:
    assert horizontal_fov(60, "x", 2.0) == pytest.approx(60)
    assert horizontal_fov(60, "larger", 2.0) == pytest.approx(60)
    assert horizontal_fov(60, "smaller", 0.5) == pytest.approx(60)
    assert horizontal_fov(60, "y", 1.0) == pytest.approx(60)
    assert horizontal_fov(90, "diagonal", 1.0) == pytest.approx(np.degrees(2 * np.arctan(np.sqrt(0.5))))


def test_transform_steps_apply_in_order(tmp_path: Path) -> None:
    steps = '<scale value="2"/><rotate y="1" angle="90"/><translate x="10"/>'
    body = f'<shape type="rectangle" id="r"><transform name="to_world">{steps}</transform></shape>'
    r = mesh(load(tmp_path, body), "r")
    assert r.vertices.min(axis=0) == pytest.approx([10, -2, -2]) and r.vertices.max(axis=0) == pytest.approx([10, 2, 2])
    assert area_vector(r) == pytest.approx([16, 0, 0])  # the normal +z turns to +x


def test_rectangle_and_its_lamp(tmp_path: Path) -> None:
    lamp = '<emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>'
    scene = load(tmp_path, f'<shape type="rectangle" id="lamp">{lamp}</shape>')
    m = mesh(scene, "lamp")
    assert area_vector(m) == pytest.approx([0, 0, 4])
    assert m.emission.tolist() == [1, 2, 3] and m.engine_lit
    light = scene.settings.lights["lamp"]
    assert isinstance(light, AreaLight) and light.mesh == "lamp" and light.tag == "engine"


@pytest.mark.parametrize("kind", ["rectangle", "disk", "cube", "sphere", "cylinder"])
def test_mirroring_keeps_the_front_of_primitives(tmp_path: Path, kind: str) -> None:
    mirror = '<transform name="to_world"><scale x="-1"/></transform>'
    plain, mirrored = (mesh(load(tmp_path, f'<shape type="{kind}" id="m">{t}</shape>'), "m") for t in ("", mirror))
    flip = np.array([-1, 1, 1])
    assert area_vector(mirrored) == pytest.approx(area_vector(plain) * flip, abs=1e-9)
    for m in (plain, mirrored):
        p = m.vertices[m.faces]
        volume = np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
        assert volume > 0 or kind in ("rectangle", "disk")


@pytest.mark.parametrize(("kind", "area"), [("rectangle", 4), ("disk", np.pi), ("cube", 24), ("sphere", 4 * np.pi)])
def test_area_of_primitives(kind: str, area: float) -> None:
    m = PRIMITIVES[kind]()
    p = m.vertices[m.faces]
    total = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    assert total == pytest.approx(area, rel=1e-12)


def test_sphere_and_cylinder_are_placed(tmp_path: Path) -> None:
    sphere = (
        '<shape type="sphere" id="s"><point name="center" x="1" y="2" z="3"/><float name="radius" value="2"/></shape>'
    )
    tube = '<shape type="cylinder" id="c"><point name="p0" value="0,0,0"/><point name="p1" value="0,5,0"/></shape>'
    scene = load(tmp_path, sphere + tube)
    s, c = mesh(scene, "s"), mesh(scene, "c")
    assert s.closed and s.vertices.mean(axis=0) == pytest.approx([1, 2, 3])
    assert np.linalg.norm(s.vertices - [1, 2, 3], axis=1) == pytest.approx(2.0, rel=2e-3)
    assert c.vertices[:, 1].min() == 0 and c.vertices[:, 1].max() == 5 and not c.closed


def test_winding_follows_vertex_normals(tmp_path: Path) -> None:
    """Mitsuba shades to the side of the vertex normals, and face_normals switches that off."""
    (tmp_path / "a.obj").write_text(OBJ + "vn 0 0 -1\nf 1/1/1 2/2/1 3/3/1\n")
    file = '<string name="filename" value="a.obj"/>'
    turned_mesh = mesh(load(tmp_path, f'<shape type="obj">{file}</shape>'), "a")
    flat = '<boolean name="face_normals" value="true"/>'
    kept = mesh(load(tmp_path, f'<shape type="obj">{file}{flat}</shape>'), "a")
    flipped = mesh(
        load(tmp_path, f'<shape type="obj">{file}{flat}<boolean name="flip_normals" value="true"/></shape>'), "a"
    )
    assert [float(area_vector(m)[2]) for m in (turned_mesh, kept, flipped)] == [-0.5, 0.5, -0.5]


def test_texture_coordinates(tmp_path: Path) -> None:
    """v of OBJ files is Mitsuba's 1 − v already; PLY and rectangles are turned; to_uv works in Mitsuba's v."""
    write_picture(tmp_path / "t.png", [[[9, 9, 9]]])
    (tmp_path / "a.obj").write_text(OBJ + "f 1/1 2/2 3/3\n")
    to_uv = '<transform name="to_uv"><scale x="2" y="3"/></transform>'
    picture = f'<texture type="bitmap" name="reflectance"><string name="filename" value="t.png"/>{to_uv}</texture>'
    file = '<string name="filename" value="a.obj"/>'
    scene = load(
        tmp_path,
        f'<shape type="obj">{file}</shape>'
        f'<shape type="obj" id="scaled">{file}<bsdf type="diffuse">{picture}</bsdf></shape>'
        f'<shape type="obj" id="kept">{file}<boolean name="flip_tex_coords" value="false"/></shape>',
    )
    uvs = {m.name: m.uvs.tolist() for m in scene.meshes if m.uvs is not None}
    assert uvs["a"] == [[0, 0], [1, 0], [0, 1]]
    assert uvs["kept"] == [[0, 1], [1, 1], [0, 0]]
    assert uvs["scaled"] == [[0, -2], [2, -2], [0, 1]]  # v: 1 − 3 (1 − v)


def test_lights(tmp_path: Path) -> None:
    at = '<transform name="to_world"><lookat origin="1,2,3" target="1,2,4" up="0,1,0"/></transform>'
    scene = load(
        tmp_path,
        f'<emitter type="spot">{at}<float name="cutoff_angle" value="40"/><rgb name="intensity" value="5"/></emitter>'
        '<emitter type="point" id="p"><point name="position" x="4"/><rgb name="intensity" value="1 2 3"/></emitter>'
        '<emitter type="directional"><vector name="direction" y="-2"/><spectrum name="irradiance" value="7"/>'
        "</emitter>",
    )
    spot, point, sun = (scene.settings.lights[n] for n in ("spot", "p", "directional"))
    assert isinstance(spot, SpotLight) and isinstance(point, PointLight) and isinstance(sun, DirectionalLight)
    assert spot.position == (1, 2, 3) and spot.direction == (0, 0, 1) and spot.intensity == (5, 5, 5)
    assert (spot.cutoff_deg, spot.beam_deg) == (40, 30)
    assert point.position == (4, 0, 0) and point.intensity == (1, 2, 3)
    assert sun.direction == (0, -1, 0) and sun.irradiance == (7, 7, 7)
    assert {light.tag for light in (spot, point, sun)} == {"engine"}
    assert scene.settings.lights["sky"].tag == "input"


def test_defaults_are_filled_in(tmp_path: Path) -> None:
    body = '<default name="size" value="3"/><default name="s" value="$size 1 1"/>'
    body += '<shape type="rectangle" id="r"><transform name="to_world"><scale value="$s"/></transform></shape>'
    assert mesh(load(tmp_path, body), "r").vertices.max(axis=0) == pytest.approx([3, 1, 0])


def _sky(folder: Path, transform: str) -> Scene:
    image = np.zeros((4, 8, 3), np.uint8)
    image[1, 2] = 255
    write_picture(folder / "sky.png", image)
    (folder / "scene.xml").write_text(
        '<scene version="0.5.0"><shape type="cube"/><emitter type="envmap"><string name="filename" value="sky.png"/>'
        f'<float name="scale" value="3"/><transform name="toWorld">{transform}</transform></emitter></scene>'
    )
    return load_scene(folder / "scene.xml")


def test_sky_about_y(tmp_path: Path) -> None:
    scene = _sky(tmp_path, '<rotate y="1" angle="30"/>')
    light = scene.settings.lights["sky"]
    assert isinstance(light, ImageSky) and light.rotation_deg == pytest.approx(30) and light.tag == "input"
    assert scene.sky is not None and scene.sky.image.max() == 3.0 and scene.sky.rotation_deg == light.rotation_deg


def test_sky_about_another_axis(tmp_path: Path) -> None:
    scene = _sky(tmp_path, '<rotate x="1" angle="90"/>')
    assert scene.sky is not None and scene.sky.rotation_deg == 0.0
    assert any("axis other than y" in note for note in scene.notes)


def test_turned_sky_agrees_with_a_turn_about_y() -> None:
    """A turn by a quarter about y moves the picture by a quarter of its width, to the texel."""
    rng = np.random.default_rng(1)
    image = rng.random((8, 16, 3)).astype(np.float32)
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    out = turned(image, quarter)
    d = directions(8, 16)
    k = np.argmin(np.linalg.norm(d - d[3, 5] @ quarter.T, axis=2)[3])
    assert np.allclose(out[3, k], image[3, 5], atol=1e-5)
    assert rotation_about_y(quarter) == pytest.approx(90) and rotation_about_y(np.diag([1.0, -1, -1])) is None


BSDFS = {
    "diffuse": '<bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.2 0.3"/></bsdf>',
    "hex": '<bsdf type="diffuse"><rgb name="reflectance" value="#808080"/></bsdf>',
    "twosided": '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>',
    "plastic": '<bsdf type="plastic"><rgb name="diffuseReflectance" value="0.4"/>'
    '<float name="intIOR" value="1.4"/></bsdf>',
    "roughplastic": '<bsdf type="roughplastic"><string name="int_ior" value="bk7"/><float name="alpha" value="0.2"/>'
    '<string name="distribution" value="ggx"/><boolean name="nonlinear" value="true"/></bsdf>',
    "conductor": '<bsdf type="conductor"><string name="material" value="none"/></bsdf>',
    "roughconductor": '<bsdf type="roughconductor"><rgb name="eta" value="1.5"/><rgb name="k" value="4"/></bsdf>',
    "gold": '<bsdf type="twosided"><bsdf type="roughconductor"><string name="material" value="Au"/></bsdf></bsdf>',
    "dielectric": '<bsdf type="dielectric"/>',
    "thindielectric": '<bsdf type="thindielectric"><float name="int_ior" value="1.3"/></bsdf>',
    "roughdielectric": '<bsdf type="roughdielectric"><string name="distribution" value="phong"/></bsdf>',
    "mask": '<bsdf type="mask"><float name="opacity" value="0.3"/>'
    '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
    "bumpmap": '<bsdf type="bumpmap"><bsdf type="plastic"/></bsdf>',
    "phong": '<bsdf type="phong"><rgb name="diffuseReflectance" value="0.4"/></bsdf>',
    "blend": '<bsdf type="blendbsdf"><float name="weight" value="0.25"/><bsdf type="diffuse"/><bsdf type="diffuse">'
    '<rgb name="reflectance" value="0.1"/></bsdf></bsdf>',
    "principled": '<bsdf type="principled"><rgb name="base_color" value="0.7"/>'
    '<float name="metallic" value="0.8"/></bsdf>',
    "null": '<bsdf type="null"/>',
    "texture": '<bsdf type="plastic"><texture type="bitmap" name="diffuse_reflectance">'
    '<string name="filename" value="t.png"/></texture></bsdf>',
    "leaf": '<bsdf type="mask"><texture type="bitmap" name="opacity"><string name="filename" value="t.png"/></texture>'
    '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="t.png"/></texture>'
    "</bsdf></bsdf>",
    "checkerboard": '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf>',
}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """One rectangle with each material."""
    folder = tmp_path_factory.mktemp("bsdfs")
    write_picture(folder / "t.png", [[[255, 255, 255, 0], [128, 128, 128, 255]]])
    return load(folder, "".join(f'<shape type="rectangle" id="{n}">{b}</shape>' for n, b in BSDFS.items()))


@pytest.mark.parametrize(
    ("name", "albedo"),
    [
        ("diffuse", [0.1, 0.2, 0.3]),
        ("hex", [0.2158605] * 3),
        ("twosided", [0.5] * 3),
        ("plastic", [0.4] * 3),
        ("roughplastic", [0.5] * 3),
        ("conductor", [0.95] * 3),  # clamped
        ("roughconductor", [(0.25 + 16) / (6.25 + 16)] * 3),
        ("gold", [0.95, *METALS["Au"][1:]]),
        ("mask", [0.5] * 3),
        ("bumpmap", [0.5] * 3),
        ("phong", [0.4] * 3),
        ("blend", [0.4] * 3),
        ("principled", [0.7] * 3),
        ("texture", [(0.95 + 0.2158605) / 2] * 3),
        ("leaf", [0.2158605] * 3),  # what is transparent takes the colour of the rest
        ("checkerboard", [0.3] * 3),
    ],
)
def test_baked_albedo(shown: Scene, name: str, albedo: list[float]) -> None:
    assert material(shown, name).albedo == pytest.approx(albedo, abs=1e-5)


def test_flags_of_materials(shown: Scene) -> None:
    passing = {n for n in BSDFS if material(shown, n).passes_light}
    assert passing == {"dielectric", "thindielectric", "roughdielectric", "null"}
    assert {n for n in BSDFS if material(shown, n).two_sided} == {"twosided", "gold", "mask"}
    diffuse = {n for n in BSDFS if material(shown, n).truth_bsdf is None}
    assert diffuse == {"diffuse", "hex", "twosided", "phong", "blend", "checkerboard"}
    leaf = material(shown, "leaf")
    assert leaf.opacity is not None and leaf.opacity.tolist() == [[0, 1]]
    assert leaf.truth_bsdf is not None and leaf.truth_bsdf["opacity"] == "@opacity"


@pytest.mark.parametrize("name", BSDFS)
def test_mitsuba_takes_the_truth(shown: Scene, name: str) -> None:
    m = material(shown, name)
    if m.truth_bsdf is None:
        return
    from lightgauge.reference.variant import ensure_variant

    ensure_variant()
    import mitsuba as mi

    assert isinstance(mi.load_dict(dict(plain_twin(m).truth_bsdf or {})), mi.BSDF)


def test_mesh_without_coordinates_gets_the_mean_colour(tmp_path: Path) -> None:
    write_picture(tmp_path / "t.png", [[[0, 0, 0], [128, 128, 128]]])
    scene = load(tmp_path, f'<shape type="sphere" id="s">{BSDFS["texture"]}</shape>')
    m = material(scene, "s")
    assert m.texture is None and m.albedo == pytest.approx([0.2158605 / 2] * 3, abs=1e-5)
    assert m.truth_bsdf is not None and m.truth_bsdf["diffuse_reflectance"]["type"] == "rgb"
    assert any("mean colour" in note for note in scene.notes)
