"""The flattened octree against a search for the finest tile, and its bit budget (failure-catalogue E6)."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import Grid, Octree
from lightgauge.reference.volume.indirection import build_indirection, cache_shape, pack, slot_offset
from lightgauge.reference.volume.layout import build_layout
from small_scenes import random_tree


@pytest.mark.parametrize("extent", [(16, 16, 16), (16, 9, 5)])
def test_equals_a_search_for_the_finest_tile(extent: tuple[int, int, int]) -> None:
    tree = random_tree(4, 0.4, 1)
    grid = Grid(tree.grid.origin, 1.0, 4, np.array(extent))
    keep = [v[(v <= (grid.extent - 1) >> (4 - level)).all(axis=1)] for level, v in enumerate(tree.voxels)]
    layout = build_layout(Octree(grid, tuple(keep), tree.corners, tree.corner_level, 0))
    found = build_indirection(layout)
    tiles = [
        {tuple(p): layout.first_slot[i] + n for n, p in enumerate(level.tolist())}
        for i, level in enumerate(layout.parents)
    ]
    for lod in range(1, 5):
        dims = found.dims[lod - 1]
        assert (dims == ((grid.extent - 1) >> (4 - lod + 1)) + 1).all()
        texels = found.texels[found.first[lod - 1] : found.first[lod]].reshape(dims)
        for cell in np.ndindex(*dims):
            level = lod
            while tuple(c >> (lod - level) for c in cell) not in tiles[level - 1]:
                level -= 1
            slot = tiles[level - 1][tuple(c >> (lod - level) for c in cell)]
            t = int(texels[cell])
            assert t >> 24 == level
            cx, cy, _ = found.cache
            assert (t & 255) + cx * ((t >> 8 & 255) + cy * (t >> 16 & 255)) == slot


def test_offsets_and_levels_beyond_eight_bits_are_errors() -> None:
    assert pack(np.array([[255, 1, 2]]), 255)[0] == 255 | 1 << 8 | 2 << 16 | 255 << 24
    for bad in ([256, 0, 0], [0, 256, 0], [0, 0, 256], [-1, 0, 0]):
        with pytest.raises(ValueError, match="tile offset must be 0 … 255"):
            pack(np.array([bad]), 1)
    for level in (256, -1):
        with pytest.raises(ValueError, match="level must be 0 … 255"):
            pack(np.array([[0, 0, 0]]), level)


@pytest.mark.parametrize("tiles", [1, 2, 7, 8, 9, 27, 28, 1000, 1001, 16_384, 256**2 * 255 + 1, 256**3 - 1, 256**3])
def test_cache_shape_holds_the_tiles_within_the_budget(tiles: int) -> None:
    shape = cache_shape(tiles)
    assert shape.prod() >= tiles and shape.max() <= 256 and shape.min() >= 1
    assert shape.prod() <= 2 * tiles + 8
    last = slot_offset(np.array([0, tiles - 1]), shape)
    assert (last >= 0).all() and (last < shape).all()


def test_too_many_tiles_are_refused() -> None:
    with pytest.raises(InputError, match=r"tile cache needs 16777217 tiles.*placement\.min_voxel"):
        cache_shape(256**3 + 1)


def test_slots_are_x_fastest_and_distinct() -> None:
    shape = np.array([4, 3, 2])
    offsets = slot_offset(np.arange(24), shape)
    assert offsets[:5].tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0, 1, 0]]
    assert len({tuple(o) for o in offsets.tolist()}) == 24
