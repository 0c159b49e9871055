"""What dead edges cost: samples that a coarser level answers, and the jump just off an edge (failure-catalogue D5, D6).

    fallback_share = share of samples that a coarser level answers than the one whose voxel holds them
    dead_jump      = (max - min) / (mean + 0.01 Ē) of the irradiance, averaged over normals, on a dead edge and 1e-3 voxels beside it

at places of dead edges where a probe would be valid; Ē is its mean over these places.
"""

from __future__ import annotations

import math

import numpy as np

from ...reference.datatypes import F64, I32, I64
from ...reference.placement.dead_edges import ALONG, Edges
from ...reference.placement.validity import back_share
from ...reference.texture_types import Samples, VirtualTexture
from ...reference.visibility import Geometry
from ...reference.volume.sampler import lattice_position, locate, sample
from .error import Measured

STEP = 1e-3  # of a voxel; more than the least weight, so that a probe across the voxel still answers
MOST_PLACES = 4000
SIDES = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def fallback_share(texture: VirtualTexture, where: F64, samples: Samples) -> Measured:
    """Share of `samples` at `where` (N, 3) m that a level above their own voxel's answered, or none."""
    _, level = locate(texture, lattice_position(texture, where), np.full(len(where), texture.level))
    share = float((samples.level < level).mean())
    return Measured(share, math.sqrt(share * (1.0 - share) / len(where)), len(where))


def open_places(g: Geometry, corners: F64, edges: Edges, tolerance: float, seed: int) -> tuple[F64, I64]:
    """Places (N, 3) m on `edges` where a probe would be valid, and the level (N,) of each. corners (R, 3) m: all probes. Of many
    edges some, drawn at random."""
    some = np.random.default_rng([seed, 43]).permutation(len(edges.level))[: MOST_PLACES // len(ALONG)]
    first, last = corners[edges.ends[some, 0]], corners[edges.ends[some, 1]]
    places = (first[:, None] + ALONG[:, None] * (last - first)[:, None]).reshape(-1, 3)
    level = np.repeat(edges.level[some], len(ALONG))
    free = back_share(g, places, seed) <= tolerance
    return places[free], level[free]


def dead_jump(texture: VirtualTexture, places: F64, level: I64 | I32) -> dict[str, Measured]:
    """dead_jump (mean) and dead_jump_sup over `places` (N, 3) m on edges of voxels of `level` (N,); nothing without places."""
    if not len(places):
        return {}
    jump, n = dead_jumps(texture, places, level), len(places)
    return {
        "dead_jump": Measured(float(jump.mean()), float(jump.std() / math.sqrt(n)), n),
        "dead_jump_sup": Measured(float(jump.max()), 0.0, n),
    }


def dead_jumps(texture: VirtualTexture, places: F64, level: I64 | I32) -> F64:
    """The jump (N,) at each place, arguments as for `dead_jump`."""
    size = texture.finest * np.exp2(texture.level - level)
    around = np.concatenate([places[None], places[None] + STEP * size[None, :, None] * SIDES[:, None]])
    no_normal = np.zeros(
        (around.shape[0] * around.shape[1], 3)
    )  # weighs the directed part with 0: the mean over normals
    light = sample(texture, around.reshape(-1, 3), no_normal).irradiance.reshape(len(around), -1, 3).mean(axis=2)
    mean = light.mean(axis=0, dtype=np.float64)
    return np.asarray((light.max(axis=0) - light.min(axis=0)) / (mean + 0.01 * float(mean.mean()) + 1e-30), np.float64)
