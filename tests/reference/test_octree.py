"""The octree against a brute-force twin, with the distance to surfaces replaced by a function."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from lightgauge.reference.config_placement import PlacementSettings
from lightgauge.reference.datatypes import F64, I64, Bool
from lightgauge.reference.errors import InputError
from lightgauge.reference.lattice import OCTANTS, Grid, Octree, cells, distinct, keys
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


def build(
    monkeypatch: pytest.MonkeyPatch, bitmap: VoxelBitmap, touched: Sequence[I64] = (), **settings: object
) -> Octree:
    monkeypatch.setattr(octree, "nearer_than", lambda g, p, key, limit, rays, seed: to_a_wall(p) < limit)
    return build_octree(None, GRID, bitmap, PlacementSettings.model_validate(settings), 1, touched)  # type: ignore[arg-type]


def is_close(voxel: I64, level: int, threshold: float) -> bool:
    size = GRID.size(level)
    return bool(to_a_wall(GRID.origin + (voxel + OCTANTS) * size).min() < threshold * size)


def twin(bitmap: VoxelBitmap, threshold: float) -> list[set[tuple[int, ...]]]:
    """Voxel by voxel: it is close if its parent is, the bitmap holds it, and a corner is near."""
    levels: list[set[tuple[int, ...]]] = [{(0, 0, 0)}]
    for level in range(1, GRID.level + 1):
        held = set(bitmap.occupied[level].tolist())
        children = [2 * np.array(parent) + o for parent in levels[-1] for o in OCTANTS]
        found = [v for v in children if int(keys(v[None])[0]) in held and is_close(v, level, threshold)]
        levels.append({tuple(v.tolist()) for v in found})
    return levels


def plain_twin(bitmap: VoxelBitmap, threshold: float) -> list[set[tuple[int, ...]]]:
    """All eight children, within the bounds, of every close voxel that holds something marked on the next level."""
    levels: list[set[tuple[int, ...]]] = [{(0, 0, 0)}]
    for level, close in enumerate(twin(bitmap, threshold)[:-1], start=1):
        marked = {tuple(c >> 1) for c in cells(bitmap.occupied[level])}
        children = [2 * np.array(v) + o for v in close & marked for o in OCTANTS]
        levels.append({tuple(v.tolist()) for v in children if (v <= GRID.last(level)).all()})
    return levels


def corners_of(levels: Sequence[Iterable[tuple[int, ...]]]) -> dict[tuple[int, ...], int]:
    """Each corner on the finest lattice with its coarsest level."""
    found: dict[tuple[int, ...], int] = {}
    for level, voxels in enumerate(levels):
        for v in voxels:
            for o in OCTANTS:
                found.setdefault(tuple(((np.array(v) + o) << (GRID.level - level)).tolist()), level)
    return found


def with_holes(seed: int) -> VoxelBitmap:
    full, rng = everything(GRID), np.random.default_rng(seed)
    return VoxelBitmap(tuple(k[rng.random(len(k)) < 0.8] if i > 2 else k for i, k in enumerate(full.occupied)))


@pytest.mark.parametrize("threshold", [0.7, 2.0])
@pytest.mark.parametrize("bitmap", [everything(GRID), with_holes(0)], ids=["full", "holes"])
def test_both_schemes_equal_their_brute_force_twins(
    monkeypatch: pytest.MonkeyPatch, bitmap: VoxelBitmap, threshold: float
) -> None:
    """Voxels and probes of both; either run counts the probes of plain subdivision."""
    wanted = {"child-only": twin(bitmap, threshold), "plain": plain_twin(bitmap, threshold)}
    plain = len(corners_of(wanted["plain"]))
    for subdivision, levels in wanted.items():
        tree = build(monkeypatch, bitmap, threshold=threshold, subdivision=subdivision)
        for level, voxels in enumerate(tree.voxels):
            assert set(map(tuple, voxels.tolist())) == levels[level], (subdivision, level)
            assert (np.diff(keys(voxels)) > 0).all()
            assert not level or np.isin(keys(voxels >> 1), keys(tree.voxels[level - 1])).all()
        corners = corners_of(levels)
        assert [tuple(c) for c in tree.corners.tolist()] == sorted(corners)
        assert tree.corner_level.tolist() == [corners[tuple(c)] for c in tree.corners.tolist()]
        assert tree.plain_probes == plain
        np.testing.assert_allclose(tree.positions, GRID.origin + tree.corners * 0.5)
    assert 0 < len(wanted["child-only"][-1]) < 32 * 20 * 9 / 2
    assert len(corners_of(wanted["child-only"])) < 0.95 * plain


def test_nothing_near_leaves_the_root_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(octree, "nearer_than", lambda g, p, key, limit, rays, seed: np.zeros(len(p), bool))
    tree = build_octree(None, GRID, everything(GRID), PlacementSettings(), 1)  # type: ignore[arg-type]
    assert [len(v) for v in tree.voxels] == [1, 0, 0, 0, 0, 0]
    assert len(tree.corners) == 8 and (tree.corner_level == 0).all()


def test_what_touches_is_close_whatever_its_corners_see(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one voxel of the finest level and its ancestors touched: they exist, and change nothing elsewhere."""
    lone = np.array([[30, 18, 8]])
    touched = [keys(lone >> (GRID.level - level)) for level in range(GRID.level + 1)]
    before = build(monkeypatch, everything(GRID), threshold=0.7)
    after = build(monkeypatch, everything(GRID), touched, threshold=0.7)
    assert not np.isin(touched[-1], keys(before.voxels[-1])).any()
    for level in range(GRID.level + 1):
        expected = distinct(np.concatenate([keys(before.voxels[level]), touched[level]]))
        np.testing.assert_array_equal(keys(after.voxels[level]), expected)


@pytest.mark.parametrize("subdivision", ["child-only", "plain"])
def test_too_many_probes_are_refused(monkeypatch: pytest.MonkeyPatch, subdivision: str) -> None:
    """And the size that the message names needs as many as it says."""
    full = everything(GRID)
    with pytest.raises(InputError, match=r"placement\.max_probes is 600; placement\.min_voxel = ") as caught:
        build(monkeypatch, full, threshold=2.0, max_probes=600, subdivision=subdivision)
    size, probes = re.findall(r"min_voxel = (\S+), and no probe_size under it, needs about (\d+);", str(caught.value))[
        0
    ]
    level = round(GRID.level - math.log2(float(size) / GRID.finest))
    coarse = VoxelBitmap((*full.occupied[: level + 1], *(full.occupied[0][:0] for _ in range(level, GRID.level))))
    tree = build(monkeypatch, coarse, threshold=2.0, subdivision=subdivision)
    assert len(tree.corners) == int(probes) <= 600


def test_a_flood_of_voxels_is_refused_between_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is asked is near: the first round of the last level already shows more voxels than probes allowed."""
    asked: list[int] = []

    def near(g: object, p: F64, key: I64, limit: float, rays: int, seed: int) -> Bool:
        asked.append(len(p))
        return np.ones(len(p), np.bool_)

    monkeypatch.setattr(octree, "nearer_than", near)
    with pytest.raises(InputError, match="need 5760 probes or more"):
        build_octree(None, GRID, everything(GRID), PlacementSettings(max_probes=5000), 1)  # type: ignore[arg-type]
    assert len(asked) == GRID.level, "one round a level: every voxel is near by its first corner"


@pytest.mark.parametrize("threshold", [0.7, 2.0])
def test_a_corner_is_asked_once_a_level_and_no_more_once_it_is_far(
    monkeypatch: pytest.MonkeyPatch, threshold: float
) -> None:
    """By its key and position; far by a wider limit means far by a narrower one. Fewer are asked than the voxels have."""
    asked: list[tuple[I64, F64, float]] = []

    def spy(g: object, p: F64, key: I64, limit: float, rays: int, seed: int) -> Bool:
        np.testing.assert_allclose(p, GRID.origin + cells(key) * GRID.finest)
        asked.append((key, p, limit))
        return to_a_wall(p) < limit

    monkeypatch.setattr(octree, "nearer_than", spy)
    tree = build_octree(None, GRID, everything(GRID), PlacementSettings(threshold=threshold), 1)  # type: ignore[arg-type]
    at = [(k, limit) for key, _, limit in asked for k in key.tolist()]
    assert len(set(at)) == len(at) == tree.corners_tested
    far: set[int] = set()
    for key, p, limit in asked:
        assert not far & set(key.tolist())
        far |= set(key[to_a_wall(p) >= limit].tolist())
    every = sum(len(corners_of([*[()] * level, _tested(tree, level)])) for level in range(1, GRID.level + 1))
    assert len(at) < 0.8 * every


def _tested(tree: Octree, level: int) -> list[tuple[int, ...]]:
    return [tuple(2 * v + o) for v in tree.voxels[level - 1] for o in OCTANTS]


def test_uniform_counts() -> None:
    tree = uniform_octree(GRID)
    x, y, z = GRID.extent
    assert len(tree.voxels[-1]) == x * y * z
    assert len(tree.corners) == (x + 1) * (y + 1) * (z + 1)
    assert (tree.corner_level == GRID.level).all()
    assert [len(v) for v in tree.voxels] == [1, 2 * 2 * 1, 4 * 3 * 2, 8 * 5 * 3, 16 * 10 * 5, 32 * 20 * 9]
    for level in range(1, GRID.level + 1):
        assert np.isin(keys(tree.voxels[level] >> 1), keys(tree.voxels[level - 1])).all()
