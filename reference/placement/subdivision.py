"""Which children of a subdivided voxel exist, and where probes then stand.

    child-only   the children that are close to surfaces (talk, "Placing fewer probes")
    plain        all eight: a 3×3×3 grid of probes for each subdivided voxel (talk, "Adaptive subdivision")

A voxel is subdivided where it is close to surfaces and the voxel bitmap holds something finer in it. So one run that knows
the close voxels of all levels knows the probes of both schemes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import I32, I64
from ..lattice import Grid, cells, child_keys, finer_keys, index_of, steps, union


def all_children(grid: Grid, level: int, parents: I64) -> I64:
    """Sorted keys of the children, at `level`, of voxels `parents` (N,) of the level above, those within the bounds."""
    children = np.sort(child_keys(parents))
    return children[(cells(children) <= grid.last(level)).all(axis=1)]


def corner_keys(grid: Grid, level: int, voxels: I64) -> I64:
    """Sorted distinct keys, on the finest lattice, of the corners of voxels `voxels` (N,) of `level`."""
    found = finer_keys(voxels, grid.level - level)
    for step in steps(np.eye(3, dtype=np.int64) << (grid.level - level)):
        found = union(found, found + step)
    return found


@dataclass(frozen=True, eq=False)
class Placed:
    """Distinct corners so far: all of them, sorted, and per level those that no coarser level has. Keys of the finest lattice."""

    every: I64
    by_level: tuple[I64, ...]

    def plus(self, corners: I64) -> Placed:
        """With the `corners`, sorted, of the next finer level."""
        fresh = corners[index_of(self.every, corners) < 0]
        return Placed(union(self.every, fresh), (*self.by_level, fresh))

    def corners(self) -> tuple[I64, I32]:
        """Distinct corners (R, 3), sorted by key, and the coarsest level of each (R,)."""
        level = np.repeat(np.arange(len(self.by_level), dtype=np.int32), [len(k) for k in self.by_level])
        order = np.argsort(np.concatenate(self.by_level), kind="stable")
        return cells(self.every), level[order]


NOTHING = Placed(np.zeros(0, dtype=np.int64), ())
