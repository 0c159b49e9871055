"""Other ways to read the probes of one placement, each a row of the chart: what it gives, and what it costs.

    per_mesh      the texture sampled once, at the middle of each mesh
    chebyshev     eight loads weighted by visibility (RTXGI-DDGI): distance maps for every texel, traced once a bake
    ratio_l1      L1 kept as bytes relative to L0 and filtered before it is decoded (Unity's Adaptive Probe Volumes)
    nonlinear     irradiance from the same four coefficients by Hazel's formula, zh3 by ZH3's (reference/reconstruction.py)
    fixed_point   fractions of 8 bits, as texture units interpolate (failure-catalogue E1)

All read the texels of the virtual texture whose rows stand beside them, at the same points. Light of an update reaches them as it
reaches the texture; what a way adds to that (ratios to encode, meshes to sample) is counted.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from ..fastpath.device import OpenDevice
from ..fastpath.other_ways import Chebyshev, FixedPoint, PerMesh, RatioL1
from ..fastpath.sampler import Sampler
from ..reference.config_base import Reconstruction
from ..reference.datatypes import F64
from ..reference.progress import Progress, silent
from ..reference.texture_types import DistanceMaps
from ..reference.transport.distance_moments import distance_moments
from ..reference.truth.points import Points
from ..reference.volume.other_ways_ratio import encode
from ..reference.volume.other_ways_visibility import served_places
from .bake import REPEATS, Baked, lifted
from .chart_rows import Target, Way, measured_row
from .report.words import number, percent, size

OF_ORDER_1: tuple[Reconstruction, ...] = ("nonlinear", "zh3")


def way_rows(
    baked: Baked, setting: str, device: OpenDevice, target: Target, progress: Progress = silent
) -> list[dict[str, Any]]:
    """The rows of all other ways on `baked`, a placement called `setting`."""
    own = baked.scene.settings.sampling.reconstruction
    ways = [
        _per_mesh(baked, setting, device),
        _chebyshev(baked, setting, device, progress),
        _ratio(baked, setting, device, target.pixels),
        _fixed(baked, setting, device, target.pixels),
        *(_reconstructed(baked, setting, device, method) for method in OF_ORDER_1 if method != own),
    ]
    return [measured_row(baked, target, way) for way in ways]


def _costs(baked: Baked, held: int, update_ms: float = 0.0) -> tuple[int, float]:
    """Bytes of the bake and of what the way holds on the device; update time with what the way adds, ms."""
    return int(baked.cost["probe_bytes"]) + held, baked.cost["probe_update_ms"] + update_ms


def _reconstructed(baked: Baked, setting: str, device: OpenDevice, method: Reconstruction) -> Way:
    sampler = Sampler(device, baked.texture, baked.storage, baked.layout, method)
    return Way(method, setting, *_costs(baked, sampler.bytes), sampler, lambda p, n, _: sampler(p, n).irradiance)


def _per_mesh(baked: Baked, setting: str, device: OpenDevice) -> Way:
    meshes = baked.scene.meshes
    middles = np.stack([0.5 * (m.vertices.min(axis=0) + m.vertices.max(axis=0)) for m in meshes])
    way = PerMesh(device, baked.texture, middles)
    dark = int((~way.light().any(axis=1)).sum())
    remark = f"{len(meshes)} meshes" + (f", {dark} of them without light at their middles" if dark else "")
    costs = _costs(baked, way.bytes, 1e3 * way.seconds)
    return Way("per_mesh", setting, *costs, way, lambda _, n, mesh: way.pixels(mesh, n), remark)


def _chebyshev(baked: Baked, setting: str, device: OpenDevice, progress: Progress) -> Way:
    maps, seconds = distance_maps(baked, progress)
    way = Chebyshev(device, baked.texture, maps)
    remark = f"{size(maps.bytes)} of distance maps for {len(maps.moments):,} texels, traced in {number(seconds)} s"
    return Way("chebyshev", setting, *_costs(baked, way.bytes), way, lambda p, n, _: way(p, n).irradiance, remark)


def distance_maps(baked: Baked, progress: Progress = silent) -> tuple[DistanceMaps, float]:
    """How far every texel of `baked` sees, and what it took to trace, s."""
    begin = time.perf_counter()
    positions, voxels, places = served_places(baked.probes.layout)
    moments = distance_moments(baked.surfaces.geometry, positions, voxels, progress=progress)
    return DistanceMaps(moments, places), time.perf_counter() - begin


def _ratio(baked: Baked, setting: str, device: OpenDevice, pixels: Points) -> Way:
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        texels = encode(baked.texture)
        times.append(1e3 * (time.perf_counter() - begin))
    way = RatioL1(device, baked.texture, texels)
    off = _deviation(baked, way, pixels)
    rms, p99 = float(np.sqrt(np.mean(off**2))), float(np.percentile(off, 99))
    remark = f"16 bytes a texel; against filtering light {percent(rms, 2)} rms, p99 {percent(p99, 2)}"
    costs = _costs(baked, way.bytes, statistics.median(times))
    return Way("ratio_l1", setting, *costs, way, lambda p, n, _: way(p, n).irradiance, remark)


def _fixed(baked: Baked, setting: str, device: OpenDevice, pixels: Points) -> Way:
    way = FixedPoint(device, baked.texture)
    off = _deviation(baked, way, pixels)
    p99, worst = float(np.percentile(off, 99)), float(off.max())
    remark = f"against exact fractions p99 {percent(p99, 2)}, worst {percent(worst, 2)}"
    return Way("fixed_point", setting, *_costs(baked, way.bytes), way, lambda p, n, _: way(p, n).irradiance, remark)


def _deviation(baked: Baked, way: RatioL1 | FixedPoint, pixels: Points) -> F64:
    """|Ê - Ê of the virtual texture| at pixels, (P,), mean over colours, relative to the mean; 0 where both are dark."""
    where = lifted(baked.scene, baked.texture, pixels)
    plain = baked.sampler(where, pixels.normals).irradiance.astype(np.float64)
    found = way(where, pixels.normals).irradiance.astype(np.float64)
    return np.asarray(np.abs(found - plain).mean(axis=1) / max(float(plain.mean()), np.finfo(np.float32).tiny))
