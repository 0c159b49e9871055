"""The light of a placement, as the search for leaks sees it: which probes a place reads, and what they hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F32, F64, I32, I64
from ...reference.lattice import Octree, index_of, keys
from ...reference.sh import COSINE_A0, Y0, irradiance_weights
from ...reference.texture_types import VirtualTexture
from ...reference.visibility import Geometry
from ...reference.volume.layout import TileLayout
from ..bake import Baked

MEAN_OVER_NORMALS = np.array([COSINE_A0 * Y0, 0.0, 0.0, 0.0])  # irradiance averaged over all normals, from radiance SH


@dataclass(frozen=True, eq=False)
class LightField:
    """Probes that are lit. coefficients (R, 4, 3) f32 radiance SH of real probes; source (R,) i32: whose light each
    uses, -1 for none; lift, m: how far off surfaces receivers are sampled."""

    geometry: Geometry
    octree: Octree
    layout: TileLayout
    texture: VirtualTexture
    source: I32
    coefficients: F32
    lift: float


@dataclass(frozen=True, eq=False)
class Places:
    """Where light is asked for. positions (N, 3) m, off surfaces already; response (N, 4): row that makes irradiance of
    radiance SH; names (N,) str of the set of points each is from."""

    positions: F64
    response: F64
    names: npt.NDArray[np.str_]

    @property
    def count(self) -> int:
        """Number of places."""
        return len(self.positions)


def places(positions: F64, normals: F64 | None, name: str) -> Places:
    """Receivers at `positions` (N, 3) m; without `normals` (N, 3) each stands for all normals alike."""
    n = len(positions)
    response = np.tile(MEAN_OVER_NORMALS, (n, 1)) if normals is None else irradiance_weights(normals)
    return Places(positions, response, np.full(n, name))


def joined(parts: list[Places]) -> Places:
    """Several sets of places as one, in order; none where there are none."""
    empty = Places(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, dtype=np.str_))
    return Places(
        np.concatenate([p.positions for p in (empty, *parts)]),
        np.concatenate([p.response for p in (empty, *parts)]),
        np.concatenate([p.names for p in (empty, *parts)]),
    )


def part(at: Places, chosen: I64) -> Places:
    """The places numbered `chosen` (K,), in that order."""
    return Places(at.positions[chosen], at.response[chosen], at.names[chosen])


def field_of(baked: Baked, coefficients: F32) -> LightField:
    """The light of a bake with its probes' `coefficients` (R, 4, 3)."""
    p = baked.probes
    lift = baked.scene.settings.sampling.normal_offset * p.octree.grid.wanted
    return LightField(baked.surfaces.geometry, p.octree, p.layout, baked.texture, p.light_from, coefficients, lift)


def holding_level(octree: Octree, positions: F64) -> I64:
    """Level (N,) of the finest voxel with eight probes of its own that holds each position (N, 3) m."""
    found = np.zeros(len(positions), dtype=np.int64)
    for level, voxels in enumerate(octree.voxels):
        inside = index_of(keys(voxels), keys(cells_at(octree, level, positions))) >= 0
        found[inside] = level
    return found


def cells_at(octree: Octree, level: int, positions: F64) -> I64:
    """Cells (N, 3) of `level` that hold positions (N, 3) m, those beyond the grid moved to its border."""
    grid = octree.grid
    cell = np.floor((positions - grid.origin) / grid.size(level)).astype(np.int64)
    return np.clip(cell, 0, (1 << level) - 1)
