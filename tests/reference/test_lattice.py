"""Grid, keys and lookups."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import (
    OCTANTS,
    Grid,
    cells,
    child_keys,
    distinct,
    finer_keys,
    index_of,
    keys,
    make_grid,
    parent_keys,
    parities,
    steps,
    unique_cells,
)


def test_keys_are_ordered_and_invertible() -> None:
    c = np.random.default_rng(0).integers(-1, (1 << 20) - 1, (2000, 3))
    np.testing.assert_array_equal(cells(keys(c)), c)
    order = np.lexsort((c[:, 2], c[:, 1], c[:, 0]))
    assert (np.diff(keys(c)[order]) >= 0).all()


def test_arithmetic_on_keys_is_that_of_cells() -> None:
    """Up to the last cell that has a key, where a carry would spill into the next coordinate."""
    c = np.random.default_rng(1).integers(0, 1 << 19, (2000, 3))
    c[:8] = OCTANTS * ((1 << 19) - 1)
    k = keys(c)
    np.testing.assert_array_equal(cells(parent_keys(k)), c >> 1)
    np.testing.assert_array_equal(cells(finer_keys(keys(c >> 5), 5)), c >> 5 << 5)
    np.testing.assert_array_equal(cells(child_keys(k)), (2 * c[:, None] + OCTANTS).reshape(-1, 3))
    np.testing.assert_array_equal(parities(k), steps(c & 1))
    for by in ([-1, 1, -1], [1, -1, 1], [0, 0, -1], [7, 0, -0]):
        inside = (c + by >= -1).all(axis=1)
        np.testing.assert_array_equal(cells(k + steps(np.array([by])))[inside], (c + by)[inside])


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_distinct(count: int) -> None:
    k = np.random.default_rng(2).integers(0, 300, count)
    assert distinct(k).tolist() == sorted(set(k.tolist()))


def test_unique_and_index() -> None:
    c = np.array([[1, 2, 3], [0, 0, 1], [1, 2, 3]])
    assert unique_cells(c).tolist() == [[0, 0, 1], [1, 2, 3]]
    assert index_of(np.array([3, 5, 9]), np.array([9, 4, 3, 99, -1])).tolist() == [2, -1, 0, -1, -1]
    assert index_of(np.zeros(0, np.int64), np.array([1, 2])).tolist() == [-1, -1]


@pytest.mark.parametrize("size", [0.1, 0.25, 1.0, 7.0, None])
def test_the_grid_covers_the_bounds_and_is_shifted_off_them(size: float | None) -> None:
    lower, upper = np.array([-3.0, 1.0, 2.0]), np.array([4.0, 1.5, 2.0])
    g = make_grid(lower, upper, size)
    top = g.origin + g.extent * g.finest
    assert (g.origin < lower).all() and (top > upper).all()
    assert g.extent.max() <= 1 << g.level and (g.level == 1 or g.extent.max() > 1 << (g.level - 1))
    # no lattice plane lies in a wall of the bounds
    for wall in (lower, upper):
        offset = (wall - g.origin) / g.finest
        assert np.abs(offset - np.round(offset)).max() < 0.51
    assert np.abs((lower - g.origin) / g.finest - 0.381966).max() < 1e-12


def test_too_many_levels_are_refused_with_the_way_out() -> None:
    with pytest.raises(InputError, match=r"placement\.min_voxel.*at most 16"):
        make_grid(np.zeros(3), np.full(3, 1000.0), 1e-3)
    make_grid(np.zeros(3), np.full(3, 1000.0), 1000 / 2**15)


def test_level_for_rounds_in_octaves() -> None:
    g = Grid(np.zeros(3), 0.25, 5, np.full(3, 32))
    assert [g.level_for(s) for s in (0.25, 0.3, 0.36, 0.5, 0.01, 1e9)] == [5, 5, 4, 4, 5, 0]
    assert [g.size(n) for n in (5, 4, 0)] == [0.25, 0.5, 8.0]
