"""Error of uniform grids against their number of probes: the curve that adaptive placements are held against.

Each size is tried at several random shifts of its lattice and several offsets of the samples along their normals; squared
errors are averaged over the shifts, and of the offsets the best counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F64, Scene
from ...reference.lattice import make_grid
from ...reference.progress import Progress
from ..ground_truth import GroundTruth
from .judged import KINDS, Judge, Kind
from .lazy_grid import GridSize, census, sample_grid

OFFSETS = (0.0, 0.25, 0.5, 1.0)  # voxels
Cost = Literal["probes", "valid_probes", "bytes", "entries"]
ENTRY_BYTES, ROW_BYTES = 20, 8  # a column number and four SH values; where the row begins
TEXEL_BYTES = 26  # twelve half floats and a 16-bit weight
Key = tuple[str, Kind]


@dataclass(frozen=True, eq=False)
class GridRow:
    """One size of voxel, m. cost: probes, valid ones, and form factors of the valid ones, bytes of both and of a plain 3D
    texture, means over shifts.
    error: relative RMSE by judge and kind at the best offset; se: its standard error, from the shifts; blocks: mean squares there, by
    shift and block of points (shifts, B), see `Judge.blocks`."""

    voxel: float
    cost: Mapping[Cost, float]
    error: Mapping[Key, float]
    se: Mapping[Key, float]
    blocks: Mapping[Key, F64] = field(default_factory=dict)


@dataclass(frozen=True)
class Equal:
    """What uniform grids cost at an error. bound: "" where it lies within the curve, "at least" where no measured grid is as
    good, "at most" where all are better."""

    cost: float
    bound: Literal["", "at least", "at most"]


def grid_row(
    scene: Scene, surfaces: pipeline.Surfaces, light: pipeline.PatchLight, truth: GroundTruth, asked: Sequence[Judge],
    voxel: float, shifts: int, seed: int,
) -> GridRow:  # fmt: skip
    """Measure grids of `voxel` m."""
    rng = np.random.default_rng([seed, 29, int(voxel * 1e6)])
    bounds = pipeline.probe_bounds(scene, surfaces.geometry)
    sizes: list[GridSize] = []
    keys: list[Key] = [(j.name, kind) for j in asked for kind in KINDS]
    tried: dict[Key, list[list[F64]]] = {key: [] for key in keys}
    for s in range(shifts):
        grid = make_grid(*bounds, voxel, rng.random(3))
        sizes.append(census(scene, surfaces, light, grid, seed + s))
        found = {
            name: sample_grid(scene, surfaces, light, grid, truth.points[name], OFFSETS, seed + s)
            for name in dict.fromkeys(j.points for j in asked)
        }
        for j in asked:
            for kind in KINDS:
                tried[j.name, kind].append([j.blocks(found[j.points][o], kind) for o in range(len(OFFSETS))])
    error: dict[Key, float] = {}
    se: dict[Key, float] = {}
    blocks: dict[Key, F64] = {}
    for key in keys:
        squares = np.array(tried[key])  # (shifts, offsets, B)
        best = int(squares.mean(axis=(0, 2)).argmin())
        blocks[key] = squares[:, best]
        error[key] = float(np.sqrt(max(blocks[key].mean(), 0.0)))
        each = np.sqrt(np.maximum(blocks[key].mean(axis=1), 0.0))
        se[key] = float(each.std(ddof=1) / np.sqrt(shifts)) if shifts > 1 else 0.0
    return GridRow(voxel, _mean_cost(sizes), error, se, blocks)


def _mean_cost(sizes: Sequence[GridSize]) -> dict[Cost, float]:
    probes = float(np.mean([c.probes for c in sizes]))
    valid = float(np.mean([c.probes * c.valid_share for c in sizes]))
    entries = float(np.mean([c.probes * c.valid_share * c.entries for c in sizes]))
    size = entries * ENTRY_BYTES + valid * ROW_BYTES + probes * TEXEL_BYTES
    return {"probes": probes, "valid_probes": valid, "bytes": size, "entries": entries}


def cost_at(curve: Sequence[GridRow], key: Key, cost: Cost, error: float) -> Equal:
    """Cost at which uniform grids reach `error`, linear between sizes in log cost and log error."""
    rows = sorted(curve, key=lambda row: row.cost[cost])
    costs: F64 = np.array([row.cost[cost] for row in rows])
    errors: F64 = np.minimum.accumulate([row.error[key] for row in rows])  # a finer grid can always be read coarser
    if error > errors[0]:
        return Equal(float(costs[0]), "at most")
    if error < errors[-1] or errors[-1] <= 0.0:
        return Equal(float(costs[-1]), "at least")
    i = max(1, int(np.flatnonzero(errors <= error)[0]))
    step = np.log(errors[i - 1] / errors[i])
    part = np.log(errors[i - 1] / error) / step if step > 0.0 else 1.0
    return Equal(float(np.exp(np.log(costs[i - 1]) + part * np.log(costs[i] / costs[i - 1]))), "")


def bracketing_curve(
    scene: Scene, surfaces: pipeline.Surfaces, light: pipeline.PatchLight, truth: GroundTruth, asked: Sequence[Judge],
    reached: Mapping[Key, float], like: float, step: float, most: int, shifts: int, seed: int, progress: Progress,
) -> list[GridRow]:  # fmt: skip
    """Rows from grids of about `like` probes to ever finer ones (voxels divided by `step`) until every error in `reached` is
    undercut; and to coarser ones until every error is exceeded. At most `most` rows."""
    lower, upper = pipeline.probe_bounds(scene, surfaces.geometry)
    extent = upper - lower
    extent = np.maximum(extent, 1e-3 * extent.max())  # a flat scene still has a grid
    finer = coarser = float((np.prod(extent) / like) ** (1.0 / 3.0))

    def row(voxel: float) -> GridRow:
        progress("uniform grids", len(rows), most)
        return grid_row(scene, surfaces, light, truth, asked, voxel, shifts, seed)

    rows: list[GridRow] = []
    rows.append(row(finer))
    while len(rows) < most and any(rows[0].error[key] <= value for key, value in reached.items()):
        coarser *= step
        rows.insert(0, row(coarser))
    while len(rows) < most and any(all(r.error[key] > value for r in rows) for key, value in reached.items()):
        finer /= step
        rows.append(row(finer))
    progress("uniform grids", most, most)
    return rows
