"""The seams of a baked scene in every storage format, and where they are worst."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..reference.texture_types import Storage, VirtualTexture
from ..reference.volume.tiles import fill_tiles, probe_texels, with_copies
from .bake import Baked, lifted
from .ground_truth import GroundTruth
from .metrics.error import Measured
from .metrics.seams import SeamPoints, seam_gradients, seam_jumps, seam_metrics, seam_points
from .spots import Spot

SEAM_FORMATS: dict[Storage, str] = {"float32": "", "half": "_half", "half16": "_half16", "half8": "_half8"}

GATED_FORMATS = ("float32", "half")


@dataclass(frozen=True)
class SeamFindings:
    """measured: metrics by name; across_levels: points between levels; spots: the worst places. notes: why there are none."""

    measured: dict[str, Measured]
    across_levels: int
    spots: list[Spot]
    notes: list[str]


def seam_findings(baked: Baked, truth: GroundTruth, seed: int, gated: bool = False) -> SeamFindings:
    """Jumps at voxel borders near receivers: all figures in float32 and as this device stores the texture, the worst alone in the
    other formats. gated: only GATED_FORMATS, and no gradients, which no gate asks about."""
    texture = baked.texture
    near = [(lifted(baked.scene, texture, p) - texture.origin) / texture.finest for p in truth.points.values()]
    points = seam_points(texture, np.concatenate(near) if near else None, seed)
    if not len(points.q):
        return SeamFindings(
            {}, 0, [], ["no seam metrics: the octree is one voxel, which has no border within the scene"]
        )
    light = probe_texels(*with_copies(baked.coefficients, baked.probes.light_from))
    measured: dict[str, Measured] = {}
    spots: list[Spot] = []
    for storage, suffix in SEAM_FORMATS.items():
        if gated and storage not in GATED_FORMATS:
            continue
        texels = fill_tiles(baked.probes.layout, light, storage)  # as a cache that is filled in place holds them
        stored = dataclasses.replace(texture, texels=texels)
        jumps = seam_jumps(stored, points)
        found = seam_metrics(jumps, suffix)
        if storage in ("float32", baked.storage) and not gated:
            some, steps = seam_gradients(stored, points, jumps)
            found[f"seam_gradient{suffix}"] = Measured(float(steps.max()), 0.0, len(some))
            spots += [
                _spot(stored, points, f"seam_sup{suffix}", int(jumps.relative.argmax()), found),
                _spot(stored, points, f"seam_gradient{suffix}", int(some[steps.argmax()]), found),
            ]
        else:
            found = {k: v for k, v in found.items() if k.startswith("seam_sup")}
        measured |= found
    return SeamFindings(measured, points.across_levels, spots, [])


def _spot(texture: VirtualTexture, points: SeamPoints, name: str, i: int, found: dict[str, Measured]) -> Spot:
    where = np.asarray(texture.origin + texture.finest * points.q[i], dtype=np.float64)
    return Spot(name, where, where, found[name].value)
