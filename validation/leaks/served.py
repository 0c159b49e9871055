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
from ...reference.lattice import OCTANTS, Octree, cells, distinct, index_of, keys
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
    there = index_of(keys(old.corners << (octree.grid.level - old.grid.level)), keys(octree.corners)) >= 0
    verdict = np.column_stack([v for v, _ in found])
    voxel, corners = _numbered([c for _, c in found], len(octree.corners))
    kind = np.asarray(otherwise, dtype=np.int64)
    for column in range(len(levels)):
        code = (kind * (SILENT + 1) + verdict[:, column]) * len(corners) + voxel[:, column]
        kind = index_of(distinct(code), code)
    one = np.zeros(int(kind.max(initial=-1)) + 1, dtype=np.int64)
    one[kind] = np.arange(len(kind))  # any place of a kind stands for it
    return Served(octree, kind, levels, verdict[one], voxel[one], corners, np.asarray(otherwise)[one], there)


def _numbered(found: list[I64], probes: int) -> tuple[I64, I64]:
    """Numbers (N, K) of voxels, the same for the same one of a level, from their corners (N, 8) on each of K levels: numbers of
    `probes`, or -1; and the corners (M, 8) by number. Each is known by its first corner where a probe stands, and which one that is;
    voxels of a level with none are all alike. (`np.unique` of rows says the same, 20 times slower.)"""
    columns, corners, count = [], list[I64](), 0
    for corner in found:
        known = corner >= 0
        octant, row = np.argmax(known, axis=1), np.arange(len(corner))
        own = np.where(known.any(axis=1), 1 + corner[row, octant] * len(OCTANTS) + octant, 0)
        used = np.zeros(1 + probes * len(OCTANTS), dtype=np.int64)
        used[own] = row + 1
        corners.append(corner[used[used > 0] - 1])
        columns.append(count + (np.cumsum(used > 0) - 1)[own])
        count += len(corners[-1])
    return np.column_stack(columns), np.concatenate(corners)
