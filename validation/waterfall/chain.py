"""The stages of the waterfall at any receivers; see links.py for what they are.

Stages that rays or paths decide come in independent batches, so that the noise of both ends of a link cancels in the cross-half
estimator (statistics.py). Batch b of a link is batch b of one stage less batch b of the other: the links of a batch add up to
its whole error, term by term. Where a reconstruction is not linear in the light, exact SH is reconstructed batch by batch: its
bias is of the order of the batches' variance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F32, F64
from ...reference.reconstruction import irradiance
from ...reference.texture_types import Viewer, VirtualTexture
from ...reference.transport.ray_gather import ray_gather
from ...reference.truth.points import Points
from ...reference.visibility import LIFT
from ...reference.volume.linear import read
from ...reference.volume.sampler import sample
from .reference import punctual
from .world import World

SEED = 6000


def gathered_stages(w: World, points: Points, rays: int, averaged: bool = False) -> list[F64]:
    """Stages 2 to 10, (B, N, 3) or (1, N, 3) each, W·m⁻². averaged: batches are averaged before anything is reconstructed."""
    where = pipeline.lifted(w.scene, w.uncut, points)
    return [*_by_rays(w, points, where, rays, averaged), *_by_probes(w, points, where, averaged)]


def _by_rays(w: World, points: Points, where: F64, rays: int, averaged: bool) -> list[F64]:
    """Stages 2 to 5: patches, and exact SH at the point and at the sample `where` (N, 3) m."""
    g, order, seed = w.surfaces.geometry, w.order, w.seed + SEED
    lights = [w.exact, w.light.radiosity.light]
    at_point = ray_gather(g, w.patches, points.positions, points.normals, lights, rays, seed, order)
    assert at_point.irradiance is not None
    direct = punctual(w.scene, g, points)
    better, baked = (_batches(e, averaged) + direct for e in at_point.irradiance)
    # Seen from a hair above the surface, as the rays start there.
    above = points.positions + LIFT * g.scale * points.normals
    sh = [_reconstructed(w, at_point.radiance, above, points.normals, averaged)]
    if np.array_equal(where, points.positions):
        sh.append(sh[0])
    else:
        at_sample = ray_gather(g, w.patches, where, points.normals, lights[1:], rays, seed, order)
        sh.append(_reconstructed(w, at_sample.radiance, where, points.normals, averaged))
    return [better, baked, *sh]


def _by_probes(w: World, points: Points, where: F64, averaged: bool) -> list[F64]:
    """Stages 6 to 10: what is interpolated from probes at `where` (N, 3) m."""
    weights = read(w.uncut, w.texels, where).weights
    light = _batches(w.probe_light, averaged)
    mixed = [(weights @ batch.reshape(len(batch), -1)).reshape(-1, *batch.shape[1:]) for batch in light]
    way = w.scene.settings.sampling.reconstruction
    better = np.stack([irradiance(way, m, points.normals) for m in mixed])

    def plain(texture: VirtualTexture) -> F64:
        return _one(sample(texture, where, points.normals, reconstruction=way).irradiance)

    uncut = plain(w.uncut)
    culled = uncut if w.culled is w.uncut else plain(w.culled)
    return [better, uncut, culled, plain(w.kept), _one(device_samples(w, points, where))]


def device_samples(w: World, points: Points, where: F64) -> F64:
    """What the run samples (N, 3), W·m⁻²: all levels, or, with sampling.lod_distance, those that a viewer at each point's camera
    gets."""
    if points.camera is None:
        return np.asarray(w.sampler(where, points.normals).irradiance, dtype=np.float64)
    out = np.zeros_like(points.positions)
    for number in np.unique(points.camera):
        mine = np.flatnonzero(points.camera == number)
        out[mine] = w.sampler(where[mine], points.normals[mine], viewer_of(w, int(number))).irradiance
    return out


def viewer_of(w: World, camera: int) -> Viewer | None:
    """Who looks through the scene's camera of that number; None where the scene lets all levels serve everywhere."""
    distance = w.scene.settings.sampling.lod_distance
    if distance is None:
        return None
    eye = list(w.scene.settings.cameras.values())[camera]
    return Viewer(np.asarray(eye.origin, dtype=np.float64), distance)


def _reconstructed(w: World, radiance: F64, positions: F64, normals: F64, averaged: bool) -> F64:
    """Irradiance (B, N, 3) from SH (B, N, K, 3), with punctual lights tagged `input` at `positions`."""
    extra = pipeline.punctual_input(w.scene, w.surfaces.geometry, positions, w.order)
    way = w.scene.settings.sampling.reconstruction
    return np.stack([irradiance(way, batch + extra, normals) for batch in _batches(radiance, averaged)])


def _batches(values: F64, averaged: bool) -> F64:
    return np.asarray(values.mean(axis=0, keepdims=True) if averaged else values)


def _one(values: F64 | F32) -> F64:
    return np.asarray(values, dtype=np.float64)[None]


def in_parts(points: Points, size: int, work: Callable[[Points], list[F64]]) -> list[F64]:
    """`work` on so many points at a time, stage by stage joined along the points."""
    n = len(points.positions)
    parts = [work(points.part(slice(i, min(i + size, n)))) for i in range(0, n, size)]
    return [np.concatenate(stage, axis=1) for stage in zip(*parts, strict=True)]
