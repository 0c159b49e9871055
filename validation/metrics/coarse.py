"""Surfaces in voxels that are coarser than they should be: what placement promises, asked at places that it does not know.

    coarse_share = share of probe-lit surface whose voxel is coarser than the voxel bitmap asks for there
    unmet_share  = the same where nothing but bitmap and surface decides, so that the voxel must be there: must be 0

A voxel exists where the bitmap holds it and surfaces are near, as a harmonic mean of distances finds; `coarse_share` is what that lets
go, at an edge that looks out into the open, say. No distance is asked where a surface touches a voxel that only leads to those that
meshes ask for, where `placement.touching` is set, and where a layer of the bitmap file places voxels (see placement/touching.py and
bitmap_layers.py). Places are uniform over the surfaces, drawn from the seed and from nothing that placement draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...reference.datatypes import F64, I64, Bool
from ...reference.lattice import Grid, index_of, keys
from ...reference.visibility import Geometry, points_on_triangles
from .error import Measured

PLACES = 8000


def places_on(g: Geometry, lit: Bool, seed: int) -> F64:
    """Places (PLACES, 3) m, uniform over the surfaces of meshes that are `lit` (M,) by probes; none where these have no area."""
    area = np.where(lit[g.mesh], g.areas, 0.0)
    if not area.any():
        return np.zeros((0, 3))
    rng = np.random.default_rng([seed, 53])
    triangle = rng.choice(len(area), size=PLACES, p=area / area.sum())
    u, v = np.sort(rng.random((2, PLACES)), axis=0)
    return points_on_triangles(g, triangle, np.stack([u, v - u], axis=1))


def finest_holding(grid: Grid, levels: Sequence[I64], places: F64) -> I64:
    """The finest level (N,) whose voxels, sorted keys by level, hold each place (N, 3) m; 0 where none does."""
    found = np.zeros(len(places), dtype=np.int64)
    for level, voxels in enumerate(levels):
        cell = np.floor((places - grid.origin) / grid.size(level)).astype(np.int64)
        inside = (cell >= 0).all(axis=1)
        held = index_of(voxels, keys(np.maximum(cell, 0))) >= 0
        found[held & inside] = level
    return found


def measure_coarse(
    grid: Grid, voxels: Sequence[I64], occupied: Sequence[I64], placed: Sequence[I64], touched: int, places: F64
) -> dict[str, Measured]:
    """coarse_share and unmet_share at `places` (N, 3) m on surfaces; nothing without places.

    voxels, occupied, placed: per level 0 … L the sorted keys of the octree's voxels, of the bitmap, and of what a file places, which
    may be empty. touched: the finest level that is subdivided wherever a surface touches it.
    """
    if not len(places):
        return {}
    there, asked = finest_holding(grid, voxels, places), finest_holding(grid, occupied, places)
    promised = np.maximum(np.minimum(asked, max(touched, 0)), finest_holding(grid, placed, places))
    return {"coarse_share": _share(there < asked), "unmet_share": _share(there < promised)}


def _share(hit: Bool) -> Measured:
    share, n = float(hit.mean()), len(hit)
    return Measured(share, math.sqrt(share * (1.0 - share) / n), n)
