"""End to end on small rooms: files in, results.json out.

Rationale: a stage can be right and the chain wrong. Expected: valid results, recalled when nothing changed, equal bits for
equal seeds, bad input refused by name, and a leak that is there is found.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.bitmap_file import write_bitmap
from lightgauge.reference.datatypes import BitmapLayer
from lightgauge.reference.errors import InputError
from lightgauge.reference.placement import addressable
from lightgauge.validation import measure
from lightgauge.validation import run as run_module
from lightgauge.validation.run import run_scenes
from small_scenes import box

Runner = Callable[..., dict[str, Any]]
QUICK = {"noise": 0.3, "max_spp": 512, "points": 64, "picture_spp": 2}
LAMP = np.array([[0.35, 0.95, 0.35], [0.65, 0.95, 0.35], [0.65, 0.95, 0.65], [0.35, 0.95, 0.65]])


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {c}" for c in "xyz"),
            f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    rows = [" ".join(map(str, v)) for v in vertices.tolist()] + [" ".join(map(str, [3, *f])) for f in faces.tolist()]
    path.write_text("\n".join(head + rows) + "\n", encoding="ascii")


def write_scene(folder: Path, meshes: Mapping[str, Any], tables: str) -> Path:
    folder.mkdir(parents=True)
    for name, m in meshes.items():
        write_ply(folder / f"{name}.ply", m.vertices, m.faces)
    listed = "".join(
        f'[meshes.{n}]\nfile = "{n}.ply"\nmaterial = "{"black" if n == "lamp" else "grey"}"\n' for n in meshes
    )
    head = "[materials]\ngrey = { albedo = [0.6, 0.5, 0.4] }\nblack = { albedo = [0.0, 0.0, 0.0] }\n"
    (folder / "scene.toml").write_text(head + listed + tables, encoding="utf-8")
    return folder / "scene.toml"


def lamp() -> Any:
    from small_scenes import quad

    return quad(LAMP)


ROOM = """
[lights.lamp]
type = "area"
mesh = "lamp"
radiance = [3.0, 2.0, 1.0]
tag = "engine"
[cameras.front]
origin = [0.5, 0.5, 0.9]
target = [0.5, 0.4, 0.0]
width = 16
height = 12
[placement]
min_voxel = 0.2
probe_rays = 256
[radiosity]
patch_size = 0.2
rays = 256
"""


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(
        tmp_path_factory.mktemp("scenes") / "room", {"walls": box((0, 0, 0), (1, 1, 1)), "lamp": lamp()}, ROOM
    )


@pytest.fixture(scope="session")
def two_rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lit room and a sealed dark one, 0.12 m of solid wall between."""
    tables = ROOM + "[expect.dark]\nsealed = { min = [1.12, 0.0, 0.0], max = [2.12, 1.0, 1.0] }\n"
    tables = tables.replace("[placement]", "[cameras.dark]\norigin = [2.0, 0.5, 0.9]\ntarget = [1.2, 0.4, 0.2]\n"
                            "width = 16\nheight = 12\n[placement]")  # fmt: skip
    meshes = {"lit": box((0, 0, 0), (1, 1, 1)), "sealed": box((1.12, 0, 0), (2.12, 1, 1)), "lamp": lamp()}
    return write_scene(tmp_path_factory.mktemp("scenes") / "two", meshes, tables)


@pytest.fixture(scope="session")
def caches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("caches")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caches: Path) -> Runner:
    """Measure one scene with quick settings; `cache` names the folder of kept results."""

    def call(scene: Path, cache: str, **overrides: Any) -> dict[str, Any]:
        monkeypatch.setenv("LIGHTGAUGE_CACHE", str(caches / cache))
        return run_scenes([scene], {"truth": QUICK, **overrides}, 3, tmp_path / "out", True, "test")

    return call


def metrics(results: Mapping[str, Any]) -> dict[str, Any]:
    return dict(results["scenes"][0]["metrics"])


def test_results_are_valid_and_written(run: Runner, room: Path, tmp_path: Path) -> None:
    import jsonschema

    results = run(room, "a")
    schema = json.loads((Path(run_module.__file__).parent / "results.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(results, schema)
    kept = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    jsonschema.validate(kept, schema)
    assert (tmp_path / "out" / "index.html").is_file() or list((tmp_path / "out").glob("*.html"))
    record = results["scenes"][0]
    assert record["status"] == "ok" and record["name"] == "room"
    m = record["metrics"]
    for name in (
        "relrmse",
        "bias",
        "p99",
        "floor_l1",
        "seam_sup",
        "energy_residual",
        "kernel_deviation",
        "reference_noise",
    ):
        assert name in m and np.isfinite(m[name]["value"]), name
    assert m["kernel_deviation"]["value"] < 1e-5
    assert m["seam_sup"]["value"] < 1e-5
    assert 0 < m["relrmse_surface"]["value"] < 0.5
    cost = record["cost"]
    assert cost["real_probes"] == cost["valid_probes"] + cost["invalid_probes"] > 8
    assert sum(row["real"] for row in record["counts_by_level"]) == cost["real_probes"]


def test_no_volume_is_a_note_not_a_crash(run: Runner, room: Path) -> None:
    results = run(room, "a")
    assert not any(k.endswith("_volume") for k in metrics(results))
    assert any("volume" in n for n in results["scenes"][0]["notes"])


def test_second_run_is_recalled_and_equal_but_for_the_date(
    run: Runner, room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run(room, "a")

    def never(*_: Any) -> None:
        raise AssertionError("measured again although nothing changed")

    monkeypatch.setattr(run_module, "measure_scene", never)
    second = run(room, "a")
    for results in (first, second):
        results["provenance"].pop("date", None)
    assert second == first


def test_same_seed_same_bits(run: Runner, room: Path) -> None:
    """From two empty caches: every metric equal to the last bit."""
    assert metrics(run(room, "a")) == metrics(run(room, "b"))


def test_a_leak_is_found_where_there_is_one(run: Runner, two_rooms: Path) -> None:
    """Voxels of 0.5 m across a wall of 0.12 m leak; of 0.1 m do not (t ≥ h for an axis-aligned wall). Same truth."""
    coarse = metrics(run(two_rooms, "a", placement={"min_voxel": 0.5}))
    fine = metrics(run(two_rooms, "a", placement={"min_voxel": 0.1, "probe_rays": 64}))
    assert coarse["leak"]["value"] > 0.01 and coarse["leak_area"]["value"] > 0.05
    assert fine["leak"]["value"] < 1e-3
    assert fine["overdark"]["value"] < coarse["overdark"]["value"] + 0.05


def test_camera_in_a_wall_is_named(run: Runner, two_rooms: Path) -> None:
    with pytest.raises(InputError, match=r"cameras\.dark: origin .*inside a wall"):
        run(two_rooms, "a", cameras={"dark": {"origin": [1.06, 0.5, 0.5]}})


def test_no_probe_placed_is_an_error(run: Runner, room: Path) -> None:
    """A threshold that nothing meets leaves the root's 8 probes, all outside the room, where they see the walls' backs."""
    with pytest.raises(InputError, match="no probe placed"):
        run(room, "a", placement={"min_voxel": 0.9, "backface_tolerance": 0.0, "threshold": 1e-3})


def test_a_scene_without_camera_is_measured_and_reported(run: Runner, tmp_path: Path) -> None:
    start, end = ROOM.index("[cameras.front]"), ROOM.index("[placement]")
    scene = write_scene(
        tmp_path / "blind", {"walls": box((0, 0, 0), (1, 1, 1)), "lamp": lamp()}, ROOM[:start] + ROOM[end:]
    )
    results = run(scene, "a")
    assert results["scenes"][0]["status"] == "ok" and "relrmse_surface" in metrics(results)
    assert any("camera" in n for n in results["scenes"][0]["notes"])


def test_a_point_light_tagged_input_agrees_with_the_truth(run: Runner, tmp_path: Path) -> None:
    """Its direct and its reflected light both come from the probes. The mean over random places in the air is right for any
    order of SH: bias within 5 %."""
    light = '[lights.l]\ntype = "point"\nposition = [0.5, 0.6, 0.5]\nintensity = [1.0, 1.0, 1.0]\ntag = "input"\n'
    air = "[volumes.air]\nmin = [0.1, 0.1, 0.1]\nmax = [0.9, 0.9, 0.9]\n"
    tables = light + ROOM[ROOM.index("[cameras.front]") :] + air
    scene = write_scene(tmp_path / "lit", {"walls": box((0, 0, 0), (1, 1, 1))}, tables)
    m = metrics(run(scene, "a", truth={**QUICK, "points": 600, "noise": 0.1}))
    assert abs(m["bias_volume"]["value"]) < 0.05 + 4 * m["bias_volume"]["se"], m["bias_volume"]


def test_one_bad_scene_does_not_take_the_others_down(
    room: Path, two_rooms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caches: Path
) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(caches / "a"))
    overrides = {"truth": QUICK, "placement": {"min_voxel": 0.2, "max_probes": 600}}
    results = run_scenes([room, two_rooms], overrides, 3, tmp_path / "both", True, "test")
    by_name = {s["name"]: s for s in results["scenes"]}
    assert by_name["room"]["status"] == "ok"
    assert by_name["two"]["status"] == "failed" and "max_probes" in by_name["two"]["error"]


def test_a_bitmap_file_reaches_the_result(run: Runner, room: Path, tmp_path: Path) -> None:
    """Finer cells in one corner of the room place more probes there; a layer that misses the room is a note."""
    corner = BitmapLayer(np.zeros(3), 0.1, np.stack(np.meshgrid(*[np.arange(4)] * 3), axis=-1).reshape(-1, 3))
    away = BitmapLayer(np.full(3, 50.0), 0.2, np.zeros((1, 3), np.int64))
    write_bitmap(tmp_path / "edit.json", [corner, away])
    plain = run(room, "a")["scenes"][0]
    edited = run(room, "a", placement={"bitmap": str(tmp_path / "edit.json")})["scenes"][0]
    sizes = [{round(row["voxel_m"], 6): row["real"] for row in s["counts_by_level"]} for s in (plain, edited)]
    assert sizes[0].get(0.1, 0) == 0 and sizes[1][0.1] > 20
    notes = [n for n in edited["notes"] if "marks no voxel" in n]
    assert len(notes) == 1 and "edit.json: layers[1]" in notes[0] and not any("marks no" in n for n in plain["notes"])
    assert [m["view"] for m in edited["maps"]] == ["above", "side", "section"]
    assert edited["maps"][0]["bitmap"] != plain["maps"][0]["bitmap"]


def test_two_scenes_of_one_name_are_refused(room: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two scenes are called room"):
        run_scenes([room, room], {}, 1, tmp_path, True, "test")


def test_nothing_to_place_probes_for(run: Runner, tmp_path: Path) -> None:
    """Every mesh lit by a lightmap and no volume: refused by name, not an internal error."""
    scene = write_scene(tmp_path / "mapped", {"walls": box((0, 0, 0), (1, 1, 1)), "lamp": lamp()}, ROOM)
    lightmap = {name: {"lit_by": "lightmap"} for name in ("walls", "lamp")}
    with pytest.raises(InputError, match="no probe placed: no mesh"):
        run(scene, "a", meshes=lightmap)


def test_what_cannot_be_addressed_is_said_before_a_ray_is_traced(
    run: Runner, room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tracing(*_: object) -> None:
        raise AssertionError("traced")

    monkeypatch.setattr(addressable, "MAX_INDIRECTION_TEXELS", 1000)
    monkeypatch.setattr(measure, "ground_truth", tracing)
    monkeypatch.setattr(measure.pipeline, "bake_surfaces", tracing)
    with pytest.raises(InputError, match=r"the virtual texture addresses .*placement\.min_voxel = "):
        run(room, "a", placement={"min_voxel": 0.03})


def test_a_flat_scene_and_one_voxel_for_everything_are_measured(run: Runner, room: Path, tmp_path: Path) -> None:
    """What cannot be measured there is absent, and a note says why."""
    from small_scenes import quad

    floor = quad([[0, 0, 0], [0, 0, 4], [4, 0, 4], [4, 0, 0]])
    sky = '[lights.sky]\ntype = "sky"\nradiance = [1.0, 1.0, 1.0]\n'
    flat = run(write_scene(tmp_path / "flat", {"floor": floor}, sky), "flat", placement={"min_voxel": 1.0})["scenes"][0]
    assert flat["status"] == "ok" and flat["metrics"]["eta"]["value"] > 0.0
    coarse = run(room, "coarse", placement={"min_voxel": 50.0})["scenes"][0]
    assert coarse["status"] == "ok" and "seam_sup" not in coarse["metrics"]
    assert any("no seam metrics" in note for note in coarse["notes"])
