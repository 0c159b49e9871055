"""The octree and its lattice: a root cube, halved level by level, and integer keys for voxels and corners.

Level 0 is one voxel, level L the finest. Corners are addressed on the finest lattice (2^L + 1 points an edge), so a
corner that several levels share has one address.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .datatypes import F64, I32, I64
from .errors import InputError

# The lattice is shifted off the bounds by this share of a voxel: probes then do not lie in axis-aligned walls.
SHIFT = 0.381966
MAX_LEVEL = 16
AUTO_VOXELS = 64


@dataclass(frozen=True, eq=False)
class Grid:
    """origin (3,) f64 m; finest: voxel size at `level` L, m; extent (3,) i64: finest voxels that cover the bounds."""

    origin: F64
    finest: float
    level: int
    extent: I64

    def size(self, level: int) -> float:
        """Voxel size at `level`, m."""
        return float(self.finest * 2.0 ** (self.level - level))

    def corner_positions(self, corners: npt.NDArray[np.integer]) -> F64:
        """World positions (N, 3) m of finest-lattice `corners` (N, 3)."""
        return np.asarray(self.origin + corners * self.finest)

    def level_for(self, size: float) -> int:
        """Level whose voxel size is nearest to `size` in octaves, within 0 … L."""
        return int(np.clip(round(self.level - math.log2(size / self.finest)), 0, self.level))


@dataclass(frozen=True, eq=False)
class Octree:
    """voxels: per level 0 … L the existing voxels (N_l, 3) i64, sorted by key.
    corners (R, 3) i64: where probes stand, on the finest lattice, sorted by key; corner_level (R,) i32: coarsest level
    with it. corners_tested: how many corners the harmonic mean was computed for."""

    grid: Grid
    voxels: tuple[I64, ...]
    corners: I64
    corner_level: I32
    corners_tested: int

    @property
    def positions(self) -> F64:
        """World positions of the corners, (R, 3) m."""
        return self.grid.corner_positions(self.corners)


def make_grid(lower: F64, upper: F64, finest: float | None, shift: F64 | float = SHIFT) -> Grid:
    """Root cube over the bounds (3,), m, shifted off them by `shift`, a number or (3,), in finest voxels.

    Raises InputError if `finest` needs more than MAX_LEVEL levels.
    """
    extent = upper - lower
    size = finest if finest is not None else float(extent.max()) / AUTO_VOXELS
    voxels = np.ceil(extent / size + shift + SHIFT).astype(np.int64)
    level = max(1, math.ceil(math.log2(int(voxels.max()))))
    if level > MAX_LEVEL:
        least = float(extent.max()) / 2 ** (MAX_LEVEL - 1)
        raise InputError(
            f"placement.min_voxel: {size:g} m needs {level} octree levels over {extent.max():g} m, at most {MAX_LEVEL} "
            f"are supported; use {least:.3g} or more"
        )
    return Grid(lower - shift * size, float(size), level, voxels)


def keys(cells: npt.NDArray[np.integer]) -> I64:
    """One i64 per integer triple (N, 3) in -1 … 2^20 - 2, order-preserving: x slowest."""
    c = cells.astype(np.int64) + 1
    return np.asarray((c[:, 0] << 42) | (c[:, 1] << 21) | c[:, 2])


def cells(key: I64) -> I64:
    """Inverse of `keys`: (N, 3) i64."""
    mask = (1 << 21) - 1
    return np.stack([key >> 42, (key >> 21) & mask, key & mask], axis=1) - 1


def unique_cells(c: npt.NDArray[np.integer]) -> I64:
    """Distinct rows of (N, 3), sorted by key."""
    return cells(np.unique(keys(c)))


def index_of(sorted_keys: I64, wanted: I64) -> I64:
    """Place of each `wanted` key in `sorted_keys`, -1 where absent."""
    if len(sorted_keys) == 0:
        return np.full(len(wanted), -1, dtype=np.int64)
    at = np.minimum(np.searchsorted(sorted_keys, wanted), len(sorted_keys) - 1)
    return np.where(sorted_keys[at] == wanted, at, -1)


# Offsets of a voxel's corners or of a node's children, (8, 3); of its 26 neighbours and itself, (27, 3).
OCTANTS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.int64)
NEIGHBOURS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.int64)
