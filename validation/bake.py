"""A placement of a scene, baked, lit and on the device, with what it costs."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

import numpy as np

from ..fastpath.device import OpenDevice
from ..fastpath.layout import Storage
from ..fastpath.sampler import Sampler
from ..reference import pipeline
from ..reference.datatypes import F32, F64, Samples, Scene, VirtualTexture
from ..reference.lattice import Octree
from ..reference.progress import Progress
from ..reference.truth.points import Points

STORAGE: Storage = "half16"
REPEATS = 5


@dataclass(frozen=True, eq=False)
class Baked:
    """A scene through bake and update, and its texture on the device. coefficients (R, 4, 3) f32: radiance SH of the real probes.
    cost: counts, bytes and milliseconds by name."""

    scene: Scene
    surfaces: pipeline.Surfaces
    probes: pipeline.Probes
    light: pipeline.PatchLight
    coefficients: F32
    texture: VirtualTexture
    sampler: Sampler
    cost: dict[str, float]


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
    probes = pipeline.bake_probes(scene, surfaces, octree, seed, progress)
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
    return Baked(scene, surfaces, probes, light, first.coefficients, texture, sampler, cost)


def lifted(scene: Scene, texture: VirtualTexture, points: Points, voxels: float | None = None) -> F64:
    """Where a receiver is sampled, (N, 3) m: off its surface along the normal by as many finest voxels as the scene asks for, or by
    `voxels` of them; free points stay."""
    asked = scene.settings.sampling.normal_offset if voxels is None else voxels
    offset = asked * (texture.offset_voxel or texture.finest)
    on_surface = points.mesh >= 0
    return np.asarray(points.positions + np.where(on_surface[:, None], offset, 0.0) * points.normals)


def sample_points(baked: Baked, points: Points) -> Samples:
    """Kernel samples at receivers."""
    return baked.sampler(lifted(baked.scene, baked.texture, points), points.normals)
