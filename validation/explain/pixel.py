"""One pixel explained: its light against truth at that very point, all links of the waterfall there, and the probes it reads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F64
from ...reference.errors import InputError
from ...reference.progress import Progress
from ...reference.truth.points import CameraView, Points
from ..waterfall.chain import gathered_stages, viewer_of
from ..waterfall.links import LINKS
from ..waterfall.measured import diffuse_stage
from ..waterfall.reference import Reference, paths, relative_noise
from ..waterfall.statistics import links_of
from ..waterfall.world import World
from .corners import behind_rows, corner_rows, corners, viewer_lod
from .request import PixelAddress

RAYS = 1 << 16
NOISE, MOST_PATHS = 0.003, 1 << 18  # of the truth at the pixel
SEED = 8000


def explain_pixel(w: World, address: PixelAddress, progress: Progress) -> dict[str, Any]:
    """The record's `pixel` table: camera, x, y, position, normal, sample (m), mesh; ours, truth, truth_se (W·m⁻²); links by name with
    signed (3), mean and se; probes: the eight, see `corner_rows`: what they give and `reconstruction_adds` make up ours; behind: the
    real ones behind them; voxel_m, level; finest_level: that the camera's distance lets serve there.

    Raises InputError where the pixel sees no surface.
    """
    name = address.camera
    assert name is not None
    view = w.truth.views[name]
    point = pixel_point(view, address, w.scene.name)
    progress("pixel", 0, 1)
    truth = paths(w.scene, w.truth.geometry, point, NOISE, MOST_PATHS, w.seed + SEED, progress)
    reference = truth if truth.irradiance.mean() > 0.0 else Reference(np.zeros_like(truth.irradiance), truth.spp)
    diffuse = reference
    if truth.irradiance.mean() > 0.0:
        diffuse = diffuse_stage(w, point, reference, relative_noise(reference.irradiance), progress)
    assert point.camera is not None
    stages = [reference.irradiance, diffuse.irradiance, *gathered_stages(w, point, RAYS)]
    where, normal = pipeline.lifted(w.scene, w.culled, point)[0], point.normals[0]
    lod = viewer_lod(w, where, viewer_of(w, int(point.camera[0])))
    found = corners(w, where, normal, lod)
    progress("pixel", 1, 1)
    return {
        "camera": name,
        "x": address.x,
        "y": address.y,
        "position": point.positions[0].tolist(),
        "normal": normal.tolist(),
        "sample": where.tolist(),
        "mesh": w.scene.meshes[int(point.mesh[0])].name,
        "probe_lit": w.scene.meshes[int(point.mesh[0])].lit_by_probes,
        "truth": stages[0].mean(axis=0)[0].tolist(),
        "truth_se": _se(stages[0])[0].tolist(),
        "paths": reference.spp,
        "ours": stages[-1][0, 0].tolist(),
        "links": _links(stages),
        "level": 0 if found is None else found.level,
        "finest_level": 0 if found is None else found.asked,
        "voxel_m": None if found is None else found.voxel,
        "reconstruction_adds": [0.0] * 3 if found is None else found.rest.tolist(),
        "probes": [] if found is None else corner_rows(w, where, found),
        "behind": [] if found is None else behind_rows(w, where, normal, lod),
    }


def pixel_point(view: CameraView, address: PixelAddress, scene: str) -> Points:
    """The very receiver that the picture has at that pixel."""
    at = address.y * view.camera.width + address.x
    if not view.hit[at]:
        raise InputError(
            f"scene '{scene}', --explain {address.camera}:{address.x},{address.y}: that pixel sees no surface; take another"
        )
    index = int(np.count_nonzero(view.hit[:at]))
    return view.points.part(np.array([index]))


def _links(stages: list[F64]) -> list[dict[str, Any]]:
    """Per link the signed difference by colour, its mean and standard error, and the light after it, W·m⁻²."""
    rows = []
    for link, d, after in zip(LINKS, links_of(stages), stages[1:], strict=True):
        mean = d.mean(axis=2)[:, 0]  # (B,) over colours
        rows.append(
            {
                "name": link.name,
                "label": link.label,
                "signed": d.mean(axis=0)[0].tolist(),
                "mean": float(mean.mean()),
                "se": float(mean.std(ddof=1)) / math.sqrt(len(mean)),
                "after": after.mean(axis=0)[0].tolist(),
            }
        )
    return rows


def _se(batches: F64) -> F64:
    return np.asarray(batches.std(axis=0, ddof=1) / math.sqrt(len(batches)))
