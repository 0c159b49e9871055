"""`lightgauge formfactor`: what it prints, what it drops, what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.transport.closed_forms.contour import polygon_form_factor
from lightgauge.validation import cli
from lightgauge.validation.formfactor import METHODS, degenerate, read_mesh
from lightgauge.validation.polygon_fans import unfolded

Capture = pytest.CaptureFixture[str]
FLOOR = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
CEILING = [(0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1)]
QUARTER = [(0, 0, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0.5), (0, 0.5, 0.5)]
TRUTH = 0.19982489569838738  # C-11
BEHIND_QUARTER = 0.1498686717737905


def obj(path: Path, vertices: list[tuple[float, ...]], faces: list[list[int]]) -> Path:
    lines = [f"v {' '.join(map(str, v))}" for v in vertices]
    path.write_text("\n".join(lines + [f"f {' '.join(str(i + 1) for i in f)}" for f in faces]) + "\n")
    return path


def ply(path: Path, vertices: list[tuple[float, ...]], faces: list[list[int]]) -> Path:
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property double {a}" for a in "xyz")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, v)) for v in vertices] + [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
    path.write_text("\n".join(head + rows) + "\n")
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    obj(tmp_path / "floor.obj", FLOOR, [[0, 1, 2, 3]])
    ply(tmp_path / "ceiling.ply", CEILING, [[0, 1, 2, 3]])
    ply(tmp_path / "quarter.ply", QUARTER, [[0, 1, 2, 3]])
    return tmp_path


def ask(capsys: Capture, *arguments: str) -> dict[str, float]:
    assert cli.main(["formfactor", *arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    found: dict[str, float] = json.loads(out)
    assert list(found) == ["value", "se", "rays", "method"]
    return found


def test_json(folder: Path, capsys: Capture) -> None:
    found = ask(capsys, "floor.obj", "ceiling.ply")
    assert found == {"value": pytest.approx(TRUTH, abs=1e-14), "se": 0.0, "rays": 0, "method": "contour"}
    hidden = ask(capsys, "floor.obj", "ceiling.ply", "--occluder", "quarter.ply")
    assert hidden["method"] == "contour+rays" and 0 < hidden["rays"] <= 1 << 20
    assert abs(hidden["value"] - BEHIND_QUARTER) <= min(1e-4, 4.0 * hidden["se"])
    few = ask(capsys, "floor.obj", "ceiling.ply", "--occluder", "quarter.ply", "--rays", "1024", "--seed", "5")
    again = ask(capsys, "floor.obj", "ceiling.ply", "--occluder", "quarter.ply", "--rays", "1024", "--seed", "5")
    assert few == again and few["rays"] <= 1024 and few["se"] > hidden["se"]
    assert ask(capsys, "floor.obj", "floor.obj")["value"] == 0.0


def test_plain(folder: Path, capsys: Capture) -> None:
    ply(folder / "wide.ply", [(-1, -1, 1), (-1, 2, 1), (2, 2, 1), (2, -1, 1)], [[0, 1, 2, 3]])
    assert cli.main(["formfactor", "floor.obj", "wide.ply"]) == 0
    first, second, method, areas = capsys.readouterr().out.splitlines()
    wide = polygon_form_factor(
        np.array(FLOOR, float), np.array([(-1, -1, 1), (-1, 2, 1), (2, 2, 1), (2, -1, 1)], float)
    )
    assert first == f"F floor.obj -> wide.ply: {wide:.10g} ± 0"
    assert second == f"F wide.ply -> floor.obj: {wide / 9:.10g} ± 0"
    assert method == f"method: contour ({METHODS['contour']}), 0 rays"
    assert areas.startswith("areas: 1, 9 ")
    assert cli.main(["formfactor", "floor.obj", "ceiling.ply", "--occluder", "quarter.ply", "--rays", "65536"]) == 0
    value, error = capsys.readouterr().out.splitlines()[0].partition(": ")[2].split(" ± ")
    assert abs(float(value) - BEHIND_QUARTER) <= 4.0 * float(error) < 1e-3


def test_faces_of_any_count(folder: Path, capsys: Capture) -> None:
    """A pentagon, and an L whose fan folds over because its first corner does not see all of it."""
    pentagon = [(1, 0, 0), (1, 1, 0), (0.5, 2, 0), (0, 1, 0), (0, 0, 0)]
    wall = [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)]
    ply(folder / "pentagon.ply", pentagon, [[0, 1, 2, 3, 4]])
    obj(folder / "wall.obj", wall, [[0, 1, 2, 3]])
    assert ask(capsys, "pentagon.ply", "wall.obj")["value"] == pytest.approx(0.15412431824856257, abs=1e-13)
    ring = [(0.2, 1, 1), (0.2, 0.2, 1), (1, 0.2, 1), (1, 0, 1), (0, 0, 1), (0, 1, 1)]
    truth = polygon_form_factor(np.array(FLOOR, float), np.array(ring, float))
    for writer, name in ((ply, "l.ply"), (obj, "l.obj")):
        for turn in range(6):
            writer(folder / name, ring[turn:] + ring[:turn], [list(range(6))])
            assert cli.main(["formfactor", "floor.obj", name, "--json"]) == 0
            out, err = capsys.readouterr()
            assert json.loads(out)["value"] == pytest.approx(truth, abs=1e-13)
            assert "not convex" in err or not err


def test_unfolding_leaves_good_fans_alone() -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)], float)
    quad_and_cone = np.array([[0, 1, 2], [0, 2, 3], [4, 0, 1], [4, 1, 2], [4, 2, 3], [4, 3, 0]], np.int32)
    two_sided = np.array([[0, 1, 2], [0, 2, 1]], np.int32)
    for faces in (quad_and_cone, two_sided):
        same, mended = unfolded(vertices, faces)
        assert mended == 0 and np.array_equal(same, faces)


def test_degenerate_faces_are_dropped_and_said(folder: Path, capsys: Capture) -> None:
    obj(folder / "sliver.obj", [*CEILING, (0, 0.5, 1)], [[0, 4, 1], [0, 1, 2, 3], [1, 2, 2], [0, 1, 2]])
    assert cli.main(["formfactor", "floor.obj", "sliver.obj", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["value"] == pytest.approx(TRUTH, abs=1e-14)
    assert "note: TO: sliver.obj: dropped 2 of 5 triangles without area, the first is number 0" in err
    assert "note: TO: sliver.obj: dropped 1 of 3 triangles that stand twice" in err


def test_far_and_tiny_meshes_are_not_degenerate(folder: Path, capsys: Capture) -> None:
    for shift, scale, tolerance in ((1e7, 1.0, 1e-8), (0.0, 1e-9, 1e-13), (0.0, 1e8, 1e-13)):
        for name, corners in (("a.obj", FLOOR), ("b.obj", CEILING)):
            obj(folder / name, [tuple(shift + scale * x for x in c) for c in corners], [[0, 1, 2, 3]])
        assert ask(capsys, "a.obj", "b.obj")["value"] == pytest.approx(TRUTH, abs=tolerance)


def test_winding_against_the_normals_is_said(folder: Path, capsys: Capture) -> None:
    lines = [f"v {' '.join(map(str, v))}" for v in CEILING] + ["vn 0 0 1", "f 1//1 2//1 3//1 4//1"]
    (folder / "odd.obj").write_text("\n".join(lines))
    assert cli.main(["formfactor", "floor.obj", "odd.obj", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["value"] == pytest.approx(TRUTH)
    assert "normals of 2 of 2 triangles point to their back" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["gone.ply", "ceiling.ply"], "FROM: gone.ply: no such file: gone.ply"),
        (["floor.obj", "ceiling.stl"], "TO: ceiling.stl: cannot tell the format"),
        (["floor.obj", "ceiling.ply", "--occluder", "gone.obj"], "--occluder: gone.obj: no such file"),
        (["floor.obj", "flat.obj"], "TO: flat.obj: the mesh has no area: face 0 and all of its 2 triangles"),
        (["nan.ply", "ceiling.ply"], "FROM: nan.ply: vertex 2 is not finite"),
        (["empty.obj", "ceiling.ply"], "FROM: empty.obj: the mesh is empty"),
        (["wild.obj", "ceiling.ply"], "FROM: wild.obj: face 1: vertex index 9 out of range"),
        (["floor.obj", "ceiling.ply", "--rays", "1023"], "--rays 1023: out of range; expected 1024 to 268435456"),
        (["floor.obj", "ceiling.ply", "--rays", "-1"], "--rays -1: out of range"),
        (["floor.obj", "ceiling.ply", "--rays", "1000000000000"], "out of range"),
    ],
)
def test_bad_input_is_2(arguments: list[str], says: str, folder: Path, capsys: Capture) -> None:
    obj(folder / "flat.obj", [(0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 3)], [[0, 1, 2, 3]])
    ply(folder / "nan.ply", [(0, 0, 0), (1, 0, 0), (float("nan"), 1, 0)], [[0, 1, 2]])
    obj(folder / "wild.obj", FLOOR, [[0, 1, 8]])
    (folder / "empty.obj").write_text("v 0 0 0\n")
    assert cli.main(["formfactor", *arguments, "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("lightgauge: error: ") and says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("arguments", [["floor.obj"], ["floor.obj", "b", "--rays", "many"], ["a", "b", "--seed", "-1"]])
def test_wrong_use_is_2(arguments: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["formfactor", *arguments])
    assert stopped.value.code == 2 and "lightgauge formfactor --help" in capsys.readouterr().err


def test_degeneracy_is_relative() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-9, 0.0]])
    faces = np.array([[0, 1, 2]], np.int32)
    assert not degenerate(triangle, faces)[0] and not degenerate(1e-12 * triangle, faces)[0]
    assert degenerate(triangle + np.array([1e8, 0.0, 1e8]), faces)[0], "its corners are rounded to 1e-8 there"
    assert degenerate(triangle[[0, 1, 1]], faces)[0]


def test_reading_says_nothing_about_good_files(folder: Path) -> None:
    said: list[str] = []
    mesh = read_mesh(folder / "ceiling.ply", "TO", said.append)
    assert said == [] and len(mesh.faces) == 2


def test_as_a_user_runs_it(folder: Path) -> None:
    """The whole program, start-up included, prints one object and nothing else."""
    code = "import sys; from lightgauge.validation.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, "formfactor", "floor.obj", "ceiling.ply", "--json"],
        capture_output=True, text=True, check=False, cwd=folder, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0 and done.stderr == ""
    assert json.loads(done.stdout)["value"] == pytest.approx(TRUTH)
