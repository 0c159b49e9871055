"""The voxel bitmap as a whole: marks of every kind on one lattice, limits, a file laid over, notes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from lightgauge.reference.datatypes import BitmapLayer, Mark, Scene
from lightgauge.reference.lattice import Grid, cells, keys, make_grid
from lightgauge.reference.placement.voxel_bitmap import VoxelBitmap, build_bitmap
from small_scenes import box, quad, scene, sphere_mesh

GRID = make_grid(np.zeros(3), np.full(3, 4.0), 0.125)


def holds(bitmap: VoxelBitmap, level: int, point: tuple[float, float, float], grid: Grid = GRID) -> bool:
    cell = np.floor((np.array([point]) - grid.origin) / grid.size(level)).astype(int)
    return bool(bitmap.holds(level, cell)[0])


def with_marks(s: Scene, *marks: Mark) -> Scene:
    return dataclasses.replace(s, marks=marks)


def ball(name: str, kind: Any, centre: tuple[float, float, float], probe_size: float | None) -> Mark:
    m = sphere_mesh(0.6, 2, inward=False)
    faces = np.zeros((0, 3), np.int32) if kind == "points" else m.faces
    return Mark(name, kind, m.vertices + np.array(centre), faces, probe_size)


def test_levels_are_aligned() -> None:
    """A mesh marked coarsely and one marked finely: parents of marked voxels are marked, and each mesh marks no finer level
    than it asks for."""
    coarse = box((0, 0, 0), (1, 1, 1), probe_size=0.5)
    fine = quad([[3, 0, 3], [3, 0, 3.5], [3.5, 0, 3.5], [3.5, 0, 3]], probe_size=0.125)
    hidden = box((1.5, 1.5, 1.5), (2, 2, 2), inward=False, lit_by_probes=False)
    s = scene(
        [coarse, fine, hidden], volumes={"v": {"min": (2.2, 2.2, 0.2), "max": (2.4, 2.4, 0.4), "probe_size": 0.25}}
    )
    bitmap = build_bitmap(with_marks(s, ball("b", "surface", (3.0, 3.0, 3.0), 0.25)), GRID, 0.0)
    for level in range(1, GRID.level + 1):
        parents = keys(cells(bitmap.occupied[level]) >> 1)
        assert np.isin(parents, bitmap.occupied[level - 1]).all()
        assert (cells(bitmap.occupied[level]) <= GRID.last(level)).all()
        assert (np.diff(bitmap.occupied[level]) > 0).all()
    top = GRID.level
    assert holds(bitmap, top, (3.2, 0.0, 3.2)) and not holds(bitmap, top, (0.0, 0.3, 0.3))
    assert holds(bitmap, top - 2, (0.0, 0.3, 0.3))
    assert holds(bitmap, top - 1, (2.3, 2.3, 0.3)) and not holds(bitmap, top, (2.3, 2.3, 0.3))
    assert not holds(bitmap, top, (1.5, 1.7, 1.7)) and not holds(bitmap, top - 2, (1.7, 1.7, 1.7))
    assert holds(bitmap, top - 1, (3.0, 3.0, 2.41)) and not holds(bitmap, top, (3.0, 3.0, 2.41))
    assert bitmap.notes == ()


def test_marks_of_the_three_kinds() -> None:
    """Inside, on the surface and between the points of a ball."""
    centre, top = (2.0, 2.0, 2.0), GRID.level
    found = {k: build_bitmap(with_marks(scene([]), ball("m", k, centre, None)), GRID, 0.3)
             for k in ("surface", "closed", "points")}  # fmt: skip
    count = {k: len(b.occupied[top]) for k, b in found.items()}
    assert holds(found["closed"], top, centre) and not holds(found["surface"], top, centre)
    assert np.isin(found["surface"].occupied[top], found["closed"].occupied[top]).all()
    assert np.isin(found["points"].occupied[top], found["surface"].occupied[top]).all()
    assert 0 < count["points"] < count["surface"] < count["closed"]
    # A ball of 0.6 m takes 463 voxels' worth of room; what it touches beyond lies within a voxel's diagonal.
    assert 4 / 3 * np.pi * 0.57**3 < count["closed"] * 0.125**3 < 4 / 3 * np.pi * (0.6 + 0.217) ** 3


def test_a_file_is_laid_over_last() -> None:
    """It adds inside a limit, and removes what a mesh marked; both have the last word."""
    floor = quad([[0, 1, 0], [0, 1, 4], [4, 1, 4], [4, 1, 0]], probe_size=0.125)
    everywhere = {"l": {"min": (-1, -1, -1), "max": (5, 5, 5), "finest": 0.5}}
    s = scene([floor], limits=everywhere)
    assert not len(build_bitmap(s, GRID, 0.0).occupied[-1])
    fine = BitmapLayer(GRID.origin, 0.125, np.array([[9, 9, 9]]))
    s = dataclasses.replace(s, bitmap=(fine,))
    assert cells(build_bitmap(s, GRID, 0.0).occupied[-1]).tolist() == [[9, 9, 9]]
    # One cell of a quarter of the scene: what the floor marks in it goes, with the ancestors that hold nothing else.
    gone = BitmapLayer(GRID.origin, 2.0, np.array([[0, 0, 0]]), "remove")
    left = build_bitmap(dataclasses.replace(s, bitmap=(gone,)), GRID, 0.0)
    for level in range(2, GRID.level - 1):
        corner = GRID.origin + cells(left.occupied[level]) * GRID.size(level)
        assert len(corner) and not ((corner - GRID.origin) < 2.0).all(axis=1).any()


def test_what_misses_or_is_too_fine_is_noted() -> None:
    meshes = [quad([[0, 1, 0], [0, 1, 4], [4, 1, 4], [4, 1, 0]], name=f"m{i}", probe_size=0.01) for i in range(7)]
    s = with_marks(
        scene(meshes, volumes={"fog": {"min": (1, 1, 1), "max": (2, 2, 2), "probe_size": 0.02}}),
        ball("far", "closed", (90.0, 2.0, 2.0), None), ball("near", "points", (2.0, 2.0, 2.0), None),
    )  # fmt: skip
    notes = build_bitmap(s, GRID, 0.0).notes
    assert len(notes) == 2
    assert notes[0].startswith("marks.far: marks no voxel, it lies outside of the octree (-0.04775, ")
    assert notes[1] == (
        "probe_size is finer than the octree's finest voxel in meshes.m0 (0.01 m), meshes.m1 (0.01 m), meshes.m2 (0.01 m), "
        "meshes.m3 (0.01 m), meshes.m4 (0.01 m) and 3 more: voxels of 0.125 m there; to have them, set placement.min_voxel to 0.01"
    )
    # Half an octave is rounding, not a size the octree lacks.
    assert build_bitmap(scene([quad(meshes[0].vertices, probe_size=0.09)]), GRID, 0.0).notes == ()


def test_an_empty_bitmap_is_noted() -> None:
    s = dataclasses.replace(
        scene([quad([[0, 1, 0], [0, 1, 4], [4, 1, 4], [4, 1, 0]])]),
        bitmap=(BitmapLayer(np.full(3, -64.0), 128.0, np.array([[0, 0, 0]]), "remove"),),
    )
    bitmap = build_bitmap(s, GRID, 0.0)
    assert not any(map(len, bitmap.occupied[:-1])) and bitmap.notes[-1].startswith("the voxel bitmap is empty")
