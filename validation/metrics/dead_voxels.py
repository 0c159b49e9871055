"""Voxels around which no probe is valid: samples in them must have the light of the level above (failure-catalogue D5).

    dead_voxel_deviation = max |E_kernel - E_plain| / (|E_plain| + Ē)        a value that is not finite counts as 1
    dead_voxel_lost      = share of samples without light, or not finite, though the level above has some

Ē is the scene's mean light. The cameras hardly see such voxels, which lie inside of things as a rule; a moving mesh or fog may meet
them, and one division by their weight of 0 spoils a frame. Places are drawn in voxels of the finest tile there, all of whose
eight texels have weight 0, as many in one voxel as a kernel may sample side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ...reference.datatypes import F32, F64, I32, I64
from ...reference.directions import sphere
from ...reference.lattice import OCTANTS
from ...reference.reconstruction import Reconstruction
from ...reference.texture_types import WEIGHT, Samples, VirtualTexture
from ...reference.volume.layout import TileLayout
from ...reference.volume.sampler import MIN_WEIGHT, sample
from .error import Measured

MOST_VOXELS, PER_VOXEL = 250, 8
AXIS = np.array([9, 3, 1])  # texel numbers of a tile step by this much along x, y, z
Kernel = Callable[[F64, F64], Samples]


def dead_voxels(texture: VirtualTexture, layout: TileLayout) -> tuple[I64, I32]:
    """First corner (N, 3), finest voxels, and level (N,), 2 or finer, of the voxels that answer with no weight at all: no finer tile
    covers them, all eight texels have weight 0, and they begin within the texture's extent."""
    corner, levels = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int32)]
    for level in range(2, texture.level + 1):
        begin, end = layout.first_slot[level - 1], layout.first_slot[level]
        weight = texture.texels[begin:end, :, WEIGHT]
        around = (OCTANTS[:, None] + OCTANTS[None]) @ AXIS  # texels (8 voxels, 8 corners)
        dead = (weight[:, around] == 0.0).all(axis=2)
        if level < texture.level:
            dead[layout.parent_tile[level], layout.octant[level]] = False
        tile, octant = np.nonzero(dead)
        at = (2 * layout.parents[level - 1][tile] + OCTANTS[octant]) << (texture.level - level)
        at = at[(at < texture.extent).all(axis=1)]
        corner.append(at)
        levels.append(np.full(len(at), level, dtype=np.int32))
    return np.concatenate(corner), np.concatenate(levels)


def measure_dead_voxels(
    texture: VirtualTexture, layout: TileLayout, kernel: Kernel, way: Reconstruction, scale: float, seed: int
) -> dict[str, Measured]:
    """Both figures of `texture` as the device stores it, whose tiles are those of `layout`; nothing where no voxel is dead.

    kernel: samples at positions (N, 3) m for normals (N, 3). scale: the scene's mean light, W·m⁻², above 0.
    """
    corner, level = dead_voxels(texture, layout)
    if not len(corner):
        return {}
    rng = np.random.default_rng([seed, 61])
    some = np.repeat(rng.permutation(len(corner))[:MOST_VOXELS], PER_VOXEL)
    size = np.exp2(texture.level - level[some])[:, None]
    within = np.minimum(corner[some] + size * rng.uniform(0.05, 0.95, (len(some), 3)), texture.extent - 0.01)
    where = texture.origin + texture.finest * within
    normals = sphere(rng.random((len(some), 2)))
    got = kernel(where, normals).irradiance
    plain = sample(texture, where, normals, reconstruction=way).irradiance
    above = sample(texture, where, normals, level[some] - 1, reconstruction=way)
    return _figures(got, plain, above, scale)


def _figures(got: F32, plain: F32, above: Samples, scale: float) -> dict[str, Measured]:
    finite, n = np.isfinite(got).all(axis=1), len(got)
    apart = np.where(finite, (np.abs(got - plain) / (np.abs(plain) + scale)).max(axis=1), 1.0)
    lit = (above.weight >= MIN_WEIGHT) & above.irradiance.any(axis=1)
    lost = ~finite | (lit & ~got.any(axis=1))
    share = float(lost.mean())
    return {
        "dead_voxel_deviation": Measured(float(apart.max()), 0.0, n),
        "dead_voxel_lost": Measured(share, math.sqrt(share * (1.0 - share) / n), n),
    }
