"""How far a probe sees: mean and mean squared distance to the nearest surface, by direction, in an octahedral map.

    m_k(ω) = Σ_i w_i min(t_i, reach)^k / Σ_i w_i,   w_i = max(0, ω · ω_i)^SHARPNESS,   k = 1, 2

over rays ω_i to the nearest hit t_i of either face. Distances are counted in voxels of the level that the probe serves and end at
`REACH` of them: what a sample in the voxel asks is never further away. Method and figures (14 × 14 texels and a border of one, two
halves each, exponent 50, 1.5 voxel diagonals): RTXGI-DDGI's public description, and Majercik et al. 2019, "Dynamic diffuse global
illumination with ray-traced irradiance fields".

All probes share one set of directions, so the sums are products with one matrix, and results repeat bit for bit.
"""

from __future__ import annotations

import math

import numpy as np

from ..datatypes import F32, F64
from ..directions import fibonacci_sphere
from ..octahedral import bordered_index, texel_directions
from ..progress import Progress, silent
from ..variant import ensure_variant
from ..visibility import Geometry, cast, to_box, vectors

REACH = 1.5 * math.sqrt(3.0)
SHARPNESS = 50.0
MAP_TEXELS = 14
RAYS = 1024
RAYS_PER_BATCH = 1 << 20


def distance_moments(
    g: Geometry, positions: F64, voxels: F64, texels: int = MAP_TEXELS, rays: int = RAYS, progress: Progress = silent
) -> np.ndarray:
    """Maps (M, texels + 2, texels + 2, 2) f16 of probes at `positions` (M, 3) m: mean and mean squared distance, in units of `voxels`
    (M,) m and of their squares, with their border (see `octahedral`).

    Raises ValueError on shapes that do not match, fewer than two texels, and less than a ray for each texel.
    """
    if positions.shape != (len(voxels), 3) or texels < 2 or rays < texels * texels:
        raise ValueError(
            f"expected positions (M, 3), voxels (M,), 2 texels or more and {texels * texels} rays or more, got {positions.shape}, "
            f"{voxels.shape}, {texels} and {rays}"
        )
    ensure_variant()
    directions, border = fibonacci_sphere(rays), bordered_index(texels)
    share = lobes(directions, texels)
    maps = np.zeros((len(positions), *border.shape, 2), dtype=np.float16)
    each = max(1, RAYS_PER_BATCH // rays)
    for begin in range(0, len(positions), each):
        progress("distances of probes", begin, len(positions))
        part = slice(begin, begin + each)
        found = _distances(g, positions[part], directions)
        found = np.minimum(found / voxels[part, None], REACH).astype(np.float32)
        maps[part, ..., 0] = (found @ share)[:, border]
        maps[part, ..., 1] = (found**2 @ share)[:, border]
    progress("distances of probes", len(positions), len(positions))
    return maps


def lobes(directions: F64, texels: int) -> F32:
    """Share (rays, texels²) of each of the rays' `directions` (rays, 3) in each texel of a map; columns sum to one."""
    weight = np.maximum(directions @ texel_directions(texels).T, 0.0) ** SHARPNESS
    return np.asarray(weight / weight.sum(axis=0), dtype=np.float32)


def _distances(g: Geometry, positions: F64, directions: F64) -> F32:
    """Nearest hit (N, rays) m from each of `positions` (N, 3) along each of `directions`, infinite where there is none."""
    import drjit as dr
    import mitsuba as mi

    count, rays = len(positions), len(directions)
    lane = dr.arange(
        mi.UInt32, max(count, 2) * rays
    )  # a single probe would be compiled as a constant, in a kernel of its own
    ray = lane % dr.opaque(mi.UInt32, rays)
    origins = to_box(g, np.repeat(positions, 2, axis=0) if count == 1 else positions)
    start = dr.gather(mi.Point3f, origins, lane // dr.opaque(mi.UInt32, rays))
    hits = cast(g, start, dr.gather(mi.Vector3f, vectors(directions), ray))
    return np.array(hits.t, dtype=np.float32)[: count * rays].reshape(count, rays)
