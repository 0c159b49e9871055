"""Harmonic mean distance to surfaces: HM = N / Σ 1/d_i over N directions (Tatarchuk 2005; talk, "Subdivision heuristic").

A miss adds 0 to the sum, so all misses give infinity; a distance of 0 gives 0 (failure-catalogue C5).
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64
from ..directions import fibonacci_sphere, random_rotations
from ..visibility import Geometry, cast, to_box, vectors

RAYS_PER_BATCH = 1 << 21


def harmonic_mean(g: Geometry, positions: F64, rays: int, seed: int) -> F64:
    """Harmonic mean distance (N,) m from `positions` (N, 3) m, each with its own rotation of `rays` Fibonacci directions."""
    lattice = fibonacci_sphere(rays)
    result = np.empty(len(positions))
    turns = random_rotations(len(positions), seed)
    step = max(1, RAYS_PER_BATCH // rays)
    for begin in range(0, len(positions), step):
        part = positions[begin : begin + step]
        directions = np.einsum("nij,kj->nki", turns[begin : begin + step], lattice).reshape(-1, 3)
        hits = cast(g, to_box(g, np.repeat(part, rays, axis=0)), vectors(directions))
        with np.errstate(divide="ignore"):
            t = np.abs(np.array(hits.t, dtype=np.float64))  # -0 where the origin lies on the surface
            inverse = (1.0 / t).reshape(len(part), rays).sum(axis=1)
            result[begin : begin + step] = rays / inverse
    return result
