"""Limits: no marked voxel of the box finer than `finest`, none coarser than `coarsest`, nothing changed outside of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lightgauge.reference.lattice import Grid, cells, keys, parent_keys
from lightgauge.reference.placement.limits import overlapping
from lightgauge.reference.placement.marking import mark_scene
from lightgauge.reference.placement.voxel_bitmap import VoxelBitmap, build_bitmap
from lightgauge.reference.turned import turned_boxes
from small_scenes import quad, scene

GRID = Grid(np.full(3, -0.1), 0.25, 5, np.array([30, 20, 30]))
FLOOR = [[0, 0, 0], [0, 0, 7], [7, 0, 7], [7, 0, 0]]
# Its borders lie across voxels of every size.
BOX = {"min": [1.3, -1.0, 2.2], "max": [4.1, 3.0, 5.3]}


def made(probe_size: float, limits: dict[str, Any], **more: Any) -> VoxelBitmap:
    return build_bitmap(scene([quad(FLOOR, probe_size=probe_size)], limits=limits, **more), GRID, 0.0)


def samples(lower: Any, upper: Any, n: int = 4000) -> np.ndarray:
    return np.random.default_rng(5).uniform(lower, upper, (n, 3))


def finest_at(bitmap: VoxelBitmap, points: np.ndarray) -> np.ndarray:
    """The finest level whose voxel at each point is occupied, -1 where none is."""
    found = np.full(len(points), -1)
    for level in range(GRID.level + 1):
        cell = np.floor((points - GRID.origin) / GRID.size(level)).astype(np.int64)
        found[bitmap.holds(level, cell)] = level
    return found


@pytest.mark.parametrize("turn", [0.0, 30.0])
@pytest.mark.parametrize("finest", [0.5, 1.0, 0.7, 3.0])
def test_no_finer(finest: float, turn: float) -> None:
    limits = {"l": BOX | {"finest": finest}}
    free, held = made(0.25, {}, scene={"rotation": turn}), made(0.25, limits, scene={"rotation": turn})
    box = turned_boxes(scene([], limits=limits).settings.limits.values(), turn)[0]
    allowed = max(level for level in range(GRID.level + 1) if GRID.size(level) >= finest)
    for level in range(GRID.level + 1):
        inside = overlapping(GRID, level, held.occupied[level], box)
        assert GRID.size(level) >= finest or not inside.any()
        # Farther out than the largest voxel that is not allowed, nothing is lost.
        centre = GRID.origin + (cells(free.occupied[level]) + 0.5) * GRID.size(level)
        outside = ~box.touches_cubes(centre, 0.5 * GRID.size(level) + 0.5 * GRID.size(allowed))
        assert np.isin(free.occupied[level][outside], held.occupied[level]).all()
    points = samples([0, -0.09, 0], [7, 0.1, 7])
    marked = finest_at(free, points) == GRID.level
    mine = marked & box.inside(points)
    assert mine.sum() > 200 and (finest_at(held, points)[mine] == allowed).all()


@pytest.mark.parametrize("turn", [0.0, 30.0])
@pytest.mark.parametrize("coarsest", [0.25, 0.5, 0.6])
def test_no_coarser(coarsest: float, turn: float) -> None:
    limits = {"l": BOX | {"coarsest": coarsest}}
    free, held = made(2.0, {}, scene={"rotation": turn}), made(2.0, limits, scene={"rotation": turn})
    box = turned_boxes(scene([], limits=limits).settings.limits.values(), turn)[0]
    points = samples([0, -0.09, 0], [7, 1.5, 7])
    before, after = finest_at(free, points), finest_at(held, points)
    asked = (before == GRID.level_for(2.0)) & box.inside(points)
    wanted = min(level for level in range(GRID.level + 1) if GRID.size(level) <= coarsest)
    assert asked.sum() > 100 and (after[asked] == wanted).all()
    # Finer voxels are marked only where they overlap the box and something was marked; elsewhere all is as it was.
    for level in range(GRID.level + 1):
        fresh = held.occupied[level][~np.isin(held.occupied[level], free.occupied[level])]
        assert overlapping(GRID, level, fresh, box).all()
        if level > GRID.level_for(2.0):
            up = fresh
            for _ in range(level - GRID.level_for(2.0)):
                up = parent_keys(up)
            assert np.isin(up, free.occupied[GRID.level_for(2.0)]).all()
    # The largest voxel that can be new holds one that overlaps the box, and is half as large as the mark.
    clear = ~box.touches_cubes(points, 1.0)
    np.testing.assert_array_equal(after[clear], before[clear])


def test_a_border_on_the_lattice_is_not_crossed() -> None:
    """A box made of whole voxels changes these and no neighbour."""
    low = GRID.origin + np.array([4, 0, 4]) * 0.5
    limits = {"l": {"min": low.tolist(), "max": (low + 2.0).tolist(), "finest": 0.5}}
    free, held = made(0.25, {}), made(0.25, limits)
    gone = cells(np.setdiff1d(free.occupied[-1], held.occupied[-1])) * 0.25
    assert len(gone) and (gone >= [2.0, 0.0, 2.0]).all() and (gone < [4.0, 2.0, 4.0]).all()
    assert len(gone) == 8 * 8


def test_between_two_sizes_and_in_order() -> None:
    """One limit may hold both ways. Where limits overlap the later has the last word."""
    both = {"l": BOX | {"finest": 0.5, "coarsest": 0.5}}
    points = samples([1.4, -0.09, 2.3], [4.0, 0.1, 5.2], 500)
    for size in (0.25, 2.0):
        at = finest_at(made(size, both), points)
        assert (at == GRID.level - 1).all()
    assert (finest_at(made(2.0, {"a": BOX | {"coarsest": 0.25}, "b": BOX | {"finest": 1.0}}), points) == 3).all()
    assert (finest_at(made(2.0, {"b": BOX | {"finest": 1.0}, "a": BOX | {"coarsest": 0.25}}), points) == 5).all()


def test_what_cannot_be_is_noted() -> None:
    fine = made(2.0, {"l": BOX | {"coarsest": 0.1}})
    assert fine.notes == (
        "limits.l.coarsest: 0.1 m is finer than the octree's finest voxel: voxels of 0.25 m there; to have them, set "
        "placement.min_voxel to 0.1",
    )
    between = made(2.0, {"l": BOX | {"finest": 0.6, "coarsest": 0.9}})
    assert (
        len(between.notes) == 1 and "between finest 0.6 and coarsest 0.9 m, so voxels are 1 m there" in between.notes[0]
    )
    away = made(2.0, {"l": {"min": [0, 3, 0], "max": [1, 4, 1], "finest": 1.0}})
    assert away.notes == ("limits.l: nothing is marked in it, so it changes nothing; move it or remove it",)
    assert made(2.0, {"l": BOX | {"finest": 1.0}}).notes == ()


def test_limits_hold_marks_of_every_kind() -> None:
    volume = {"v": {"min": [2, 0.6, 3], "max": [3, 1.4, 4], "probe_size": 0.25}}
    s = scene([quad(FLOOR, probe_size=1.0)], volumes=volume, limits={"l": BOX | {"finest": 1.0}})
    assert len(mark_scene(s, GRID, 0.0).levels[-1]) and not len(build_bitmap(s, GRID, 0.0).occupied[-1])
    assert build_bitmap(s, GRID, 0.0).holds(3, np.array([[2, 0, 3]]))[0]
    assert len(keys(np.zeros((0, 3), np.int64))) == 0
