"""The leak of a baked scene with dark boxes: light where there is none, and light missing near the walls to it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...reference.datatypes import F64, Bool, Scene
from ...reference.texture_types import Samples
from ...reference.truth.points import PointSet
from ...reference.turned import TurnedBox, turned, turned_boxes
from ...reference.visibility import Geometry
from ..bake import Baked
from ..ground_truth import GroundTruth
from ..metrics.error import Measured
from ..metrics.leaks import in_boxes, measure_band, measure_leak
from .attribution import crossings

SETS: tuple[PointSet, ...] = ("surface", "volume", "camera")


def dark_boxes(scene: Scene) -> list[TurnedBox]:
    """Where the scene says that there is no light."""
    return turned_boxes(scene.settings.expect.dark.values(), scene.settings.scene.rotation)


def leak_metrics(baked: Baked, truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> dict[str, Measured]:
    """leak, leak_worst, leak_area, overdark, and leak_band where light reaches a wall to the dark.

    Raises ValueError if the scene's dark boxes hold no point, or light.
    """
    boxes, names = dark_boxes(baked.scene), [n for n in SETS if n in truth.points]
    where = np.concatenate([truth.points[n].positions for n in names])
    ours = np.concatenate([sampled[n].irradiance.astype(np.float64) for n in names])
    batches = np.concatenate([truth.estimates[n].irradiance for n in names], axis=1)
    reference = batches.mean(axis=0)
    found = measure_leak(ours, batches, in_boxes(where, boxes))
    lifted = np.concatenate([_off_surface(truth, n) for n in names])
    band = near_the_dark(truth.geometry, lifted, boxes, baked.probes.octree.grid.wanted)
    error = measure_band(ours, reference, band)
    return found if error is None else {**found, "leak_band": error}


def _off_surface(truth: GroundTruth, name: PointSet) -> F64:
    """Points a hair off their surfaces, so that rays do not start within them."""
    p = truth.points[name]
    return np.asarray(p.positions + np.where(p.mesh[:, None] >= 0, 1e-5 * truth.geometry.scale, 0.0) * p.normals)


def near_the_dark(g: Geometry, positions: F64, boxes: list[TurnedBox], voxel: float) -> Bool:
    """Which positions (N, 3) m outside of the boxes have a surface within `voxel` m on the straight way to the nearest
    point of one: (N,)."""
    near = np.zeros(len(positions), dtype=np.bool_)
    for box in boxes:
        own = turned(positions, box.matrix.T)
        nearest = turned(np.clip(own, box.lower, box.upper), box.matrix)
        between, _, crossing = crossings(g, positions, nearest)
        near |= between & (np.linalg.norm(crossing - positions, axis=1) <= voxel)
    return near & ~in_boxes(positions, boxes)
