"""What the voxels of each level would make of a place, from one bake with all of them: the means to judge many edits without baking.

A place reads the finest voxel that holds it, has probes at all eight corners and enough weight. Probes are traced each for itself:
what a voxel's own corners give a place does not depend on which other voxels there are. (Copies of light into dead edges may; so
whatever is found here is baked in the end.) So one bake with many cells tells of each, whether it keeps a place dark, lights it through
a wall, or is silent as none of its corners holds light: then the next larger voxel answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...reference.datatypes import I64, Bool
from ...reference.lattice import OCTANTS, Octree, cells, index_of, keys
from .attribution import leaks_by
from .field import LightField, Places
from .search import Search
from .weights import voxel_weights

KEEPS, LEAKS, SILENT = 0, 1, 2


def verdicts(search: Search, field: LightField, at: Places, level: int) -> tuple[I64, I64]:
    """KEEPS, LEAKS or SILENT (N,) for places in the voxels of one `level` of `field`, and those voxels' corners (N, 8), -1 where no
    probe stands (then SILENT)."""
    weights, corners = voxel_weights(field.octree, field.texture, field.source, at.positions, level)
    dark = None if search.dark is None else search.dark(at.positions)
    leaks = leaks_by(field, at, dark, search.mean_light, weights, weights.level.astype(np.int64)).leaks
    return np.where(weights.level == 0, SILENT, np.where(leaks, LEAKS, KEEPS)), corners


@dataclass(frozen=True, eq=False)
class Served:
    """The levels that an edit adds to, finest first, and N kinds of places, which read the same voxels with the same result: kind (P,)
    of each of P places. verdict (N, K) by level; voxel (N, K): number of the voxel, of M
    voxels whose corners (M, 8) are numbers of the octree's R probes, -1 where there is none. otherwise (N,) bool: whether a place
    leaks where none of these levels answers. base (R,) bool: probes that stand there without any edit."""

    octree: Octree
    kind: I64
    levels: tuple[int, ...]
    verdict: I64
    voxel: I64
    corners: I64
    otherwise: Bool
    base: Bool

    def leaks(self, there: Bool) -> Bool:
        """Which kinds (N,) of places leak where probes `there` (R,) stand and no others."""
        whole: Bool = np.asarray((there[self.corners] & self.known).all(axis=1))
        result = self.otherwise.copy()
        for column in reversed(range(len(self.levels))):  # coarse to fine: the finest that answers has the last word
            verdict = self.verdict[:, column]
            answers = whole[self.voxel[:, column]] & (verdict != SILENT)
            result[answers] = verdict[answers] == LEAKS
        return result

    @cached_property
    def known(self) -> Bool:
        """Whether a probe stands at each corner (M, 8) in any edit."""
        return np.asarray(self.corners >= 0)

    def probes_of(self, level: int, key: I64) -> I64:
        """Numbers (N, 8) of the probes at the corners of cells of the edit, keys (N,) of `level`."""
        corner = (cells(key)[:, None, :] + OCTANTS).reshape(-1, 3) << (self.octree.grid.level - level)
        return index_of(keys(self.octree.corners), keys(corner)).reshape(-1, len(OCTANTS))


def served(search: Search, field: LightField, at: Places, otherwise: Bool, coarsest: int) -> Served:
    """How places would be served by the voxels of a baked edit, from its `coarsest` level on. otherwise (N,): whether they leak
    without it."""
    octree, old = field.octree, search.field.octree
    levels = tuple(range(octree.grid.level, coarsest - 1, -1))
    found = [verdicts(search, field, at, level) for level in levels]
    corners, voxel = np.unique(np.concatenate([c for _, c in found]), axis=0, return_inverse=True)
    there = index_of(keys(old.corners << (octree.grid.level - old.grid.level)), keys(octree.corners)) >= 0
    rows = np.column_stack([*(v for v, _ in found), voxel.reshape(len(levels), -1).T, otherwise])
    rows, kind = np.unique(rows, axis=0, return_inverse=True)
    count = len(levels)
    verdict, voxels, leaks = rows[:, :count], rows[:, count : 2 * count], rows[:, -1] > 0
    return Served(octree, kind.ravel(), levels, verdict, voxels, corners, leaks, there)
