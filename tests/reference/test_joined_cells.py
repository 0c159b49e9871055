"""Coplanar cells joined to larger blockers: the same surface, as few pieces as it has, and more pairs proved blocked."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.transport.closed_forms.cell_groups import group_codes
from lightgauge.reference.transport.closed_forms.joined_cells import joined_cells
from lightgauge.reference.transport.closed_forms.planar_cells import cell_areas
from lightgauge.reference.transport.closed_forms.polygon_clip import unit_normals
from lightgauge.reference.transport.closed_forms.shaft import build_blockers, classify
from lightgauge.reference.transport.closed_forms.shaft_walk import BLOCKED, CLEAR, MIXED

Array = npt.NDArray[Any]
RING = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def grid(corner: Array, along: Array, across: Array, n: int, m: int) -> Array:
    """A parallelogram cut into n by m cells (n m, 4, 3)."""
    i, j = (x.ravel() for x in np.indices((n, m)))
    at = np.stack([i, j], axis=1)[:, None, :] + RING
    return np.asarray(corner + at[..., :1] / n * along + at[..., 1:] / m * across)


def turned(seed: int) -> Array:
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (5, 3), (7, 7), (1, 6)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_grid_becomes_one_cell_again(shape: tuple[int, int], seed: int) -> None:
    """At any turn, wherever each cell's corners begin, in any order, with coordinates that are rounded."""
    rng, axes = np.random.default_rng(seed), turned(seed)
    cells = grid(axes[2] * 0.3, 1.3 * axes[0], 0.7 * axes[1] + 0.2 * axes[0], *shape)
    cells = np.stack([np.roll(c, rng.integers(4), axis=0) for c in cells])[rng.permutation(len(cells))]
    cells += rng.uniform(-1e-16, 1e-16, cells.shape)
    joined = joined_cells(cells)
    assert len(joined) == 1
    assert cell_areas(joined).sum() == pytest.approx(cell_areas(cells).sum(), rel=1e-12)
    np.testing.assert_allclose(unit_normals(joined), unit_normals(cells[:1]), atol=1e-12)


def test_what_is_not_one_rectangle_stays_apart() -> None:
    """Two walls at a corner, an L of three squares, a step of 1e-9 between neighbours, a triangle, and faces turned over."""
    x, y, z = np.eye(3)
    square = grid(np.zeros(3), x, y, 1, 1)
    assert len(joined_cells(np.concatenate([square, grid(np.zeros(3), y, z, 1, 1)]))) == 2
    corner = np.concatenate([square, square + x, square + y])
    assert len(joined_cells(corner)) == 2 and cell_areas(joined_cells(corner)).sum() == pytest.approx(3.0)
    assert len(joined_cells(np.concatenate([square, square + x + 1e-9 * z]))) == 2
    assert len(joined_cells(np.concatenate([square, square[:, ::-1] + x]))) == 2
    triangle = (square + x)[:, [0, 1, 2, 2]]
    np.testing.assert_array_equal(joined_cells(np.concatenate([square, triangle]))[1], triangle[0])


def test_a_wall_drawn_as_a_grid_blocks_as_a_whole() -> None:
    """Two squares on both sides of a wall of 36 cells, none of which covers the shaft; a third looks past it."""
    x, y, z = np.eye(3)
    wall = grid(-x - y, 2.0 * x, 2.0 * y, 6, 6)
    squares = np.concatenate([
        grid(-0.4 * x - 0.4 * y - z, 0.8 * x, 0.8 * y, 1, 1),
        grid(-0.4 * x - 0.4 * y + z, 0.8 * y, 0.8 * x, 1, 1),
        grid(5.0 * x + z, 0.8 * y, 0.8 * x, 1, 1),
    ])  # fmt: skip
    found = classify(build_blockers(wall), squares, np.full(3, 4), np.array([[0, 1], [1, 0], [0, 2]]))
    assert found[:2].tolist() == [BLOCKED, BLOCKED] and found[2] != BLOCKED


def test_groups_say_what_holds_for_their_cells() -> None:
    """Floor and ceiling of 16 × 16 cells, a wall of 3 × 3 between them: what groups prove, no pair of their cells contradicts."""
    x, y, z = np.eye(3)
    cells = np.concatenate([grid(np.zeros(3), 4.0 * x, 4.0 * y, 16, 16), grid(2.0 * z, 4.0 * y, 4.0 * x, 16, 16)])
    wall = grid(0.7 * x + 0.7 * y + z, 1.3 * x, 1.3 * y, 3, 3)
    blockers = build_blockers(np.concatenate([cells, wall]))
    group, codes = group_codes(blockers, cells, unit_normals(cells), 4.0)
    np.testing.assert_array_equal(codes, codes.T)
    a, b = np.random.default_rng(0).integers(256, size=(2, 3000))
    pairs = np.stack([a, b + 256], axis=1)
    said, alone = codes[group[pairs[:, 0]], group[pairs[:, 1]]], classify(blockers, cells, np.full(512, 4), pairs)
    for code in (CLEAR, MIXED):
        assert (said == code).sum() > 100
    assert (alone[said == CLEAR] == CLEAR).all() and (alone[said == BLOCKED] == BLOCKED).all()
    assert (codes[group[:256][:, None], group[None, :256]] == BLOCKED).all(), (
        "cells of one plane see nothing of each other"
    )
