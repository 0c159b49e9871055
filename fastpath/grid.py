"""What a kernel is told of a texture's lattice and of who looks: the `Grid` of common.clh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F64, I64
from ..reference.texture_types import Viewer, anchor_cell

_GRID = np.dtype(
    [
        ("anchor_fraction", np.float32, 4),
        ("viewer", np.float32, 4),
        ("anchor_cell", np.int32, 4),
        ("extent", np.int32, 4),
        ("cache", np.int32, 4),
        ("scale", np.float32, 4),
    ]
)


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where a texture's voxels are: origin (3,) f64 m, finest voxel, m, level L, extent (3,) in finest voxels; cache (3,): tiles
    per axis; window: log2 of a clipmap's texels per axis, 0 without one."""

    origin: F64
    finest: float
    level: int
    extent: I64
    cache: I64
    window: int = 0


def grid_words(lattice: Lattice, anchor: F64, lod: Any, exposure: float) -> Any:
    """The kernel's `Grid`. Raises ValueError for an anchor that is not three finite numbers within reach of 32-bit cells."""
    cell, fraction = anchor_cell(lattice.origin, lattice.finest, anchor)
    words = np.zeros((), dtype=_GRID)
    words["anchor_fraction"] = [*fraction, 1.0 / lattice.finest]
    words["anchor_cell"] = [*cell, lattice.level]
    words["extent"] = [
        *lattice.extent,
        lattice.level if lod is None or isinstance(lod, Viewer) or np.ndim(lod) else lod,
    ]
    words["cache"] = [*lattice.cache, lattice.window]
    words["scale"] = [exposure, 0.0, 0.0, 0.0]
    if isinstance(lod, Viewer):
        words["viewer"] = [*(np.asarray(lod.position, np.float64) - anchor), 1.0 / lod.lod_distance**2]
        if lod.blend > 0.0:
            band = np.float32(lod.blend)
            words["scale"][1:3] = band, np.float32(1.0) / band
    return words[()]
