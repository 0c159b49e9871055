"""The bundled scenes: what is committed is what `scenes/generate.py` writes, and their geometry is what their READMEs say."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from lightgauge.reference.config import SceneSettings
from lightgauge.reference.config_placement import BoxSettings
from lightgauge.reference.scene import load_scene

SCENES = Path(__file__).resolve().parent.parent / "scenes"
NAMES = ("cornell", "two-rooms", "sphere", "corridor", "house", "valley")
HOUSE = ("house_walls", "house_roof", "house_floor", "house_partition")
Array = npt.NDArray[np.float64]


def settings(name: str) -> SceneSettings:
    return SceneSettings.model_validate(tomllib.loads((SCENES / name / "scene.toml").read_text(encoding="utf-8")))


def mesh(scene: str, *names: str) -> trimesh.Trimesh:
    """These meshes of a scene (all, without names) as one, vertices of one place merged."""
    files = [SCENES / scene / f"{n}.ply" for n in names] or sorted((SCENES / scene).glob("*.ply"))
    parts = [trimesh.load_mesh(f, process=False) for f in files]
    joined = trimesh.util.concatenate(parts) if len(parts) > 1 else parts[0]
    assert isinstance(joined, trimesh.Trimesh)
    joined.merge_vertices()
    return joined


def hits(whole: trimesh.Trimesh, origin: Array, directions: Array) -> tuple[Array, Array]:
    """Distance to the first triangle (inf: none) along each direction, and whether its front was hit (Möller, Trumbore)."""
    a, e1, e2 = whole.triangles[:, 0], *(whole.triangles[:, k] - whole.triangles[:, 0] for k in (1, 2))
    p = np.cross(directions[:, None], e2)
    det = (e1 * p).sum(-1)
    s = origin - a
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (s * p).sum(-1) / det
        q = np.cross(s, e1)
        v = (directions[:, None] * q).sum(-1) / det
        t = (e2 * q).sum(-1) / det
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    nearest = t.argmin(axis=1)
    rows = np.arange(len(directions))
    return np.array(t[rows, nearest]), np.array(det[rows, nearest] > 0)


def directions(count: int) -> Array:
    d = np.random.default_rng(1).normal(size=(count, 3))
    return np.array(d / np.linalg.norm(d, axis=1, keepdims=True))


def points_in(box: BoxSettings, count: int) -> Array:
    low, high = np.array(box.min), np.array(box.max)
    return np.array(low + np.random.default_rng(2).random((count, 3)) * (high - low))


def open_edges(whole: trimesh.Trimesh) -> npt.NDArray[np.int64]:
    """Edges that only one face has, in its direction."""
    _, first, count = np.unique(np.sort(whole.edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.array(whole.edges[first[count == 1]], dtype=np.int64)


def boundary(whole: trimesh.Trimesh) -> Array:
    """Vertices of the open edges."""
    return np.array(whole.vertices[np.unique(open_edges(whole))])


def test_generator_writes_what_is_committed(tmp_path: Path) -> None:
    """Twice, in two processes: nothing in the bytes depends on time, hash seed or order."""
    for extra in (["--check"], ["--out", str(tmp_path)]):
        done = subprocess.run(
            [sys.executable, str(SCENES / "generate.py"), *extra], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stdout + done.stderr
    for name in NAMES:
        written = {p.name: p.read_bytes() for p in (tmp_path / name).iterdir()}
        assert written == {p.name: p.read_bytes() for p in (SCENES / name).iterdir()}


def test_check_notices_a_change(tmp_path: Path) -> None:
    command = [sys.executable, str(SCENES / "generate.py"), "sphere", "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    with (tmp_path / "sphere" / "scene.toml").open("a") as file:
        file.write("\n")
    (tmp_path / "sphere" / "upper.ply").unlink()
    done = subprocess.run([*command, "--check"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "sphere/scene.toml: differs" in done.stdout and "sphere/upper.ply: missing" in done.stdout


def test_small() -> None:
    assert sum(p.stat().st_size for name in NAMES for p in (SCENES / name).rglob("*")) < 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_settings_and_files_agree(name: str) -> None:
    scene = settings(name)
    files = {m.file for m in scene.meshes.values()}
    assert files == {p.name for p in (SCENES / name).glob("*.ply")}
    assert {m.material for m in scene.meshes.values()} == set(scene.materials)
    assert scene.cameras and scene.volumes
    assert all(0.0 < a <= 0.8 for m in scene.materials.values() for a in m.albedo)
    readme = (SCENES / name / "README.md").read_text(encoding="utf-8")
    for part in ("**Units**", "Origin", "**Right answer**", "**Tests**"):
        assert part in readme.replace("**Origin**", "Origin"), part


@pytest.mark.parametrize("name", NAMES)
def test_no_bad_triangle(name: str) -> None:
    for file in sorted((SCENES / name).glob("*.ply")):
        part = trimesh.load_mesh(file, process=False)
        assert np.isfinite(part.vertices).all()
        assert part.area_faces.min() > 1e-7, file.name
    faces = np.sort(mesh(name).faces, axis=1)
    assert len(np.unique(faces, axis=0)) == len(faces), "two faces in one place"


@pytest.mark.parametrize("name", NAMES)
def test_cameras_see_fronts(name: str) -> None:
    """No camera stands in a wall, in the ground or in a tree: the nearest thing in any direction shows its front.

    From a camera outside a one-sided room (Cornell) only what lies in the view counts.
    """
    whole = mesh(name)
    for key, camera in settings(name).cameras.items():
        origin = np.array(camera.origin)
        forward = np.array(camera.target) - origin
        forward /= np.linalg.norm(forward)
        d = directions(3000)
        d = d[d @ forward > math.cos(math.radians(0.4 * camera.fov_deg))]
        distance, front = hits(whole, origin, d)
        assert len(d) > 20
        assert front[np.isfinite(distance)].all(), key
        assert distance.min() > 0.3, key


def test_cornell_areas() -> None:
    """Against the published millimetres, shoelace by hand; the left wall is two triangles, not quite in one plane."""

    def area(*xz: tuple[float, float]) -> float:
        pairs = zip(xz, (*xz[1:], xz[0]), strict=True)
        return abs(sum(a * d - c * b for (a, b), (c, d) in pairs)) / 2.0 * 1e-6

    short = ((130.0, 65.0), (82.0, 225.0), (240.0, 272.0), (290.0, 114.0))
    tall = ((423.0, 247.0), (265.0, 296.0), (314.0, 456.0), (472.0, 406.0))

    def round_about(feet: tuple[tuple[float, float], ...], height: float) -> float:
        sides = sum(math.dist(a, b) for a, b in zip(feet, (*feet[1:], feet[0]), strict=True))
        return area(*feet) + sides * height * 1e-6

    floor = area((552.8, 0.0), (0.0, 0.0), (0.0, 559.2), (549.6, 559.2)) - area(*short) - area(*tall)
    expected = {
        "floor": floor,
        "ceiling": 0.556 * 0.5592 - 0.130 * 0.105,
        "lamp": 0.130 * 0.105,
        "right": 0.5592 * 0.5488,
        "back": area((549.6, 0.0), (0.0, 0.0), (0.0, 548.8), (556.0, 548.8)),
        "short_block": round_about(short, 165.0),
        "tall_block": round_about(tall, 330.0),
    }
    for name, value in expected.items():
        assert mesh("cornell", name).area == pytest.approx(value, rel=1e-5), name
    assert mesh("cornell", "left").area == pytest.approx(0.5592 * 0.5488, rel=2e-3)


def test_cornell_faces_inwards_and_is_open_only_in_front() -> None:
    normals = {n: mesh("cornell", n).face_normals for n in ("floor", "ceiling", "lamp", "back", "left", "right")}
    inwards = {"floor": (1, 1), "ceiling": (1, -1), "lamp": (1, -1), "back": (2, -1), "left": (0, -1), "right": (0, 1)}
    for name, (axis, sign) in inwards.items():
        assert (normals[name][:, axis] * sign > 0.999).all(), name
    whole = mesh("cornell")
    assert whole.is_winding_consistent
    assert np.allclose(boundary(whole)[:, 2], 0.0)
    assert len(boundary(whole)) == 4


def test_cornell_colours() -> None:
    """Plausible and neutral where they must be: white balanced within 1 %, the walls' strong channels their own."""
    m = settings("cornell").materials
    assert max(m["white"].albedo) - min(m["white"].albedo) < 0.01
    assert 0.70 < m["white"].albedo[1] < 0.76
    assert m["red"].albedo.index(max(m["red"].albedo)) == 0
    assert m["green"].albedo.index(max(m["green"].albedo)) == 1


def test_sphere_is_closed_and_its_halves_equal() -> None:
    upper, lower, whole = mesh("sphere", "upper"), mesh("sphere", "lower"), mesh("sphere")
    assert whole.is_watertight and whole.is_winding_consistent
    assert len(whole.faces) == 1280
    assert whole.volume < 0.0  # it faces inwards
    assert upper.area == pytest.approx(lower.area, rel=1e-6)
    assert upper.vertices[:, 1].min() == 0.0 and lower.vertices[:, 1].max() == 0.0
    assert np.allclose(np.linalg.norm(whole.vertices, axis=1), 1.0, atol=2e-6)
    assert whole.area == pytest.approx(4.0 * math.pi, rel=0.01)
    scene = settings("sphere")
    assert scene.expect.closed_sphere
    assert len({m.albedo for m in scene.materials.values()}) == 1


def test_sphere_readme_states_the_closed_form() -> None:
    scene = settings("sphere")
    rho = scene.materials["plain"].albedo[0]
    irradiance = [math.pi * v / 2.0 / (1.0 - rho) for v in scene.materials["glowing"].emission]
    assert str([round(h, 4) for h in irradiance]) in (SCENES / "sphere" / "README.md").read_text(encoding="utf-8")


def test_two_rooms_are_one_solid() -> None:
    whole = mesh("two-rooms")
    assert whole.is_watertight and whole.is_winding_consistent
    rooms = 2 * 4.0 * 2.6 * 3.0
    assert whole.volume == pytest.approx(8.6 * 3.0 * 3.4 - rooms, rel=1e-6)
    assert len(whole.split(only_watertight=True)) == 3


@pytest.mark.parametrize("name", ["two-rooms", "corridor", "sphere"])
def test_no_ray_leaves_a_closed_room(name: str) -> None:
    whole = mesh(name)
    for box in settings(name).volumes.values():
        for origin in points_in(box, 8):
            distance, front = hits(whole, origin, directions(500))
            assert np.isfinite(distance).all() and front.all()


def test_the_sealed_room_sees_no_light() -> None:
    """Neither the lamp nor a coloured wall of the lit room is hit from it, and the point light is not in it."""
    scene, whole = settings("two-rooms"), mesh("two-rooms")
    box = scene.expect.dark["sealed_room"]
    low, high = np.array(box.min), np.array(box.max)
    for origin in points_in(box, 12):
        d = directions(500)
        end = origin + d * hits(whole, origin, d)[0][:, None]
        assert (end >= low - 1e-5).all() and (end <= high + 1e-5).all()
    for light in scene.lights.values():
        assert light.type in ("area", "point")
        if light.type == "point":
            assert light.position[0] < low[0]
    assert mesh("two-rooms", "lamp").bounds[1, 0] < low[0]


def test_two_rooms_voxels_are_finer_than_the_wall() -> None:
    voxel = settings("two-rooms").placement.min_voxel
    assert voxel is not None and voxel <= 0.2


def test_corridor_is_closed_and_lit_by_its_ends() -> None:
    whole = mesh("corridor")
    assert whole.is_watertight and whole.is_winding_consistent and whole.volume < 0.0
    assert (mesh("corridor", "panel_warm").face_normals[:, 0] > 0.999).all()
    assert (mesh("corridor", "panel_cool").face_normals[:, 0] < -0.999).all()
    scene = settings("corridor")
    assert not scene.lights  # its panels are input


def test_house_is_one_surface_open_only_underneath() -> None:
    """Closing the outline at the foot of the walls makes a solid; so nothing else is open."""
    house = mesh("house", *HOUSE)
    assert house.is_winding_consistent
    rim = boundary(house)
    assert np.allclose(rim[:, 1], -0.02)
    assert ((abs(abs(rim[:, 0]) - 4.0) < 1e-5) | (abs(abs(rim[:, 2]) - 3.0) < 1e-5)).all()
    middle = len(house.vertices)
    lid = [(b, a, middle) for a, b in open_edges(house)]
    closed = trimesh.Trimesh(
        np.vstack([house.vertices, [[0.0, -0.02, 0.0]]]), np.vstack([house.faces, lid]), process=False
    )
    assert closed.is_watertight and closed.is_winding_consistent and closed.volume > 0.0


def test_terrain_stays_out_of_the_house() -> None:
    """It ends in the middle of the walls, and around the house it lies level, above the foot of the walls."""
    terrain = mesh("house", "terrain")
    assert (terrain.face_normals[:, 1] > 0.5).all()
    inside = (abs(terrain.vertices[:, 0]) < 4.0 - 0.13) & (abs(terrain.vertices[:, 2]) < 3.0 - 0.13)
    assert not inside.any()
    middles = terrain.triangles_center
    assert not ((abs(middles[:, 0]) < 3.8) & (abs(middles[:, 2]) < 2.8)).any()
    near = (abs(terrain.vertices[:, 0]) < 5.0) & (abs(terrain.vertices[:, 2]) < 4.0)
    assert near.any() and np.allclose(terrain.vertices[near, 1], 0.0)


def test_no_light_gets_into_the_house_but_by_its_openings() -> None:
    """Rays from inside that find nothing pass, in the plane of a wall's middle, through the door or a window."""
    whole = mesh("house", *HOUSE)
    misses = 0
    for origin in points_in(settings("house").volumes["indoors"], 12):
        if 0.8 < origin[0] < 1.15:
            continue  # in the partition
        d = directions(600)
        distance, front = hits(whole, origin, d)
        assert front[np.isfinite(distance)].all()
        away = d[~np.isfinite(distance)]
        misses += len(away)
        for ray in away:
            x, y, _ = origin + ray * ((2.875 - origin[2]) / ray[2]) if ray[2] > 0 else (np.inf,) * 3
            _, v, w = origin + ray * ((3.875 - origin[0]) / ray[0]) if ray[0] > 0 else (np.inf,) * 3
            door = -0.4 < x < 0.6 and 0.15 < y < 2.1
            window = -3.0 < x < -1.4 and 0.9 < y < 2.1
            side = -1.0 < w < 0.8 and 0.9 < v < 2.1
            assert door or window or side
    assert misses > 0  # and one does see out


@pytest.mark.parametrize("tree", ["tree_a", "tree_b"])
def test_trees_are_closed_and_rooted(tree: str) -> None:
    crown, trunk = mesh("house", f"{tree}_crown"), mesh("house", f"{tree}_trunk")
    assert crown.is_watertight and trunk.is_watertight
    terrain = mesh("house", "terrain")
    foot = trunk.vertices[:, 1].min()
    x, z = trunk.bounds.mean(axis=0)[[0, 2]]
    distance, front = hits(terrain, np.array([x, 50.0, z]), np.array([[0.0, -1.0, 0.0]]))
    assert front[0] and 0.02 < 50.0 - distance[0] - foot < 0.4
    assert len(crown.split()) >= 80  # lumps that do not touch


def test_finer_things_ask_for_finer_voxels() -> None:
    m = settings("house").meshes
    sizes = [m[name].probe_size or 0.0 for name in ("terrain", "tree_a_crown", "house_walls")]
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) == 3


def test_valley_is_large_and_nothing_floats() -> None:
    terrain = mesh("valley", "grass", "hills", "river")
    assert (terrain.extents[[0, 2]] >= 500.0).all()
    assert (terrain.face_normals[:, 1] > 0.3).all()
    rim = boundary(terrain)
    assert ((abs(rim[:, 0]) == 256.0) | (abs(rim[:, 2]) == 256.0)).all()  # the three parts fit together
    down = np.array([[0.0, -1.0, 0.0]])
    for name in ("walls", "rocks", "trunks"):
        for thing in mesh("valley", name).split(only_watertight=False):
            low = thing.bounds[0, 1]
            feet = thing.vertices[thing.vertices[:, 1] < low + 0.1]
            for foot in feet:
                distance, _ = hits(terrain, foot + np.array([0.0, 300.0, 0.0]), down)
                assert distance[0] <= 300.0, f"{name}: a foot {distance[0] - 300.0:.2f} m above the ground"


@pytest.mark.parametrize("name", NAMES)
def test_the_loader_reads_it(name: str) -> None:
    scene = load_scene(SCENES / name / "scene.toml", {})
    assert scene.name == name
    assert {m.name for m in scene.meshes} == set(settings(name).meshes)
    assert sum(len(m.faces) for m in scene.meshes) == len(mesh(name).faces)


@pytest.mark.parametrize("block", ["short_block", "tall_block"])
def test_cornell_blocks_face_outwards(block: str) -> None:
    """Each face's normal points away from the block's middle, its top up, its sides level; it has no underside."""
    part = mesh("cornell", block)
    away = part.triangles_center - part.bounds.mean(axis=0)
    assert (np.einsum("fc,fc->f", part.face_normals, away) > 0.0).all()
    top = part.face_normals[:, 1] > 0.999
    assert top.sum() == 2 and np.allclose(part.face_normals[~top, 1], 0.0, atol=1e-6)
    assert np.allclose(boundary(part)[:, 1], 0.0) and len(boundary(part)) == 4
