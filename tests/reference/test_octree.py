"""The octree against a brute-force twin, with the distance to surfaces replaced by a function."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.config_placement import PlacementSettings
from lightgauge.reference.datatypes import F64
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import OCTANTS, Grid, Octree, keys
from lightgauge.reference.placement import octree
from lightgauge.reference.placement.octree import build_octree, uniform_octree
from lightgauge.reference.placement.voxel_bitmap import VoxelBitmap

GRID = Grid(np.array([-0.1, 0.2, 0.3]), 0.5, 5, np.array([32, 20, 9]))


def to_a_wall(positions: F64) -> F64:
    """A made-up distance: a slanted wall, a pole, and a region from which nothing is ever hit."""
    wall = 4 * np.abs(positions @ np.array([0.6, 0.8, 0.0]) - 5.0)
    pole = 3 * np.linalg.norm(positions[:, [0, 2]] - [12.0, 3.0], axis=1)
    return np.where(positions[:, 1] > 8.0, np.inf, np.minimum(wall, pole))


def everything(grid: Grid) -> VoxelBitmap:
    occupied = []
    for level in range(grid.level + 1):
        limit = (grid.extent - 1) >> (grid.level - level)
        axes = np.meshgrid(*[np.arange(n + 1) for n in limit], indexing="ij")
        occupied.append(np.sort(keys(np.stack(axes, -1).reshape(-1, 3))))
    return VoxelBitmap(tuple(occupied))


def build(monkeypatch: pytest.MonkeyPatch, bitmap: VoxelBitmap, **settings: object) -> Octree:
    monkeypatch.setattr(octree, "harmonic_mean", lambda g, p, rays, seed: to_a_wall(p))
    return build_octree(None, GRID, bitmap, PlacementSettings.model_validate(settings), 1)  # type: ignore[arg-type]


def twin(bitmap: VoxelBitmap, threshold: float) -> list[set[tuple[int, int, int]]]:
    """Voxel by voxel: it exists if its parent does, the bitmap holds it, and a corner is near."""
    levels = [{(0, 0, 0)}]
    for level in range(1, GRID.level + 1):
        size = GRID.size(level)
        found = set()
        for x, y, z in levels[-1]:
            for o in OCTANTS:
                voxel = 2 * np.array([x, y, z]) + o
                corners = GRID.origin + (voxel + OCTANTS) * size
                near = to_a_wall(corners).min() < threshold * size
                if near and int(keys(voxel[None])[0]) in set(bitmap.occupied[level].tolist()):
                    found.add(tuple(voxel.tolist()))
        levels.append(found)
    return levels


@pytest.mark.parametrize("threshold", [0.7, 2.0])
def test_equals_the_brute_force_twin(monkeypatch: pytest.MonkeyPatch, threshold: float) -> None:
    full = everything(GRID)
    rng = np.random.default_rng(0)
    holes = VoxelBitmap(tuple(k[rng.random(len(k)) < 0.8] if i > 2 else k for i, k in enumerate(full.occupied)))
    for bitmap in (full, holes):
        tree = build(monkeypatch, bitmap, threshold=threshold)
        expected = twin(bitmap, threshold)
        for level, voxels in enumerate(tree.voxels):
            assert set(map(tuple, voxels.tolist())) == expected[level], level
            assert (np.diff(keys(voxels)) > 0).all()
    assert 0 < len(tree.voxels[-1]) < 32 * 20 * 9 / 2


def test_children_have_parents_and_corners_are_those_of_voxels(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = build(monkeypatch, everything(GRID), threshold=2.0)
    corners: dict[tuple[int, int, int], int] = {}
    for level, voxels in enumerate(tree.voxels):
        if level:
            assert np.isin(keys(voxels >> 1), keys(tree.voxels[level - 1])).all()
        for v in voxels:
            for o in OCTANTS:
                corners.setdefault(tuple(((v + o) << (GRID.level - level)).tolist()), level)
    assert [tuple(c) for c in tree.corners.tolist()] == sorted(corners)
    assert tree.corner_level.tolist() == [corners[tuple(c)] for c in tree.corners.tolist()]
    np.testing.assert_allclose(tree.positions, GRID.origin + tree.corners * 0.5)
    assert len(tree.corners) <= tree.corners_tested + 8


def test_nothing_near_leaves_the_root_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(octree, "harmonic_mean", lambda g, p, rays, seed: np.full(len(p), np.inf))
    tree = build_octree(None, GRID, everything(GRID), PlacementSettings(), 1)  # type: ignore[arg-type]
    assert [len(v) for v in tree.voxels] == [1, 0, 0, 0, 0, 0]
    assert len(tree.corners) == 8 and (tree.corner_level == 0).all()


def test_too_many_probes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"placement\.max_probes is 100"):
        build(monkeypatch, everything(GRID), threshold=2.0, max_probes=100)


def test_every_corner_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[F64] = []

    def spy(g: object, p: F64, rays: int, seed: int) -> F64:
        asked.append(p)
        return to_a_wall(p)

    monkeypatch.setattr(octree, "harmonic_mean", spy)
    tree = build_octree(None, GRID, everything(GRID), PlacementSettings(), 1)  # type: ignore[arg-type]
    every = np.concatenate(asked).round(6)
    assert len(np.unique(every, axis=0)) == len(every) == tree.corners_tested


def test_uniform_counts() -> None:
    tree = uniform_octree(GRID)
    x, y, z = GRID.extent
    assert len(tree.voxels[-1]) == x * y * z
    assert len(tree.corners) == (x + 1) * (y + 1) * (z + 1)
    assert (tree.corner_level == GRID.level).all()
    assert [len(v) for v in tree.voxels] == [1, 2 * 2 * 1, 4 * 3 * 2, 8 * 5 * 3, 16 * 10 * 5, 32 * 20 * 9]
    for level in range(1, GRID.level + 1):
        assert np.isin(keys(tree.voxels[level] >> 1), keys(tree.voxels[level - 1])).all()
