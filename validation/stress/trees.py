"""Octrees and textures made of numbers alone, and the seams between their sides: for the cases of the virtual texture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F32, I64
from ...reference.lattice import NEIGHBOURS, OCTANTS, Grid, Octree, keys, unique_cells
from ...reference.placement.subdivision import NOTHING, corner_keys
from ...reference.texture_types import Storage, VirtualTexture
from ...reference.volume.indirection import build_indirection
from ...reference.volume.layout import TileLayout, build_layout
from ...reference.volume.tiles import PARENT_WEIGHTS, fill_tiles

Cells = npt.NDArray[np.integer]
NODES, SPACING = (
    5,
    3,
)  # of `masks_tree`: the level of the chosen nodes, and nodes from one to the next: their tiles never meet


@dataclass(frozen=True, eq=False)
class Filled:
    """A tree, its tiles, the probes' texels (R, 13) f32, and the texture that these fill."""

    tree: Octree
    layout: TileLayout
    probes: F32
    texture: VirtualTexture

    def stored(self, storage: Storage) -> VirtualTexture:
        """Filled in another storage format."""
        return dataclasses.replace(self.texture, texels=fill_tiles(self.layout, self.probes, storage))

    def holding(self, texels: F32) -> VirtualTexture:
        """With other texels."""
        return dataclasses.replace(self.texture, texels=texels)


def tree_of(levels: Sequence[Cells]) -> Octree:
    """An octree over all of the root, of voxels (N, 3) per level, the finest 1 m."""
    top = len(levels) - 1
    grid = Grid(np.zeros(3), 1.0, top, np.full(3, 1 << top, dtype=np.int64))
    voxels = [unique_cells(np.asarray(v, dtype=np.int64).reshape(-1, 3)) for v in levels]
    placed = NOTHING
    for level, cell in enumerate(voxels):
        placed = placed.plus(corner_keys(grid, level, keys(cell)))
    corners, level_of = placed.corners()
    return Octree(grid, tuple(voxels), corners, level_of, 0)


def every_cell(level: int) -> I64:
    """All cells (8^level, 3) of a level."""
    return np.stack(np.meshgrid(*[np.arange(1 << level)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def masks_tree() -> Octree:
    """Levels 0 … 7: everything to level 5; there 256 nodes, one for each set of children; every other child has all its own."""
    n = np.arange(256)
    node = 3 + SPACING * np.stack([n // 32, n // 4 % 8, n % 4], axis=1)
    chosen, octant = np.nonzero((n[:, None] >> np.arange(8)) & 1)
    children = 2 * node[chosen] + OCTANTS[octant]
    finer = children[(np.arange(len(children)) + chosen) % 2 == 0]
    return tree_of(
        [*(every_cell(i) for i in range(NODES + 1)), children, (2 * finer[:, None] + OCTANTS).reshape(-1, 3)]
    )


def lone_branch(depth: int) -> Octree:
    """One voxel a level, all touching the root's middle from one side: beyond it lies a voxel of level 1, `depth` - 1 coarser."""
    voxels: list[I64] = [np.zeros((1, 3), dtype=np.int64)]
    for level in range(depth):
        voxels.append(2 * voxels[-1] + OCTANTS[7 if level else 0])
    return tree_of(voxels)


def random_tree(levels: int, share: float, seed: np.random.Generator | Sequence[int]) -> Octree:
    """Every voxel to level 1, then each child with probability `share`, and always one of them."""
    rng = np.random.default_rng(seed)
    voxels: list[I64] = [np.zeros((1, 3), dtype=np.int64), OCTANTS]
    for _ in range(2, levels + 1):
        children = (2 * voxels[-1][:, None, :] + OCTANTS[None]).reshape(-1, 3)
        keep = rng.random(len(children)) < share
        keep[0] = True
        voxels.append(children[keep])
    return tree_of(voxels)


def random_probes(count: int, invalid: float, rng: np.random.Generator) -> F32:
    """Texels (count, 13) of probes with light of 0.5 … 1.5, a share of them invalid: light and weight 0."""
    valid = rng.random(count) >= invalid
    return np.concatenate([(rng.random((count, 12)) + 0.5) * valid[:, None], valid[:, None]], axis=1).astype(np.float32)


def filled(tree: Octree, probes: F32, layout: TileLayout | None = None) -> Filled:
    """The virtual texture of a tree with these probes."""
    tiles, grid = layout or build_layout(tree), tree.grid
    texels = fill_tiles(tiles, probes)
    texture = VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, build_indirection(tiles), texels)
    return Filled(tree, tiles, probes, texture)


def facing(ring: int) -> I64:
    """The (N, 3) neighbours of a voxel, itself included, that share with it a face (ring 1), also an edge (2), also a corner
    (3)."""
    return NEIGHBOURS[np.abs(NEIGHBOURS).sum(axis=1) <= ring]


def longest_chain(layout: TileLayout) -> int:
    """The most virtual probes that hang one on another, coarse to fine."""
    depth = np.where(layout.probe[0] < 0, 1, 0)
    longest = int(depth.max())
    for i in range(1, len(layout.probe)):
        above = depth[layout.parent_tile[i]]
        used = PARENT_WEIGHTS[layout.octant[i]] > 0.0
        deepest = np.where(used, above[:, None, :], 0).max(axis=2)
        depth = np.where(layout.probe[i] < 0, deepest + 1, 0)
        longest = max(longest, int(depth.max()))
    return longest
