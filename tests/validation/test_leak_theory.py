"""Two rooms, turned or not: they leak exactly where t < h (|nx| + |ny| + |nz|), and the edit found stops it.

Rationale: failure-catalogue C7. The whole matrix is `lightgauge bench placement`; here a corner of it.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.bitmap_file import read_bitmap, write_bitmap
from lightgauge.reference.datatypes import BitmapLayer
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import keys
from lightgauge.reference.progress import silent
from lightgauge.reference.variant import ensure_variant
from lightgauge.validation.benchmarks.leak_rows import lattices, right, tried
from lightgauge.validation.benchmarks.leak_scene import (
    all_over,
    dark_places,
    leaky_shift,
    tip_shift,
    two_rooms,
)
from lightgauge.validation.leaks import edit as edit_module
from lightgauge.validation.leaks import smallest as smallest_module
from lightgauge.validation.leaks.attribution import blamed
from lightgauge.validation.leaks.edit import find_edit
from lightgauge.validation.leaks.field import Places, joined, part, places
from lightgauge.validation.leaks.prediction import wall_points, wall_reports
from lightgauge.validation.leaks.search import Edit, Search
from lightgauge.validation.leaks.single import single_edits
from lightgauge.validation.leaks.smallest import smallest
from lightgauge.validation.leaks.tips import askew_edges

ensure_variant()


@pytest.mark.parametrize(("thickness", "turn"), [(0.75, (0, 0, 0)), (1.25, (0, 30, 0)), (1.5, (0, 45, 0))])
def test_leaks_exactly_where_predicted(thickness: float, turn: tuple[float, float, float]) -> None:
    rooms = two_rooms(thickness, turn)
    assert rooms.keeps_light_in == (thickness >= {0: 1.0, 30: 1.366, 45: 1.4143}[turn[1]])
    found = [tried(rooms, shift) for shift in lattices(rooms, 5)]
    assert right(rooms, found), found


def test_every_wall_of_the_scene_is_predicted() -> None:
    """Turned by 30°, walls of 1.2 voxels: upright ones need 0.88, floors and ceilings 1.2."""
    rooms = two_rooms(1.2, (0, 30, 0))
    field = rooms.field(np.full(3, 0.4))
    points = wall_points(rooms.scene, field.geometry, field.octree, field.texture, field.lift, 0)
    dark, flat = points.mesh == 2, np.abs(points.normals[:, 1]) > 0.5
    upright, level = dark & ~flat, dark & flat
    np.testing.assert_allclose(points.need[upright], 1.2 / 1.36603, atol=1e-4)
    np.testing.assert_allclose(points.need[level], 1.2, atol=1e-4)
    usual = points.voxel == 1.0
    assert points.leaks[upright].all() and not points.leaks[level & usual].any() and usual[dark].mean() > 0.5
    rows = {row.mesh: row for row in wall_reports(rooms.scene, points, field.lift)}
    room = rows["dark_room"]
    assert room.area_m2 == pytest.approx(2 * (4 * 3 + 4 * 3 + 3 * 3), rel=1e-6)
    assert room.leak_share == pytest.approx(42 / 66, abs=0.05) and not room.sheet
    assert room.needed_voxel_lifted_m == pytest.approx((1.2 + 0.5) / 1.36603, abs=1e-4)


def test_edges_askew_leak_behind_thick_walls() -> None:
    """Turned by 30°, walls of 2 voxels, thick enough by far: an edge that pokes in by a fiftieth of a voxel is lit by voxels of twice
    the size, and at exactly the places that half-spaces say."""
    rooms = two_rooms(2.0, (0, 30, 0))
    assert rooms.keeps_light_in and rooms.askew and not rooms.leak_free_everywhere
    found = tried(rooms, tip_shift(rooms, 13))
    assert found.dead > 0 and found.own == 0 and found.wrong == 0, found


def test_the_edit_stops_it_and_has_no_cell_too_many() -> None:
    rooms = two_rooms(0.5, (0, 0, 0))
    shift = leaky_shift(rooms)
    field = rooms.field(shift)
    search = rooms.search(field, dark_places(rooms, field, 1, 500), shift)
    edit = find_edit(search, silent)
    fresh = places(all_over(rooms, 77, 4000), None, "fresh")
    assert edit.minimal and not search.leaks(edit.field, fresh).leaks.any()
    assert 0 < 2 * edit.cells < edit.grown
    layer = edit.layers[0]
    assert len(edit.layers) == 1
    for number in (
        0,
        edit.cells // 2,
        edit.cells - 1,
    ):  # without any one of them it leaks, in the cell itself or beside it
        less = search.rebake([dataclasses.replace(layer, cells=np.delete(layer.cells, number, axis=0))])
        share = np.random.default_rng(number).uniform(-1.0, 2.0, (4000, 3))
        near = layer.origin + (layer.cells[number] + share) * layer.size
        near = near[rooms.dark.inside(near)]
        beside = places(near, None, "beside")
        assert search.leaks(less, beside).leaks.any() and not search.leaks(edit.field, beside).leaks.any()


def test_an_edit_made_too_small_is_mended_and_stays_minimal(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is made smaller by places in the lower half of the room alone leaks in the upper one; told so, the next try has the cells
    that these need and no others. To put all back that is beside them would leave 73 of 153 cells, 44 are enough."""
    rooms = two_rooms(0.5, (0, 0, 0))
    shift = leaky_shift(rooms)
    field = rooms.field(shift)
    at = dark_places(rooms, field, 1, 500)
    grown: list[Edit] = []
    monkeypatch.setattr(edit_module, "DRAWS", 1)
    monkeypatch.setattr(edit_module, "smallest", lambda _, edit, *__: grown.append(edit) or edit)
    search = rooms.search(field, at, shift)
    find_edit(search, silent)
    lower = np.flatnonzero(grown[0].places.positions[:, 1] < 0.5 * (rooms.dark.lower + rooms.dark.upper)[1])
    monkeypatch.setattr(smallest_module, "_inside", lambda *_: joined([]))
    left: list[int] = []

    def fresh(search: Search, tried: Edit, number: int) -> Places:
        bad = np.flatnonzero(search.leaks(tried.field, at).leaks)
        left.append(len(bad))
        return part(at, bad)

    few = dataclasses.replace(grown[0], places=part(grown[0].places, lower))
    found = smallest(search, few, joined([]), fresh, silent)
    assert left[0] > 0 and left[-1] == 0 and found.minimal and 3 * found.cells < few.cells
    assert not search.leaks(found.field, grown[0].places).leaks.any()


def test_one_cell_stops_it_at_one_place() -> None:
    """Each cell laid over the scene alone: the place that it is for is dark, and with the cell of twice the size, were that finer than
    the lattice, it would not be."""
    rooms = two_rooms(0.25, (0, 0, 0))
    shift = leaky_shift(rooms)
    field = rooms.field(shift)
    at = dark_places(rooms, field, 1, 200)
    search = rooms.search(field, at, shift)
    leaks = search.leaks(field, at)
    chosen = np.flatnonzero(leaks.leaks)[::90][:3]
    sizes = []
    for number, found in zip(chosen, single_edits(search, at, leaks, chosen), strict=True):
        assert found.layer is not None
        sizes.append(found.layer.size)
        here = part(at, np.array([number, number]))
        assert not search.leaks(search.rebake([found.layer]), here).leaks.any()
        larger = dataclasses.replace(found.layer, size=2 * found.layer.size, cells=found.layer.cells >> 1)
        assert search.leaks(search.rebake([larger]), here).leaks.all()
    assert max(sizes) < 1.0


def test_askew_edges_are_found_in_meshes() -> None:
    square, turned_room = two_rooms(1.0, (0, 0, 0)), two_rooms(1.0, (0, 30, 0))
    assert len(askew_edges(square.surfaces.geometry)[0]) == 0
    ends, normals = askew_edges(turned_room.surfaces.geometry)
    assert len(ends) == 8  # the upright ones of both rooms; outside, edges are ridges
    np.testing.assert_allclose(np.abs(ends[:, 1] - ends[:, 0]), np.tile([0.0, 3.0, 0.0], (8, 1)), atol=1e-4)
    inside = ends.mean(axis=1) + 0.1 * normals.sum(axis=1)
    assert (turned_room.dark.inside(inside) | turned_room.lit.inside(inside)).all()


def test_blame_falls_on_probes_behind_the_wall() -> None:
    rooms = two_rooms(0.5, (0, 0, 0))
    shift = leaky_shift(rooms)
    field = rooms.field(shift)
    at = dark_places(rooms, field, 1, 200)
    leaks = rooms.search(field, at, shift).leaks(field, at)
    pairs = leaks.pairs
    assert leaks.leaks.any() and blamed(leaks).any()
    outside = ~rooms.dark.inside(field.octree.positions[pairs.weights.probe])
    assert outside[blamed(leaks)].all()
    assert np.array_equal(pairs.unseen, outside)  # the room is convex: what is not in it is not seen
    place, crossing = at.positions[pairs.weights.sample], pairs.crossing
    assert (
        np.linalg.norm(crossing - np.clip(crossing, rooms.dark.lower, rooms.dark.upper), axis=1)[outside] < 1e-4
    ).all()
    assert rooms.dark.inside(place).all()


def test_a_finer_layer_deepens_the_octree_there_alone(tmp_path: Path) -> None:
    """A cell of a quarter of min_voxel: everything else, sample offset included, stays as it is without it."""
    rooms = two_rooms(1.0, (0, 0, 0))
    plain = pipeline.place(rooms.scene, rooms.surfaces, 3, 0.3)
    cell = np.array([[21, 9, 11]])
    write_bitmap(tmp_path / "edit.json", [BitmapLayer(plain.grid.origin, 0.25, cell, "place")])
    scene = dataclasses.replace(rooms.scene, bitmap=read_bitmap(tmp_path / "edit.json"))
    deep = pipeline.place(scene, rooms.surfaces, 3, 0.3)
    assert deep.grid.level == plain.grid.level + 2 and deep.grid.finest == 0.25
    assert (deep.grid.wanted, deep.grid.wanted_level) == (plain.grid.finest, plain.grid.level)
    assert deep.voxels[-1].tolist() == cell.tolist() and deep.voxels[-2].tolist() == (cell >> 1).tolist()
    for level, voxels in enumerate(plain.voxels[:-1]):
        assert np.array_equal(deep.voxels[level], voxels)
    extra = np.setdiff1d(keys(deep.voxels[plain.grid.level]), keys(plain.voxels[-1]))
    assert len(extra) <= 1  # the cell's own holder, where no surface is near
    with pytest.raises(InputError, match=r"octree levels, at most 16"):
        pipeline.place(
            dataclasses.replace(rooms.scene, bitmap=(BitmapLayer(plain.grid.origin, 1e-5, cell, "place"),)), rooms.surfaces, 3
        )  # fmt: skip
