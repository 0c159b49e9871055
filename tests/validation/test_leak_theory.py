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
from lightgauge.reference.variant import ensure_variant
from lightgauge.validation.benchmarks.leak_rows import LEAK, lattices, right, stopped, tried
from lightgauge.validation.benchmarks.leak_scene import dark_places, leaky_shift, two_rooms
from lightgauge.validation.leaks.attribution import blamed
from lightgauge.validation.leaks.prediction import wall_points, wall_reports

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


def test_the_edit_stops_it() -> None:
    rooms = two_rooms(0.75, (0, 30, 0))
    edit = stopped(rooms, leaky_shift(rooms))
    assert edit.mean <= LEAK and 0 < edit.cells < 400


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
