"""Tiles, virtual voxels, and the seams between them: all 256 child masks (failure-catalogue D1, D2, D3)."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference import tiling
from lightgauge.reference.datatypes import F32, F64, I64, Bool
from lightgauge.reference.lattice import NEIGHBOURS, OCTANTS, Octree, cells, index_of, keys
from lightgauge.reference.placement.octree import uniform_octree
from lightgauge.reference.texture_types import VirtualTexture
from lightgauge.reference.volume.layout import TEXEL_OFFSETS, TileLayout, build_layout
from lightgauge.reference.volume.sampler import MIN_WEIGHT, resolve
from lightgauge.reference.volume.tiles import PARENT_WEIGHTS
from small_scenes import masked_tree, random_probes, random_tree, texture_of, tree_of

SIDES = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float32)
NODES = 5  # the level of the nodes whose children are chosen
SPACING = 3  # nodes from one chosen to the next: tiles of two never meet


def masks_tree(neighbours: float) -> Octree:
    """Levels 0 … 7: everything to level 5; there 256 nodes, one for each set of children. Every other child has all of its own
    children. neighbours: share of the nodes next to a chosen one that are subdivided, too."""
    rng = np.random.default_rng(1)
    full = np.stack(np.meshgrid(*[np.arange(1 << NODES)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    bits = (np.arange(256)[:, None] >> np.arange(8)) & 1
    node, octant = np.nonzero(bits)
    children = 2 * chosen_nodes()[node] + OCTANTS[octant]
    finer = children[(np.arange(len(children)) + node) % 2 == 0]
    beside = (chosen_nodes()[:, None] + NEIGHBOURS).reshape(-1, 3)
    beside = beside[(NEIGHBOURS != 0).any(axis=1)[np.arange(len(beside)) % 27] & (rng.random(len(beside)) < neighbours)]
    beside = (2 * beside[:, None] + OCTANTS)[rng.random((len(beside), 8)) < 0.5]
    levels = [
        full[: 8**level] if level == 0 else np.unique(full >> (NODES - level), axis=0) for level in range(NODES + 1)
    ]
    return tree_of([*levels, np.concatenate([children, beside]), (2 * finer[:, None] + OCTANTS).reshape(-1, 3)])


def chosen_nodes() -> I64:
    """The 256 nodes, (256, 3), away from the ends of the grid; node n has the children of the bits of n."""
    n = np.arange(256)
    return 3 + SPACING * np.stack([n // 32, n // 4 % 8, n % 4], axis=1)


def lattice_points(first: int, last: int, step: int, seed: int) -> list[tuple[F32, list[int]]]:
    """Points on a cubic lattice over [first, last]³: its corners, one on each of its edges and of its faces, each with the axes
    along which sides meet there."""
    ticks, rng = np.arange(first, last + 1, step), np.random.default_rng(seed)
    found = []
    for free in ([], [0], [1], [2], [0, 1], [0, 2], [1, 2]):
        axes = [ticks[:-1] if axis in free else ticks for axis in range(3)]
        p = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
        p[:, free] += step * rng.uniform(0.05, 0.95, (len(p), len(free))).astype(np.float32)
        found.append((p, [axis for axis in range(3) if axis not in free]))
    return found


def jumps(texture: VirtualTexture, q: F32, across: list[int]) -> tuple[F64, Bool]:
    """At points q (N, 3) in finest voxels, where sides meet along the axes `across`: the largest relative difference of light /
    weight between sides (N,), and whether they answer at unlike levels (N,)."""
    answers, levels = [], []
    end = texture.extent.astype(np.float32)
    for side in SIDES[(np.delete(SIDES, across, axis=1) > 0).all(axis=1)]:
        look = q.copy()
        look[:, across] += np.float32(0.01) * side[across]
        light, weight, level = resolve(texture, q, np.clip(look, 0, end), texture.level)
        answers.append(light.astype(np.float64) / np.maximum(weight, MIN_WEIGHT)[:, None])
        levels.append(level)
    stacked = np.stack(answers)
    scale = np.abs(stacked).max(axis=(0, 2)) + 1e-3
    return np.ptp(stacked, axis=0).max(axis=1) / scale, (np.stack(levels) != levels[0]).any(axis=0)


def worst_jump(texture: VirtualTexture, points: list[tuple[F32, list[int]]]) -> tuple[float, int]:
    """Over all points: the largest jump, and at how many the sides are of unlike levels."""
    found = [jumps(texture, q, across) for q, across in points]
    return max(float(jump.max()) for jump, _ in found), sum(int(unlike.sum()) for _, unlike in found)


def everywhere(texture: VirtualTexture, most: int, seed: int) -> list[tuple[F32, list[int]]]:
    """Corners, edges and faces of the whole finest lattice but its outside, `most` of each kind."""
    rng = np.random.default_rng(seed)
    kinds = lattice_points(1, (1 << texture.level) - 1, 1, seed)
    return [(q[rng.choice(len(q), min(most, len(q)), replace=False)], across) for q, across in kinds]


@pytest.mark.parametrize(("invalid", "neighbours"), [(0.35, 0.0), (0.0, 0.5)])
def test_all_child_masks_are_seam_free(invalid: float, neighbours: float) -> None:
    """failure-catalogue D1, D3: 256 nodes, one for each set of children, in a bigger tree. Corners, edges and faces of all voxels of
    the node, of its children and grandchildren, and (where its neighbours have none) of the virtual voxels around it."""
    tree = masks_tree(neighbours)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), invalid, 1))
    node = (chosen_nodes() << 2).astype(np.float32)
    near = lattice_points(0, 4, 1, 1) + (lattice_points(-2, 6, 2, 2) + lattice_points(-4, 8, 4, 3)) * (neighbours == 0)
    worst, mixed = np.zeros(256), np.zeros(256, np.int64)
    for q, across in near:
        jump, unlike = jumps(texture, (node[:, None] + q).reshape(-1, 3), across)
        worst = np.maximum(worst, jump.reshape(256, -1).max(axis=1))
        mixed += unlike.reshape(256, -1).sum(axis=1)
    assert worst.max() < 2e-6, f"children {worst.argmax():08b}: {worst.max()}"
    assert (mixed > 15).sum() > 250, "the borders between levels were not met"


@pytest.mark.parametrize("invalid", [0.0, 0.3])
def test_random_trees_are_seam_free(invalid: float) -> None:
    tree = random_tree(6, 0.4, 1)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), invalid, 1))
    jump, across = worst_jump(texture, everywhere(texture, 8_000, 1))
    assert across > 2000
    assert jump < (2e-5 if invalid else 2e-6)


def lone_branch(depth: int) -> Octree:
    """One voxel a level, all at the root's centre from one side: on the other sides lies the root's own voxel."""
    voxels = [np.zeros((1, 3), np.int64)]
    for level in range(depth):
        voxels.append(2 * voxels[-1] + OCTANTS[7 if level else 0])
    return tree_of(voxels)


def test_no_grading_is_needed() -> None:
    """failure-catalogue D2: levels may jump by any number, since virtual voxels bring each level to its neighbours. A branch of
    single voxels jumps by six; 2:1 grading would add real voxels, and no point agrees better for it."""
    tree = lone_branch(6)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.0, 2))
    coarsest = np.zeros((1 << 6,) * 3, np.int64)
    for level, v in enumerate(tree.voxels):
        (x, y, z), n = v[0] << (6 - level), 1 << (6 - level)
        coarsest[x : x + n, y : y + n, z : z + n] = level
    steps = [np.abs(np.diff(coarsest, axis=axis)).max() for axis in range(3)]
    assert max(steps) == 6, "the tree is graded: the test shows nothing"
    q = lattice_points(1, 63, 1, 0)
    home = tree.voxels[-1][0].astype(np.float32)
    close = [(p[(np.abs(p - home) < 12).all(axis=1)], across) for p, across in q]
    jump, across = worst_jump(texture, close)
    assert across > 500 and jump < 2e-6
    assert _chain(layout) >= 5, "virtual probes of virtual probes of virtual probes"


def _chain(layout: TileLayout) -> int:
    """The longest chain of virtual probes that hang on virtual ones alone or with others; every step goes one level up, to a
    tile that is filled before."""
    depth = [np.where(layout.probe[0] < 0, 1, 0)]
    for i in range(1, len(layout.probe)):
        holder = layout.parent_tile[i]
        assert (layout.first_slot[i - 1] + holder < layout.first_slot[i]).all() and (holder >= 0).all()
        above = depth[i - 1][holder]
        deepest = np.zeros(layout.probe[i].shape, np.int64)
        for octant in range(8):
            mine = layout.octant[i] == octant
            used = PARENT_WEIGHTS[octant] > 0
            deepest[mine] = np.where(used, above[mine][:, None, :], 0).max(axis=2)
        depth.append(np.where(layout.probe[i] < 0, deepest + 1, 0))
    return max(int(d.max()) for d in depth)


@pytest.mark.parametrize("most", [0, 1])
def test_fewer_neighbours_do_make_seams(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """The tests above can fail: with virtual voxels on no side, or on 6 sides only, there are seams of over 1 %. (18 sides
    do here what 26 do: whole tiles are filled, and tiles that meet in a point only share a probe of the parent's lattice.)"""
    monkeypatch.setattr(tiling, "OCTANTS", OCTANTS[OCTANTS.sum(axis=1) <= most])
    tree = masked_tree(0b10010110)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 1))
    assert worst_jump(texture, everywhere(texture, 4_000, 0))[0] > 0.01


def test_virtual_probes_are_the_parents_trilinear_values() -> None:
    """Every texel without a real probe, by hand from the tile one level up, weight included."""
    tree = random_tree(4, 0.5, 7)
    probes = random_probes(len(tree.corners), 0.3, 7)
    texture, layout = texture_of(tree, probes)
    found = 0
    for level in range(2, tree.grid.level + 1):
        above = {tuple(p): layout.first_slot[level - 2] + i for i, p in enumerate(layout.parents[level - 2].tolist())}
        for i, parent in enumerate(layout.parents[level - 1]):
            tile = texture.texels[layout.first_slot[level - 1] + i]
            coarse = texture.texels[above[tuple((parent >> 1).tolist())]].reshape(3, 3, 3, 13).astype(np.float64)
            base = parent & 1
            for t in np.flatnonzero(layout.probe[level - 1][i] < 0):
                f = TEXEL_OFFSETS[t] / 2
                expected = np.zeros(13)
                for o in OCTANTS:
                    expected += np.prod(np.where(o, f, 1 - f)) * coarse[tuple(base + o)]
                np.testing.assert_allclose(tile[t], expected, atol=1e-6)
                found += 1
    assert found > 1000


def test_real_probes_stand_where_they_stand() -> None:
    tree = random_tree(4, 0.5, 8)
    probes = random_probes(len(tree.corners), 0.2, 8)
    texture, layout = texture_of(tree, probes)
    corner_keys = keys(tree.corners)
    seen = np.zeros(len(probes), bool)
    for level in range(1, 5):
        for i, parent in enumerate(layout.parents[level - 1]):
            corner = (2 * parent + TEXEL_OFFSETS) << (4 - level)
            at = index_of(corner_keys, keys(corner))
            np.testing.assert_array_equal(layout.probe[level - 1][i], at)
            np.testing.assert_array_equal(
                texture.texels[layout.first_slot[level - 1] + i][at >= 0], probes[at[at >= 0]]
            )
            seen[at[at >= 0]] = True
    assert seen.all()


def test_first_level_virtual_probes_come_from_the_root() -> None:
    """A root with one child: the rest of the root is interpolated from its own 8 probes, not dark."""
    for child in ([[0, 0, 0]], np.zeros((0, 3), np.int64)):
        tree = tree_of([[[0, 0, 0]], np.asarray(child)])
        probes = np.ones((len(tree.corners), 13), np.float32)
        texture, _ = texture_of(tree, probes)
        np.testing.assert_allclose(texture.texels[0], 1.0, err_msg=f"child {child}")


def test_tiles_surround_every_voxel() -> None:
    """Each neighbour (26) of an existing voxel has a tile of its level; each tile has its parent's."""
    tree = random_tree(5, 0.4, 3)
    layout = build_layout(tree)
    for level in range(1, 6):
        have = keys(layout.parents[level - 1])
        assert (np.diff(have) > 0).all()
        around = (tree.voxels[level][:, None] + NEIGHBOURS[None]).reshape(-1, 3)
        around = around[((around >= 0) & (around < 1 << level)).all(axis=1)]
        assert np.isin(keys(around >> 1), have).all()
        needed = np.unique(keys(around >> 1))
        assert len(have) == len(needed), "tiles that nobody needs"
        if level > 1:
            parent = layout.parents[level - 2][layout.parent_tile[level - 1]]
            np.testing.assert_array_equal(parent, layout.parents[level - 1] >> 1)
            np.testing.assert_array_equal(layout.octant[level - 1], (layout.parents[level - 1] & 1) @ [4, 2, 1])


def test_virtual_probes_are_counted_once() -> None:
    tree = random_tree(4, 0.4, 5)
    layout = build_layout(tree)
    real = {tuple(c) for c in tree.corners.tolist()}
    for level in range(1, 5):
        corner = ((2 * layout.parents[level - 1][:, None] + TEXEL_OFFSETS) << (4 - level)).reshape(-1, 3)
        assert layout.virtual_by_level[level - 1] == len({tuple(c) for c in corner.tolist()} - real)


def test_uniform_grid_has_no_virtual_probe_inside() -> None:
    from lightgauge.reference.lattice import Grid

    tree = uniform_octree(Grid(np.zeros(3), 1.0, 3, np.full(3, 8)))
    layout = build_layout(tree)
    assert layout.virtual_probes == 0 and layout.tiles == 1 + 8 + 64


def test_a_level_jump_is_refused() -> None:
    tree = tree_of([[[0, 0, 0]], OCTANTS, np.zeros((0, 3), np.int64), [[0, 0, 0]], [[9, 9, 9]]])
    with pytest.raises(AssertionError, match="level jump"):
        build_layout(tree)
    assert cells(keys(tree.corners)).shape == tree.corners.shape
