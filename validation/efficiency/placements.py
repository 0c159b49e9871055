"""Adaptive placements at several random shifts of the lattice: mean cost, and errors averaged over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...fastpath.device import OpenDevice
from ...reference import pipeline
from ...reference.datatypes import F64, Scene
from ...reference.lattice import Octree
from ...reference.progress import Progress, silent
from ..bake import bake, sample_points
from ..ground_truth import GroundTruth
from ..metrics.error import Measured
from .curve import Cost, Key
from .eta import own_cost
from .judged import KINDS, Judge

Place = Callable[[Scene, pipeline.Surfaces, F64], Octree]


@dataclass(frozen=True, eq=False)
class Reached:
    """cost: mean over shifts. error: root of the mean square over shifts, by judge and kind, at the best of the offsets tried; its se
    is that of the points. each: the errors of the shifts one by one there. offset: that offset, finest voxels, None for the scene's
    own. blocks: mean squares there, by shift and block of points (S, B), see `Judge.blocks`."""

    cost: Mapping[Cost, float]
    error: Mapping[Key, Measured]
    each: Mapping[Key, tuple[float, ...]]
    offset: Mapping[Key, float | None]
    blocks: Mapping[Key, F64] = field(default_factory=dict)

    def spread(self, key: Key) -> float:
        """Standard error of `error` from the shifts, which lay their lattices independently; 0 where there is one."""
        values = np.array(self.each[key])
        return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def adaptive(scene: Scene, surfaces: pipeline.Surfaces, shift: F64) -> Octree:
    """The scene's own placement with its lattice shifted."""
    return pipeline.place(scene, surfaces, 0, shift)


def random_shifts(scene: Scene, surfaces: pipeline.Surfaces, count: int, seed: int) -> F64:
    """(count, 3) shifts in finest voxels, over the coarsest voxel that anything asks for: finer ones would leave its lattice
    where it is."""
    placement = scene.settings.placement
    finest = pipeline.place(scene, surfaces, seed).grid.finest
    asked = [m.probe_size or finest for m in scene.meshes if m.lit_by_probes]
    asked += [v.probe_size or placement.min_voxel or finest for v in scene.settings.volumes.values()]
    return np.asarray(np.random.default_rng([seed, 31]).random((count, 3)) * max(1.0, max(asked) / finest))


def reached(
    scene: Scene, device: OpenDevice, lit: tuple[pipeline.Surfaces, pipeline.PatchLight], truth: GroundTruth,
    asked: Sequence[Judge], shifts: F64, seed: int, progress: Progress, place: Place = adaptive,
    offsets: Sequence[float | None] = (None,),
) -> Reached:  # fmt: skip
    """Place, bake and sample at every one of `shifts` (S, 3). offsets: of the samples along their normals, finest voxels, None for the
    scene's own; as for grids (`curve.grid_row`) the one with the smallest mean square over the shifts counts, judge by judge."""
    costs: list[Mapping[Cost, float]] = []
    errors: dict[Key, list[list[Measured]]] = {(j.name, kind): [[] for _ in offsets] for j in asked for kind in KINDS}
    blocks: dict[Key, list[list[F64]]] = {key: [[] for _ in offsets] for key in errors}
    for number, shift in enumerate(shifts):
        progress("placements", number, len(shifts))
        baked = bake(scene, device, lit, place(scene, lit[0], shift), seed + number, silent)
        costs.append(own_cost(baked.cost))
        for o, offset in enumerate(offsets):
            found = {
                name: sample_points(baked, truth.points[name], offset).irradiance.astype(np.float64)
                for name in dict.fromkeys(j.points for j in asked)
            }
            for j in asked:
                for kind in KINDS:
                    errors[j.name, kind][o].append(j.error(found[j.points], kind))
                    blocks[j.name, kind][o].append(j.blocks(found[j.points], kind))
    progress("placements", len(shifts), len(shifts))
    cost: dict[Cost, float] = {name: float(np.mean([c[name] for c in costs])) for name in costs[0]}
    means = {key: [_mean(values) for values in tried] for key, tried in errors.items()}
    best = {key: min(range(len(offsets)), key=lambda o, tried=tried: tried[o].value) for key, tried in means.items()}  # type: ignore[misc]
    return Reached(
        cost,
        {key: tried[best[key]] for key, tried in means.items()},
        {key: tuple(m.value for m in tried[best[key]]) for key, tried in errors.items()},
        {key: offsets[o] for key, o in best.items()},
        {key: np.array(blocks[key][o]) for key, o in best.items()},
    )


def _mean(values: Sequence[Measured]) -> Measured:
    """Root mean square of errors at the same points; their standard errors are one and the same noise."""
    value = float(np.sqrt(np.mean([m.value**2 for m in values])))
    return Measured(value, float(np.mean([m.se for m in values])), values[0].n, any(m.below_noise for m in values))
