"""Which tiles there are, against a search over all neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import NEIGHBOURS, Grid, cells, keys, unique_cells
from lightgauge.reference.tiling import indirection_dims, tile_parents

GRID = Grid(np.zeros(3), 1.0, 5, np.array([32, 19, 7]))


@pytest.mark.parametrize("level", [1, 2, 3, 5])
@pytest.mark.parametrize("count", [0, 1, 40])
def test_tiles_cover_the_26_neighbours_within_the_bounds(level: int, count: int) -> None:
    rng = np.random.default_rng(level)
    voxels = unique_cells(rng.integers(0, GRID.last(level) + 1, (count, 3)))
    voxels[:1] = 0 * voxels[:1]  # one at the border
    expected = {(0, 0, 0)} if level == 1 else set()
    for v in voxels:
        for n in v + NEIGHBOURS:
            parent = n >> 1
            if (parent >= 0).all() and (parent <= GRID.last(level - 1)).all() and level > 1:
                expected.add(tuple(parent.tolist()))
    found = tile_parents(GRID, level, keys(unique_cells(voxels)))
    assert [tuple(c) for c in cells(found).tolist()] == sorted(expected)


def test_a_level_of_detail_has_a_texel_for_each_voxel_above() -> None:
    assert indirection_dims(GRID).tolist() == [[1, 1, 1], [2, 2, 1], [4, 3, 1], [8, 5, 2], [16, 10, 4]]
