"""Layers of a bitmap file over the marks of a scene: on the octree's lattice and off it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lightgauge.reference.datatypes import BitmapLayer
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import Grid, cells, keys
from lightgauge.reference.placement.bitmap_layers import apply_layers, cell_voxels, covered
from lightgauge.reference.placement.marking import Marked

GRID = Grid(np.array([-3.37, 0.21, 10.1]), 0.3, 4, np.array([16, 11, 16]))


def every(level: int) -> np.ndarray:
    axes = [np.arange(n + 1) for n in GRID.last(level)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def full() -> Marked:
    return Marked(GRID, [keys(every(n)) for n in range(GRID.level + 1)])


def overlap(level: int, layer: BitmapLayer) -> np.ndarray:
    """Volume, m³, that voxels (N,) of a level share with each cell (M,): (N, M)."""
    size = GRID.size(level)
    low = (GRID.origin + every(level) * size)[:, None, :]
    cell = (layer.origin + layer.cells * layer.size)[None]
    edge = np.minimum(low + size, cell + layer.size) - np.maximum(low, cell)
    return np.clip(edge, 0.0, None).prod(axis=-1)


def shared(level: int, layer: BitmapLayer, there: np.ndarray) -> np.ndarray:
    """Share of each voxel (N,) of a level that lies in the cells that are `there` (n, n, n): axis by axis."""
    size, edges = GRID.size(level), []
    for axis, last in enumerate(GRID.last(level)):
        low = (GRID.origin[axis] + np.arange(last + 1) * size)[:, None]
        cell = (layer.origin[axis] + np.arange(len(there)) * layer.size)[None]
        edges.append(np.clip(np.minimum(low + size, cell + layer.size) - np.maximum(low, cell), 0.0, None) / size)
    return np.asarray(np.einsum("ai,bj,ck,ijk->abc", *edges, there.astype(float), optimize=True).ravel())


def off_lattice(size: float, seed: int, count: int, **more: Any) -> BitmapLayer:
    """Random cells; one at least lies within the grid."""
    rng = np.random.default_rng(seed)
    index = np.unique([[int(2 / size)] * 3, *rng.integers(-3, int(6 / size) + 3, (count, 3))], axis=0)
    return BitmapLayer(GRID.origin - rng.uniform(0, 1, 3), size, index, **more)


@pytest.mark.parametrize("level", range(5))
def test_cells_of_the_octrees_own_lattice_mark_themselves(level: int) -> None:
    """Whatever origin of the same lattice the file counts from."""
    wanted = every(level)[::3]
    for shift in (0, 7, -5):
        layer = BitmapLayer(GRID.origin + shift * GRID.size(level), GRID.size(level), wanted - shift)
        np.testing.assert_array_equal(cell_voxels(layer, GRID, level, "f"), keys(wanted))


@pytest.mark.parametrize("size", [0.3, 0.41, 0.25, 0.6, 0.85, 2.0])
def test_cells_off_the_lattice_mark_all_that_they_overlap(size: float) -> None:
    layer = off_lattice(size, 1, 40)
    level = GRID.level_for(size)
    got = np.isin(keys(every(level)), cell_voxels(layer, GRID, level, "f"))
    shared = overlap(level, layer).sum(axis=1)
    assert got[shared > 1e-4 * size**3].all() and not got[shared == 0].any() and got.sum() > 0


@pytest.mark.parametrize("size", [0.3, 0.41, 0.25, 0.6, 0.85, 2.0])
def test_what_cells_cover_wholly_is_removed(size: float) -> None:
    """Against the volume shared with all cells; four fifths of the cells are there, so many voxels are covered in part."""
    rng = np.random.default_rng(2)
    there = rng.random((int(8 / size),) * 3) < 0.8
    layer = BitmapLayer(GRID.origin - 0.77, size, np.argwhere(there), "remove")
    for level in range(GRID.level_for(size), GRID.level + 1):
        got = covered(layer, GRID, level, keys(every(level)))
        share = shared(level, layer, there)
        np.testing.assert_array_equal(got, share > 1 - 1e-6)
    assert got.any() and (size == 2.0 or not got.all())  # few cells of 2 m: all that lie here may be there


def test_removing_leaves_what_is_coarser_and_what_lies_elsewhere() -> None:
    marked = full()
    apply_layers(marked, [BitmapLayer(GRID.origin, 0.6, np.array([[1, 1, 1]]), "remove")], "f.json")
    for level in range(3):
        np.testing.assert_array_equal(marked.levels[level], keys(every(level)))
    gone = cells(np.setdiff1d(keys(every(3)), marked.levels[3]))
    assert gone.tolist() == [[1, 1, 1]]
    gone = cells(np.setdiff1d(keys(every(4)), marked.levels[4]))
    assert len(gone) == 8 and (gone // 2 == 1).all() and not marked.notes


def test_layers_count_in_order() -> None:
    cell = np.array([[2, 2, 2]])
    add, remove = BitmapLayer(GRID.origin, 0.3, cell), BitmapLayer(GRID.origin, 0.3, cell, "remove")
    for layers, expected in (([add, remove], 0), ([remove, add], 1)):
        marked = Marked.none(GRID)
        apply_layers(marked, layers, "f.json")
        assert marked.count == expected


def test_misses_and_cells_too_fine_are_noted() -> None:
    marked = full()
    layers = [
        BitmapLayer(np.array([500.0, 0, 0]), 0.3, np.zeros((5, 3), np.int64)),
        BitmapLayer(GRID.origin, 0.3, np.zeros((0, 3), np.int64)),
        BitmapLayer(GRID.origin, 0.05, np.zeros((1, 3), np.int64)),
        BitmapLayer(GRID.origin, 0.05, np.zeros((1, 3), np.int64), "remove"),
    ]
    apply_layers(marked, layers, "f.json")
    assert len(marked.notes) == 3
    assert marked.notes[0].startswith(
        "placement.bitmap f.json: layers[0]: marks no voxel, it lies outside of the octree (-3.37, 0.21, 10.1 to 1.43, 3.51, 14.9 m)"
    )
    assert marked.notes[2] == (
        "placement.bitmap f.json: the cell size is finer than the octree's finest voxel in layers[2] (0.05 m), layers[3] "
        "(0.05 m): voxels of 0.3 m there; to have them, set placement.min_voxel to 0.05"
    )
    assert len(marked.levels[4]) == len(every(4))  # nothing finer than a voxel removes one


def test_extreme_cells_neither_wrap_nor_hang() -> None:
    """Indices and sizes at the limits of the format."""
    far = np.array([[2**31 - 1] * 3, [-(2**31)] * 3, [0, 0, 0]])
    for size in (1e9, 1e-9, 0.3):
        for mode in ("add", "remove"):
            marked = full()
            apply_layers(marked, [BitmapLayer(GRID.origin, size, far, mode)], "f")  # type: ignore[arg-type]
            assert all(len(m) <= len(every(n)) for n, m in enumerate(marked.levels))


def test_too_many_voxels_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lightgauge.reference.placement.shape_voxels.MAX_VOXELS", 100)
    with pytest.raises(
        InputError, match=r"placement\.bitmap f: layers\[0\]: asks for \d+ voxels of 0.3 m, at most 100"
    ):
        apply_layers(Marked.none(GRID), [BitmapLayer(GRID.origin, 0.3, every(4))], "f")


def test_what_is_removed_is_placed_no_more() -> None:
    cell = np.array([[2, 2, 2]])
    place, remove = BitmapLayer(GRID.origin, 0.3, cell, "place"), BitmapLayer(GRID.origin, 0.3, cell, "remove")
    for layers, expected in (([place], 1), ([place, remove], 0), ([remove, place], 1)):
        marked = Marked.none(GRID)
        apply_layers(marked, layers, "f.json")
        assert sum(map(len, marked.placed.values())) == expected
