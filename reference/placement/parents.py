"""What would replace a probe: the interpolation within its parent voxel, one level up (talk, "Virtual probes").

A corner of level l lies on the edges, faces or in the middle of voxels of level l - 1, up to four of them; all give the same
interpolation. A probe may become virtual if one of them, real or virtual, has eight valid corners: probes with light of their own,
or virtual ones that mix nothing else (weight 1). Levels 0 and 1 stay real: they are few, and everything rests on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F64, I64, Bool
from ..lattice import OCTANTS, Octree, index_of, keys

TEXELS = 27
FULL = 1.0 - 1e-6  # of a weight: the halves and quarters that it is made of are exact, their sum nearly so


@dataclass(frozen=True, eq=False)
class Parents:
    """weights (R, R): each able probe's row mixes probes of coarser levels, and sums to 1; other rows are empty. able (R,): has
    eight valid parents."""

    weights: sparse.csr_array
    able: Bool


def find_parents(tree: Octree, tile_parents: tuple[I64, ...], texels: sparse.csr_array, valid: Bool) -> Parents:
    """Parents of all valid probes. tile_parents: per level 1 … L, the voxels (T, 3) of the level above that tiles cover, sorted by
    key. texels (tiles · 27, R): what texels hold of probes with light of their own, tiles in that order; probes without have 0."""
    weight = np.asarray(texels.sum(axis=1)).ravel()
    able = np.zeros(len(valid), dtype=np.bool_)
    first, rows, columns, values = 0, [], [], []
    for level in range(2, tree.grid.level + 1):
        tiles = keys(tile_parents[level - 2])
        mine = np.flatnonzero(valid & (tree.corner_level == level))
        for texel, share in _voxels(tree, level, tiles, mine):
            full = (texel >= 0).all(axis=1) & ~able[mine]
            full[full] = (weight[first * TEXELS + texel[full]] >= FULL).all(axis=1)
            able[mine[full]] = True
            rows.append(np.repeat(mine[full], 8))
            columns.append(first * TEXELS + texel[full].ravel())
            values.append(share[full].ravel())
        first += len(tiles)
    if not rows:
        return Parents(sparse.csr_array((len(valid), len(valid))), able)
    mix = sparse.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(len(valid), texels.shape[0])
    )
    mix.eliminate_zeros()
    return Parents((mix @ texels).tocsr(), able)


def _voxels(tree: Octree, level: int, tiles: I64, mine: I64) -> list[tuple[I64, F64]]:
    """For each way to choose among the voxels of level - 1 that hold corners `mine` (N,): their eight texels (N, 8) within the level,
    -1 where there is no such voxel, and the corners' trilinear weights (N, 8)."""
    size = 1 << (tree.grid.level - level + 1)
    corner = tree.corners[mine]
    found = []
    for side in OCTANTS:
        voxel = (corner - side) // size
        tile = np.where((voxel >= 0).all(axis=1), index_of(tiles, keys(np.maximum(voxel, 0) >> 1)), -1)
        f = (corner - voxel * size) / size
        texel = tile[:, None] * TEXELS + ((voxel & 1)[:, None, :] + OCTANTS) @ np.array([9, 3, 1])
        share = np.where(OCTANTS[None] == 1, f[:, None, :], 1.0 - f[:, None, :]).prod(axis=2)
        found.append((np.where(tile[:, None] >= 0, texel, -1), share))
    return found
