"""`run --explain-leaks`: where a scene leaks, through which wall, from which probe, and the edit that stops it, measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...fastpath.device import OpenDevice
from ...reference import pipeline
from ...reference.datatypes import BitmapLayer, Scene
from ...reference.progress import Progress
from ...reference.texture_types import Samples
from ...reference.truth.points import PointSet
from ..bake import Baked, bake, lifted, sample_points
from ..ground_truth import GroundTruth, ground_truth
from ..metrics.error import Measured, measure_error
from ..metrics.leaks import in_boxes
from ..record import metric
from .edit import find_edit
from .field import LightField, Places, field_of, joined, places
from .measured import SETS, dark_boxes, leak_metrics
from .plan import plan
from .prediction import wall_points, wall_reports
from .search import Edit, Search
from .worst import by_wall, worst_places

FEW_RAYS = 256


@dataclass(frozen=True, eq=False)
class Explained:
    """record: the `leaks` table of the scene's result. layers: the edit, after what the scene had laid over it already."""

    record: dict[str, Any]
    layers: tuple[BitmapLayer, ...]


@dataclass(frozen=True, eq=False)
class _Bench:
    """What every placement of a scene that is tried here shares."""

    scene: Scene
    device: OpenDevice
    lit: tuple[pipeline.Surfaces, pipeline.PatchLight]
    truth: GroundTruth
    seed: int
    progress: Progress

    def tried(self, layers: Sequence[BitmapLayer]) -> LightField:
        """The light with layers laid over the scene, from few rays: enough to see where it comes through."""
        s = self.scene.settings
        placement = s.placement.model_copy(update={"probe_rays": min(s.placement.probe_rays, FEW_RAYS)})
        few = dataclasses.replace(self.scene, settings=s.model_copy(update={"placement": placement}))
        return dataclasses.replace(self, scene=few).baked(layers)[1]

    def baked(self, layers: Sequence[BitmapLayer]) -> tuple[Baked, LightField]:
        """The scene with layers laid over it, baked and lit."""
        scene = dataclasses.replace(self.scene, bitmap=(*self.scene.bitmap, *layers))
        octree = pipeline.place(scene, self.lit[0], self.seed)
        made = bake(scene, self.device, self.lit, octree, self.seed, self.progress)
        return made, field_of(made, made.coefficients)

    def metrics(self, baked: Baked) -> dict[str, Any]:
        """Leak, overdark and error of a placement, as results.json holds metrics."""
        sampled = {name: sample_points(baked, p) for name, p in self.truth.points.items()}
        found = leak_metrics(baked, self.truth, sampled) if self.scene.settings.expect.dark else {}
        return {
            name: entry
            for name, m in {**found, **self._errors(sampled)}.items()
            if (entry := metric(m.value, m.se, m.n)) is not None
        }

    def _errors(self, sampled: Mapping[PointSet, Samples]) -> dict[str, Measured]:
        errors = {}
        for name, estimate in self.truth.estimates.items():
            if estimate.irradiance.mean() > 0.0:
                ours = sampled[name].irradiance.astype(np.float64)
                errors[f"relrmse_{name}"] = measure_error(ours, estimate.irradiance)["relrmse"]
        return errors


def explain(scene: Scene, device: OpenDevice, seed: int, progress: Progress) -> Explained:
    """Find the scene's leaks, predict them, blame them on probes and walls, and search for the edit that stops them.

    Raises InputError as `measure_scene` does. What is kept of the ground truth is used, not traced again.
    """
    truth = ground_truth(scene, seed, progress)
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    bench = _Bench(
        scene, device, (surfaces, pipeline.light_patches(scene, surfaces, seed, progress)), truth, seed, progress
    )
    before, field = bench.baked(())
    boxes = dark_boxes(scene)
    search = Search(
        field,
        _receivers(before, truth),
        (lambda positions: in_boxes(positions, boxes)) if boxes else None,
        _mean_light(truth, scene),
        bench.tried,
    )
    edit = find_edit(search, progress)
    after = bench.baked(edit.layers)[0] if edit.layers else before
    walls = wall_points(scene, field.geometry, field.octree, field.texture, field.lift, seed)
    record = {
        "walls": [dataclasses.asdict(row) for row in wall_reports(scene, walls, field.lift)],
        "places": edit.places.count,
        "leaking": int(edit.before.leaks.sum()),
        "leaking_receivers": int(edit.before.leaks[: search.at.count].sum()),
        "through": by_wall(scene, field, edit),
        "worst": worst_places(scene, search, edit),
        "before": {"probes": len(before.probes.valid), "metrics": bench.metrics(before)},
        "after": {"probes": len(after.probes.valid), "metrics": bench.metrics(after)},
        "edit": _edit(field, edit),
        "plan": plan(field, edit),
    }
    return Explained(record, (*scene.bitmap, *edit.layers))


def _receivers(baked: Baked, truth: GroundTruth) -> Places:
    """The points of the ground truth, where the sampler is asked for them."""
    names = [n for n in SETS if n in truth.points]
    parts = [(truth.points[n], n) for n in names]
    return joined([places(lifted(baked.scene, baked.texture, p), p.normals, n) for p, n in parts])


def _mean_light(truth: GroundTruth, scene: Scene) -> float:
    """Mean irradiance of the reference, W·m⁻², where it is not dark by construction."""
    boxes, names = dark_boxes(scene), [n for n in SETS if n in truth.points]
    lit = [~in_boxes(truth.points[n].positions, boxes) for n in names]
    values = np.concatenate([truth.estimates[n].mean[mine] for n, mine in zip(names, lit, strict=True)])
    return max(float(values.mean()) if values.size else 0.0, 1e-30)


def _edit(field: LightField, edit: Edit) -> dict[str, Any]:
    """The edit in numbers. deeper: it has cells finer than placement.min_voxel, which the octree then has there and only there."""
    wanted = field.octree.grid.wanted
    return {
        "layers": [{"size_m": layer.size, "cells": len(layer.cells)} for layer in edit.layers],
        "cells": edit.cells,
        "deeper": any(layer.size < 0.99 * wanted for layer in edit.layers),
        "min_voxel_m": wanted,
        "rounds": edit.rounds,
        "grown_cells": edit.grown,
        "minimal": edit.minimal,
        "still_leaking": int(edit.after.leaks.sum()),
        "checked": edit.checked,
        "lit_in_sight": edit.in_sight,
        "through_sheets": edit.sheets,
        "refused": edit.refused,
        "stops": edit.stops and not edit.in_sight,
        "stops_walls": edit.stops,
    }
