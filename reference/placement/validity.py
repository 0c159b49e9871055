"""Validity of probes: the share of directions that meet the inside of something (talk, "Probes outside the world").

A probe is valid where that share is at most a tolerance. Probes have it from the rays of their form factors; here it is found for
any place, by rays alone.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64
from ..device_arrays import drop_device_cache
from ..directions import fibonacci_sphere, random_rotations
from ..visibility import Geometry, cast, to_box, vectors

RAYS = 64
RAYS_PER_BATCH = 1 << 20


def back_share(g: Geometry, positions: F64, seed: int, rays: int = RAYS) -> F64:
    """Share (N,) of `rays` Fibonacci directions, turned at random for each of `positions` (N, 3) m, that first meet the back of
    a one-sided or closed surface."""
    lattice, turns = fibonacci_sphere(rays), random_rotations(len(positions), seed)
    share = np.empty(len(positions))
    step = max(1, RAYS_PER_BATCH // rays)
    for begin in range(0, len(positions), step):
        part = positions[begin : begin + step]
        directions = np.einsum("nij,kj->nki", turns[begin : begin + step], lattice).reshape(-1, 3)
        hits = cast(g, to_box(g, np.repeat(part, rays, axis=0)), vectors(directions))
        triangle = np.array(hits.triangle).astype(np.int64)
        behind = np.array(hits.hit) & ~np.array(hits.front) & g.counts_as_back[triangle]
        share[begin : begin + step] = behind.reshape(len(part), rays).mean(axis=1)
    drop_device_cache()
    return share
