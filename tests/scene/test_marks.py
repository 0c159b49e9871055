"""Marks and the bitmap file of a scene: read at the door, turned and scaled as the scene is, held by its hash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.bitmap_file import write_bitmap
from lightgauge.reference.datatypes import BitmapLayer, Scene
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
from scene_files import SQUARE, TOML, ply_text, write_toml

CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
POINTS = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


def write(folder: Path, kind: str, file: str, content: str, more: str = "") -> Path:
    (folder / file).write_text(content)
    return write_toml(folder, TOML + f'[marks.m]\nfile = "{file}"\nkind = "{kind}"\n' + more)


def layer(*cell: int, **more: Any) -> BitmapLayer:
    return BitmapLayer(np.zeros(3), 0.5, np.array([cell]), **more)


def test_the_three_kinds(tmp_path: Path) -> None:
    cube, sheet = ply_text(CUBE, SIDES), ply_text(SQUARE, [(0, 1, 2, 3)])
    (closed,) = load_scene(write(tmp_path, "closed", "a.ply", cube, "probe_size = 0.25\n")).marks
    assert closed.kind == "closed" and closed.name == "m" and closed.probe_size == 0.25
    assert closed.faces.shape == (12, 3) and closed.vertices.shape == (8, 3)
    (surface,) = load_scene(write(tmp_path, "surface", "a.ply", sheet)).marks
    assert surface.faces.shape == (2, 3) and surface.probe_size is None
    (mesh_points,) = load_scene(write(tmp_path, "points", "a.ply", sheet)).marks
    assert mesh_points.faces.shape == (0, 3) and mesh_points.vertices.tolist() == np.array(SQUARE).tolist()
    (points,) = load_scene(write(tmp_path, "points", "a.ply", POINTS + "0 1 2\n3 4 5\n")).marks
    assert points.vertices.tolist() == [[0, 1, 2], [3, 4, 5]]
    (points,) = load_scene(write(tmp_path, "points", "a.obj", "# cloud\nv 0 1 2\nv 3 4 5\n")).marks
    assert points.vertices.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert load_scene(write_toml(tmp_path)).marks == ()


def test_marks_are_scaled_and_turned_as_meshes_are(tmp_path: Path) -> None:
    path = write(tmp_path, "points", "a.ply", POINTS + "1 0 0\n0 2 0\n")
    (mark,) = load_scene(path, {"unit_m": 0.01, "scene": {"rotation": 90.0}}).marks
    np.testing.assert_allclose(mark.vertices, [[0, 0, -0.01], [0, 0.02, 0]], atol=1e-15)


def test_a_mark_is_mended_as_meshes_are_and_that_is_said(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, "closed", "a.ply", ply_text(CUBE, [*SIDES, SIDES[0]])))
    assert len(scene.marks[0].faces) == 12
    assert any("marks.m (a.ply): 2 duplicate faces removed" in note for note in scene.notes)


BAD = {
    "open": ("closed", "a.ply", ply_text(CUBE, SIDES[:-1]), ["marks.m (a.ply)", "watertight", 'kind = "surface"']),
    "another format": ("surface", "a.stl", "solid", ["marks.m.file", "expected a .ply or .obj", "a.stl"]),
    "points only, as a mesh": ("surface", "a.ply", POINTS + "0 1 2\n3 4 5\n", ["marks.m.file", "a.ply", "empty"]),
    "no points": ("points", "a.ply", POINTS.replace("vertex 2", "vertex 0"), ["marks.m.file", "no points"]),
    "no points in an OBJ": ("points", "a.obj", "o nothing\n", ["marks.m.file", "no points"]),
    "not a number": ("points", "a.ply", POINTS + "0 1 2\n3 nan 5\n", ["marks.m (a.ply)", "vertex 1 is not finite"]),
    "far": ("points", "a.ply", POINTS + "0 1 2\n3 4 5e30\n", ["marks.m (a.ply)", "vertex 1", "check unit_m"]),
    "half a file": ("points", "a.ply", POINTS + "0 1 2\n", ["marks.m.file", "a.ply", "fewer"]),
    "no area": ("surface", "a.ply", ply_text([SQUARE[0]] * 3, [(0, 1, 2)]), ["marks.m (a.ply)", "no area"]),
}


def refused(path: Path, *words: str, overrides: dict[str, Any] | None = None) -> None:
    with pytest.raises(InputError) as caught:
        load_scene(path, overrides)
    for word in words:
        assert word in str(caught.value), str(caught.value)


@pytest.mark.parametrize("name", BAD)
def test_bad_marks_are_refused(tmp_path: Path, name: str) -> None:
    kind, file, content, words = BAD[name]
    refused(write(tmp_path, kind, file, content), *words)


def test_settings_that_cannot_be(tmp_path: Path) -> None:
    good = ply_text(SQUARE, [(0, 1, 2, 3)])
    refused(write(tmp_path, "solid", "a.ply", good), "marks.m.kind")
    refused(write(tmp_path, "surface", "a.ply", good, "probe_size = 0\n"), "marks.m.probe_size")
    refused(write_toml(tmp_path, TOML + '[marks.m]\nfile = "../a.ply"\nkind = "points"\n'), "marks.m.file", "leaves")
    refused(
        write_toml(tmp_path, TOML + '[marks.m]\nfile = "no.ply"\nkind = "points"\n'), "marks.m.file", "no such file"
    )
    flat = "[volumes.v]\nmin = [0, 0, 0]\nmax = [1, 0, 1]\n"
    refused(write_toml(tmp_path, TOML + flat), "volumes.v", "max must exceed min on every axis")
    limit = "[limits.l]\nmin = [0, 0, 0]\nmax = [1, 1, 1]\n"
    refused(write_toml(tmp_path, TOML + limit), "limits.l", "finest, coarsest or both")
    refused(
        write_toml(tmp_path, TOML + limit + "finest = 2.0\ncoarsest = 1.0\n"), "limits.l", "coarsest must be at least"
    )


def hash_of(path: Path, **placement: Any) -> str:
    return load_scene(path, {"placement": placement}).content_hash


def test_the_hash_holds_marks_and_layers(tmp_path: Path) -> None:
    path = write(tmp_path, "points", "a.ply", POINTS + "0 1 2\n3 4 5\n")
    seen = [hash_of(path)]
    (tmp_path / "a.ply").write_text(POINTS + "0 1 2\n3 4 6\n")
    seen.append(hash_of(path))
    one, two = layer(0, 0, 0), layer(0, 0, 1)
    for layers in ([], [one], [two], [one, two], [two, one], [layer(0, 0, 0, mode="remove")]):
        write_bitmap(tmp_path / "edit.json", layers)
        seen.append(hash_of(path, bitmap=str(tmp_path / "edit.json")))
    assert len(set(seen)) == len(seen)
    assert hash_of(path, bitmap=str(tmp_path / "edit.json")) == seen[-1]


def test_where_the_bitmap_file_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene's own lies in its folder; the command line's is a path as typed, and takes its place."""
    (tmp_path / "scene").mkdir()
    (tmp_path / "else").mkdir()
    path = write_toml(tmp_path / "scene", TOML + '[placement]\nbitmap = "own.json"\n')
    refused(path, "placement.bitmap", "no such file")
    write_bitmap(tmp_path / "scene" / "own.json", [layer(1, 2, 3)])
    write_bitmap(tmp_path / "else" / "edit.json", [layer(4, 5, 6), layer(7, 8, 9)])
    monkeypatch.chdir(tmp_path / "else")

    def cells(scene: Scene) -> list[Any]:
        return [c.cells.tolist()[0] for c in scene.bitmap]

    assert cells(load_scene(path)) == [[1, 2, 3]]
    assert cells(load_scene(path, {"placement": {"bitmap": "edit.json"}})) == [[4, 5, 6], [7, 8, 9]]
    assert cells(load_scene(path, {"placement": {"bitmap": ""}})) == []
    refused(path, "placement.bitmap: own.json", "cannot be read", overrides={"placement": {"bitmap": "own.json"}})
    for name in ("../else/edit.json", str(tmp_path / "else" / "edit.json")):
        refused(write_toml(tmp_path / "scene", TOML + f'[placement]\nbitmap = "{name}"\n'), "leaves the scene's folder")
    (tmp_path / "scene" / "own.json").write_text("{}")
    path = write_toml(tmp_path / "scene", TOML + '[placement]\nbitmap = "own.json"\n')
    refused(path, "scene.toml: placement.bitmap", "own.json", "not a voxel bitmap")
