"""Voxels that a triangle mesh touches, or that it encloses.

Surface: octree descent with the exact triangle-cube test. A triangle enters at the finest level at which its bounds span at
most two cells an axis, so small triangles are tested once and large ones cost what their surface does. Conservative: no
voxel that a triangle touches is missed, and none is marked that no triangle touches.

Inside: voxels that no triangle touches lie wholly inside or wholly outside, and so does each set of them that hangs together
by faces. One winding number (winding.py) for each set, at the centre of one of its voxels, decides: |w| > 1/2 is inside. A
hollow in a closed mesh, wound the other way, has w = 0 and stays outside.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I32, I64
from ..errors import InputError
from ..lattice import OCTANTS, Grid, cells, distinct, keys
from .shape_voxels import clipped_block, refuse_many
from .tri_box import CubeTest
from .winding import solid_angles

# Of sets of voxels with triangles: some eight seconds of winding numbers.
MAX_WINDING_PAIRS = 1 << 28
SOLID_ANGLES_PER_BATCH = 1 << 20
FARTHEST = 1e-9  # share of a cell by which bounds are widened, the hair of tri_box


def mesh_voxels(corners: F64, grid: Grid, level: int, reach: F64 | None = None, where: str = "mesh") -> I64:
    """Sorted keys (N,) of the voxels of `level` that triangles `corners` (F, 3, 3) m touch, or come within `reach` (F, 3) m, per axis.

    Raises InputError naming `where` if they are more than MAX_VOXELS.
    """
    corners = corners - grid.origin
    test = CubeTest(corners, reach)
    entry, first = _entries(corners, grid, level, 0.0 if reach is None else reach)
    triangle, block = np.zeros(0, np.int64), np.zeros((0, 3), np.int64)
    for depth in range(level + 1):
        enters = np.flatnonzero(entry == depth)
        triangle, block = np.concatenate([triangle, enters]), np.concatenate([block, first[enters]])
        size = grid.size(depth)
        pair, octant = np.nonzero(test(triangle, block, size))
        cell, triangle = block[pair] + OCTANTS[octant], triangle[pair]
        inside = (cell <= grid.last(depth)).all(axis=1)
        cell, triangle = cell[inside], triangle[inside]
        refuse_many(len(cell), where, size, "pairs of triangles and voxels")
        block = 2 * cell
    return distinct(keys(cell))


def _entries(corners: F64, grid: Grid, level: int, reach: F64 | float) -> tuple[I64, I64]:
    """Per triangle the level at which it enters the descent, -1 if it lies off the grid, and its lowest cell there (T, 3)."""
    lower, upper = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    entry = np.full(len(corners), -1, dtype=np.int64)
    first = np.zeros((len(corners), 3), dtype=np.int64)
    for depth in range(level, -1, -1):
        open_rows = np.flatnonzero(entry < 0)
        begin, end = clipped_block(lower[open_rows], upper[open_rows], grid, depth, FARTHEST)
        fits = ((end - begin >= 0) & (end - begin <= 1)).all(axis=1)
        entry[open_rows[fits]] = depth
        first[open_rows[fits]] = begin[fits]
    return entry, first


def closed_voxels(vertices: F64, faces: I32, grid: Grid, level: int, where: str = "mesh") -> I64:
    """Sorted keys (N,) of the voxels of `level` that a watertight mesh, vertices (V, 3) m and faces (F, 3), touches or encloses.

    Raises InputError naming `where` if its bounds hold more than MAX_VOXELS.
    """
    from scipy import ndimage

    surface = mesh_voxels(vertices[faces], grid, level, None, where)
    points = vertices - grid.origin
    begin, end = clipped_block(points.min(axis=0)[None], points.max(axis=0)[None], grid, level, FARTHEST)
    shape = (end - begin + 1)[0]
    if (shape <= 0).any():
        return surface
    refuse_many(int(np.prod(shape.astype(object))), where, grid.size(level), "voxels in its bounds")
    free = np.ones(tuple(shape), dtype=np.bool_)
    free[tuple((cells(surface) - begin).T)] = False
    label, count = ndimage.label(free)
    if count * len(faces) > MAX_WINDING_PAIRS:
        raise InputError(
            f"{where}: {count} separate spaces in a mesh of {len(faces)} triangles are too many to tell inside from outside; "
            f'raise its probe_size or mark its surface only (kind = "surface")'
        )
    named, at = np.unique(label, return_index=True)
    cell = np.stack(np.unravel_index(at, label.shape), axis=1) + begin
    centre = np.asarray((cell + 0.5) * grid.size(level), np.float64)
    held = np.zeros(count + 1, dtype=np.bool_)
    spaces = named > 0
    held[named[spaces]] = np.abs(winding_numbers(centre[spaces], points[faces])) > 0.5
    return distinct(np.concatenate([surface, keys(np.argwhere(held[label]) + begin)]))


def winding_numbers(positions: F64, corners: F64) -> F64:
    """How often triangles (F, 3, 3) wind around each of `positions` (P, 3): (P,), a whole number off a closed mesh."""
    total = np.zeros(len(positions))
    step = max(1, SOLID_ANGLES_PER_BATCH // max(1, len(positions)))
    for begin in range(0, len(corners), step):
        total += solid_angles(corners[begin : begin + step], positions).sum(axis=1)
    return np.asarray(total / (4.0 * np.pi))
