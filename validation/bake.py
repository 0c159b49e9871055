"""A placement of a scene, baked, lit and on the device, with what it costs."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..fastpath.device import OpenDevice
from ..fastpath.layout import Layout
from ..fastpath.sampler import Sampler
from ..fastpath.tile_cache import TileCache, Tiles
from ..reference import pipeline
from ..reference.datatypes import F32, Scene
from ..reference.lattice import Octree
from ..reference.progress import Progress
from ..reference.texture_types import Samples, Storage, VirtualTexture
from ..reference.truth.points import Points
from ..reference.volume.sampler import sample
from ..reference.volume.table import tile_table
from ..reference.volume.tiles import stored
from .culling.cost import culled_cost
from .formats import sampling_format

REPEATS = 5
lifted = pipeline.lifted


@dataclass(frozen=True, eq=False)
class Baked:
    """A scene through bake and update, and its texture on the device. coefficients (R, 4, 3) f32: radiance SH of the real probes.
    cost: counts, bytes and milliseconds by name. uncut: the texture as it would be with no probe culled, None where none is.
    storage, layout: how the device holds it (see `formats`). traced: the probes before culling, where they were to be kept."""

    scene: Scene
    surfaces: pipeline.Surfaces
    probes: pipeline.Probes
    light: pipeline.PatchLight
    coefficients: F32
    texture: VirtualTexture
    sampler: Sampler
    cost: dict[str, float]
    uncut: VirtualTexture | None = None
    storage: Storage = "half"
    layout: Layout = "packed"
    traced: pipeline.Probes | None = None


def bake(
    scene: Scene,
    device: OpenDevice,
    lit: tuple[pipeline.Surfaces, pipeline.PatchLight],
    octree: Octree,
    seed: int,
    progress: Progress,
    keep_traced: bool = False,
) -> Baked:
    """Probes and texture over surfaces that are baked and lit; the update is timed warm, median of REPEATS. keep_traced: what was
    culled is kept, in `Baked.traced`."""
    surfaces, light = lit
    traced = pipeline.trace_probes(scene, surfaces, octree, seed, progress)
    probes = pipeline.cull_probes(scene, surfaces, traced, seed, progress)
    uncut = None
    if probes.culled is not None and probes.culled.probes:
        uncut = pipeline.virtual_texture(traced, pipeline.update(scene, surfaces, traced, light).texels)
    kept = traced if keep_traced else None
    del traced  # what was culled is freed
    first = pipeline.update(scene, surfaces, probes, light)  # compiles the kernel
    texture = pipeline.virtual_texture(probes, first.texels)
    way = scene.settings.sampling.reconstruction
    storage, layout = sampling_format(device.info, way)
    cache = filled(device, probes, first.coefficients, storage, layout)
    sampler = Sampler(device, texture, storage, layout, way, cache)
    gathering = [timed(lambda: pipeline.probe_light(scene, surfaces, probes, light)) for _ in range(REPEATS)]
    filling = [timed(lambda: cache.relight(first.coefficients)) for _ in range(REPEATS)]
    valid = int(probes.valid.sum())
    cost = {
        "real_probes": len(probes.valid),
        "valid_probes": valid,
        "invalid_probes": len(probes.valid) - valid,
        "copied_probes": int((probes.light_from >= 0).sum()) - valid,
        "virtual_probes": probes.layout.virtual_probes,
        "tiles": probes.layout.tiles,
        "probe_bytes": probes.rows.bytes,
        "texture_bytes": sampler.bytes,
        "probe_entries": len(probes.rows.columns),
        "probe_gather_ms": 1e3 * statistics.median(gathering),
        "tile_fill_ms": 1e3 * statistics.median(filling),
        "probe_update_ms": 1e3 * (statistics.median(gathering) + statistics.median(filling)),
    }
    if probes.culled is not None:
        cost |= culled_cost(probes.culled, probes.layout.virtual_probes)
    return Baked(
        scene, surfaces, probes, light, first.coefficients, texture, sampler, cost, uncut, storage, layout, kept
    )


def filled(
    device: OpenDevice, probes: pipeline.Probes, coefficients: F32, storage: Storage, layout: Layout
) -> TileCache:
    """All tiles on the device, each in the slot of its number, lit by `coefficients` (R, 4 or 9, 3)."""
    table = tile_table(probes.layout, probes.light_from)
    cache = TileCache(device, table.tiles, storage, layout, table.used(), coefficients.shape[1] == 9)
    cache.relight(coefficients)
    slots = np.arange(table.tiles, dtype=np.int32)
    cache.put(Tiles(slots, table.parent, table.octant, table.tile_level, table.cell, table.sources))
    return cache


def timed(work: Callable[[], object]) -> float:
    """Seconds that `work` takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def plain_samples(baked: Baked, texture: VirtualTexture, points: Points, offset: float | None = None) -> Samples:
    """Samples of any texture of a baked scene as the device stores it, by the kernel's plain twin: no kernel is built for one use.
    offset: finest voxels off surfaces, the scene's if None."""
    kept = dataclasses.replace(texture, texels=stored(texture.texels, baked.storage))
    where = lifted(baked.scene, texture, points, offset)
    return sample(kept, where, points.normals, reconstruction=baked.scene.settings.sampling.reconstruction)


def sample_points(baked: Baked, points: Points, offset: float | None = None) -> Samples:
    """Kernel samples at receivers, `offset` finest voxels off surfaces (the scene's own without one)."""
    return baked.sampler(lifted(baked.scene, baked.texture, points, offset), points.normals)
