"""A placement of a scene, baked, lit and on the device, with what it costs."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

from ..fastpath.device import OpenDevice
from ..fastpath.layout import Storage
from ..fastpath.sampler import Sampler
from ..reference import pipeline
from ..reference.datatypes import F32, Samples, Scene, VirtualTexture
from ..reference.lattice import Octree
from ..reference.progress import Progress
from ..reference.truth.points import Points
from .culling.cost import culled_cost

STORAGE: Storage = "half16"
REPEATS = 5
lifted = pipeline.lifted


@dataclass(frozen=True, eq=False)
class Baked:
    """A scene through bake and update, and its texture on the device. coefficients (R, 4, 3) f32: radiance SH of the real probes.
    cost: counts, bytes and milliseconds by name. uncut: the texture as it would be with no probe culled, None where none is."""

    scene: Scene
    surfaces: pipeline.Surfaces
    probes: pipeline.Probes
    light: pipeline.PatchLight
    coefficients: F32
    texture: VirtualTexture
    sampler: Sampler
    cost: dict[str, float]
    uncut: VirtualTexture | None = None


def bake(
    scene: Scene,
    device: OpenDevice,
    lit: tuple[pipeline.Surfaces, pipeline.PatchLight],
    octree: Octree,
    seed: int,
    progress: Progress,
) -> Baked:
    """Probes and texture over surfaces that are baked and lit; the update is timed warm, median of REPEATS."""
    surfaces, light = lit
    traced = pipeline.trace_probes(scene, surfaces, octree, seed, progress)
    probes = pipeline.cull_probes(scene, surfaces, traced, seed, progress)
    uncut = None
    if probes.culled is not None and probes.culled.probes:
        uncut = pipeline.virtual_texture(traced, pipeline.update(scene, surfaces, traced, light).texels)
    del traced  # what was culled is freed
    first = pipeline.update(scene, surfaces, probes, light)  # compiles the kernel
    updates = [pipeline.update(scene, surfaces, probes, light) for _ in range(REPEATS)]
    texture = pipeline.virtual_texture(probes, first.texels)
    sampler = Sampler(device, texture, STORAGE)
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
        "probe_gather_ms": 1e3 * statistics.median(u.seconds["probes"] for u in updates),
        "probe_update_ms": 1e3 * statistics.median(sum(u.seconds.values()) for u in updates),
    }
    if probes.culled is not None:
        cost |= culled_cost(probes.culled, probes.layout.virtual_probes)
    return Baked(scene, surfaces, probes, light, first.coefficients, texture, sampler, cost, uncut)


def sample_points(baked: Baked, points: Points) -> Samples:
    """Kernel samples at receivers."""
    return baked.sampler(lifted(baked.scene, baked.texture, points), points.normals)
