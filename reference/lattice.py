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
    """origin (3,) f64 m; finest: voxel size at `level` L, m; extent (3,) i64: finest voxels that cover the bounds. extra: the
    last so many levels are deeper than placement.min_voxel and only there for layers of a bitmap file."""

    origin: F64
    finest: float
    level: int
    extent: I64
    extra: int = 0

    @property
    def wanted_level(self) -> int:
        """Level of placement.min_voxel: the finest that meshes, volumes and marks can ask for."""
        return self.level - self.extra

    @property
    def wanted(self) -> float:
        """Voxel size of placement.min_voxel, m."""
        return self.size(self.wanted_level)

    def size(self, level: int) -> float:
        """Voxel size at `level`, m."""
        return float(self.finest * 2.0 ** (self.level - level))

    def corner_positions(self, corners: npt.NDArray[np.integer]) -> F64:
        """World positions (N, 3) m of finest-lattice `corners` (N, 3)."""
        return np.asarray(self.origin + corners * self.finest)

    def last(self, level: int) -> I64:
        """The last voxel (3,) of `level` that the bounds reach."""
        return np.asarray((self.extent - 1) >> (self.level - level))

    def level_for(self, size: float) -> int:
        """Level whose voxel size is nearest to `size` in octaves, within 0 … L."""
        return int(np.clip(round(self.level - math.log2(size / self.finest)), 0, self.level))


@dataclass(frozen=True, eq=False)
class Octree:
    """voxels: per level 0 … L the existing voxels (N_l, 3) i64, sorted by key.
    corners (R, 3) i64: where probes stand, on the finest lattice, sorted by key; corner_level (R,) i32: coarsest level
    with it. corners_tested: for how many corners, level by level, rays decided whether they are close to surfaces.
    plain_probes: how many probes plain subdivision places in the same bitmap by the same tests, 0 where that is not known."""

    grid: Grid
    voxels: tuple[I64, ...]
    corners: I64
    corner_level: I32
    corners_tested: int
    plain_probes: int = 0

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


def deepened(grid: Grid, size: float) -> Grid:
    """The same lattice with as many more levels as it takes to have voxels of about `size` m (the nearest in octaves).

    Raises InputError if these are more than MAX_LEVEL.
    """
    extra = round(math.log2(grid.finest / size))
    if extra <= 0:
        return grid
    if grid.level + extra > MAX_LEVEL:
        raise InputError(
            f"the bitmap file (placement.bitmap, --bitmap): cells of {size:g} m need {grid.level + extra} octree levels, at most "
            f"{MAX_LEVEL} are supported; use {grid.size(MAX_LEVEL):.3g} m or more"
        )
    finest = float(grid.finest * 2.0**-extra)
    return Grid(grid.origin, finest, grid.level + extra, grid.extent << extra, grid.extra + extra)


def keys(cells: npt.NDArray[np.integer]) -> I64:
    """One i64 per integer triple (N, 3) in -1 … 2^20 - 2, order-preserving: x slowest."""
    c = cells.astype(np.int64) + 1
    return np.asarray((c[:, 0] << 42) | (c[:, 1] << 21) | c[:, 2])


def cells(key: I64) -> I64:
    """Inverse of `keys`: (N, 3) i64."""
    mask = (1 << 21) - 1
    return np.stack([key >> 42, (key >> 21) & mask, key & mask], axis=1) - 1


def steps(c: npt.NDArray[np.integer]) -> I64:
    """What to add to the key of a cell to move it by each of (N, 3) whole cells: (N,) i64."""
    d = np.asarray(c, dtype=np.int64)
    return np.asarray((d[:, 0] << 42) + (d[:, 1] << 21) + d[:, 2])


def parent_keys(key: I64) -> I64:
    """Keys of the cells halved: of the voxels one level up that hold voxels `key` (N,), none of them negative."""
    return ((key - _FIRST) >> 1 & _HALVED) + _FIRST


def finer_keys(key: I64, levels: int) -> I64:
    """Keys of the cells times 2^`levels`, none of them negative: the same corner, or a voxel's first, on a finer lattice."""
    return ((key - _FIRST) << levels) + _FIRST


def child_keys(key: I64) -> I64:
    """Keys (8 N,) of the children of voxels `key` (N,), octant by octant within each."""
    return (finer_keys(key, 1)[:, None] + steps(OCTANTS)).ravel()


def parities(key: I64) -> I64:
    """The last bit of each coordinate of cells `key` (N,), none of them negative, as steps: 0 or 1 per axis."""
    return (key - _FIRST) & _ODD


def distinct(key: I64) -> I64:
    """Sorted distinct keys. `np.unique` hashes since NumPy 2.3: 28 times slower than this on 5 million keys."""
    return _without_repeats(np.sort(key))


def union(*sets: I64) -> I64:
    """Sorted distinct keys of sorted sets: a stable sort merges runs, 7 times faster than it sorts what is in no order."""
    return _without_repeats(np.sort(np.concatenate(sets), kind="stable"))


def _without_repeats(ordered: I64) -> I64:
    first = np.ones(len(ordered), dtype=np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return ordered[first]


def unique_cells(c: npt.NDArray[np.integer]) -> I64:
    """Distinct rows of (N, 3), sorted by key."""
    return cells(distinct(keys(c)))


def index_of(sorted_keys: I64, wanted: I64) -> I64:
    """Place of each `wanted` key in `sorted_keys`, -1 where absent."""
    if len(sorted_keys) == 0:
        return np.full(len(wanted), -1, dtype=np.int64)
    at = np.minimum(np.searchsorted(sorted_keys, wanted), len(sorted_keys) - 1)
    return np.where(sorted_keys[at] == wanted, at, -1)


# Offsets of a voxel's corners or of a node's children, (8, 3); of its 26 neighbours and itself, (27, 3).
OCTANTS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.int64)
NEIGHBOURS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.int64)

_FIRST = int(keys(np.zeros((1, 3), dtype=np.int64))[0])  # the key of cell (0, 0, 0)
_ODD = int(steps(np.ones((1, 3), dtype=np.int64))[0])  # the last bit of each coordinate
# Each coordinate without the bit that a shift brings in from the next one.
_HALVED = int(steps(np.full((1, 3), (1 << 20) - 1))[0])
