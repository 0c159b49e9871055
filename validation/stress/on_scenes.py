"""The heat map scene × failure: what of the failure catalogue can be read off a scene that was not made to provoke it.

One worker a bundled scene, `python -m lightgauge.validation.stress.on_scenes PATH SEED`: it measures the scene as `run` does (what was
measured before is recalled), bakes it once for what the record does not hold, and answers with one figure per failure beside its
limit. Failures that mean nothing on a given scene have no figure.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import cache
from ..bake import Baked
from ..processes import Ended, Processes, why_ended, workers
from ..record import dumps
from ..record_models import JsonObject
from .runner import KIND, MEASURED_BY
from .worker import Answers, leave_with_parent, own_output

MINUTES = 8.0


@dataclass(frozen=True)
class Figure:
    """A figure of the record. id: of the failure. name: metric, or cost where `of_cost`. limit: what a good scene stays under (over,
    where better is higher). what: the figure in words."""

    id: str
    name: str
    limit: float
    what: str
    better: str = "lower"
    of_cost: bool = False


# Limits are the catalogue's good values; where it has none, those of gates.toml that hold for every scene.
FIGURES = (
    Figure("A3", "closure", 1e-6, "largest row sum off 1, as kept"),
    Figure("A4", "reciprocity", 1e-6, "reciprocity error of form factors, as kept"),
    Figure("B1", "spectral_radius", 0.999, "spectral radius of the reflections", of_cost=True),
    Figure("B2", "radiosity_error", 0.01, "worst patch against the closed form"),
    Figure("B3", "energy_residual", 1e-4, "energy that the solution loses or makes"),
    Figure("B4", "patch_relrmse", 0.03, "relRMSE of light straight from the patches"),
    Figure("C3", "floor_l1", 0.1, "relRMSE of exact L1 at the point itself"),
    Figure("C4", "validity_auc", 0.99, "area under the ROC curve of validity", better="higher"),
    Figure("C7", "leak", 1e-3, "light in dark boxes over that in lit places"),
    Figure("D1", "seam_sup", 1e-5, "worst jump at a border of voxels, float32"),
    Figure("D3", "seam_sup_half", 2e-3, "worst jump at a border, half floats"),
    Figure("D4", "seam_sup_half8", 2e-3, "worst jump at a border, weight of 8 bits"),
    Figure("D5", "unlit_share", 1e-3, "points that no valid probe lights"),
    Figure("D6", "dead_jump", 0.02, "mean jump at edges between two invalid probes"),
    Figure("D7", "culled_raise", 0.02, "how much culling raised the error"),
    Figure("E1", "image_filter_deviation", 0.012, "texture units against exact fractions"),
    Figure("E4", "kernel_deviation", 1e-5, "kernel against its plain twin"),
    Figure("F1", "reference_noise", 0.05, "noise of the truth, relative"),
)


def of_record(record: Mapping[str, Any]) -> Iterator[tuple[str, JsonObject]]:
    """Cells that a scene's record holds, by id."""
    for f in FIGURES:
        if f.of_cost:
            if isinstance(record["cost"].get(f.name), int | float):
                yield f.id, cell(float(record["cost"][f.name]), None, f.limit, f.what, f.better)
        elif f.name in record["metrics"]:
            found = record["metrics"][f.name]
            yield f.id, cell(found["value"], found.get("se"), f.limit, f.what, f.better)


def cell(value: float, se: float | None, limit: float, what: str, better: str = "lower") -> JsonObject:
    """A figure of the heat map. ratio: how much of the limit is used; of a share that should be near 1 (better: higher), how much of
    what may be missing from it is missing."""
    ratio = max(value, 0.0) / limit if better == "lower" else (1.0 - value) / (1.0 - limit)
    made: JsonObject = {"value": value, "limit": limit, "better": better, "ratio": max(ratio, 0.0), "what": what}
    return {**made, "se": se} if se else made


def of_bake(baked: Baked) -> Iterator[tuple[str, JsonObject]]:
    """Cells read off the baked scene itself."""
    light = baked.coefficients[baked.probes.light_from >= 0].astype(np.float64)
    if not len(light):
        return
    mean = light[:, 0].mean()
    yield "C1", cell(*negative_share(light), 0.01, "valid probes whose linear L1 goes under zero somewhere")
    yield (
        "E3",
        cell(
            rounding(light[:, 0], 1e-4 * mean), None, 2.0**-11, "worst rounding of a probe's mean light to half floats"
        ),
    )
    texture = baked.texture
    far = np.float32(max(np.abs(p).max() for p in (texture.origin, baked.probes.octree.positions.max(axis=0))))
    step = float(np.spacing(far)) / float(texture.finest)
    yield "E5", cell(step, None, 4e-3, "step of float32 at the far corner, in finest voxels")


def negative_share(light: np.ndarray[Any, Any]) -> tuple[float, float]:
    """Of probes (N, 4, 3): the share whose irradiance is negative for some normal and colour, with its standard error. Irradiance is
    negative iff |A1 Y1 L1| > A0 Y0 L00 (failure-catalogue C1)."""
    from ...reference.sh import COSINE_A0, COSINE_A1, Y0, Y1

    slope = COSINE_A1 * Y1 * np.linalg.norm(light[:, 1:4], axis=1)
    share = float((slope > COSINE_A0 * Y0 * light[:, 0]).any(axis=1).mean())
    return share, float(np.sqrt(share * (1.0 - share) / len(light)))


def rounding(values: np.ndarray[Any, Any], least: float) -> float:
    """Worst relative change of values over `least` when they are stored as half floats under the run's own exposure."""
    from ...reference.texture_types import exposure_of

    used = values[values > least]
    scale = exposure_of(float(values.max()))
    back = (used / scale).astype(np.float16).astype(np.float64) * scale
    return float((np.abs(back - used) / used).max()) if len(used) else 0.0


def read_scene(path: Path, seed: int) -> JsonObject:
    """A scene's row of the heat map, with nothing but what was measured. Raises InputError for a scene that cannot be."""
    from ...fastpath.device import open_device
    from ...reference import pipeline
    from ...reference.progress import silent
    from ...reference.scene import load_scene
    from ...reference.variant import ensure_variant
    from ..bake import bake
    from ..progress_bar import ProgressBar
    from ..run import recalled

    ensure_variant()
    device, scene = open_device(), load_scene(path, {})
    record, _ = recalled(scene, device, seed, ProgressBar(scene.name, quiet=True), alone=True)
    surfaces = pipeline.bake_surfaces(scene, seed)
    light = pipeline.light_patches(scene, surfaces, seed)
    baked = bake(scene, device, (surfaces, light), pipeline.place(scene, surfaces, seed), seed, silent)
    return {"name": scene.name, "cells": dict([*of_record(record), *of_bake(baked)])}


def scene_rows(
    paths: Sequence[Path], seed: int, jobs: int | None, done: Callable[[str], None] = lambda _: None
) -> list[JsonObject]:
    """Rows of the heat map. A scene whose worker fails has a row that says why; Ctrl-C kills the workers."""
    processes = Processes()
    with ThreadPoolExecutor(workers(jobs)) as pool:
        try:
            found = []
            for row in pool.map(lambda path: _recalled_row(processes, path, seed), paths):
                done(row["name"])
                found.append(row)
            return found
        except BaseException:
            processes.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _recalled_row(processes: Processes, path: Path, seed: int) -> JsonObject:
    """The row kept before, or a fresh one; one that failed is not kept."""
    files = sorted(p for p in path.parent.rglob("*") if p.is_file())
    content = cache.array_hash(np.frombuffer(p.read_bytes(), np.uint8) for p in files)
    name = cache.key(KIND, "scene", path.parent.name, content, seed, cache.code_hash(*MEASURED_BY))
    kept = cache.load(KIND, name)
    if kept is not None:
        row: JsonObject = cache.unpack_json(kept["row"])
        return row
    row = _row(processes.run([sys.executable, "-m", __name__, str(path), str(seed)], MINUTES), path)
    if "error" not in row:
        cache.store(KIND, name, {"row": cache.pack_json(row)})
    return row


def _row(ended: Ended, path: Path) -> JsonObject:
    """What a worker's answers amount to."""
    row = next((line["row"] for line in ended.told if "row" in line), None)
    if row is not None and ended.code == 0:
        return {**row, "seconds": ended.seconds}
    last = (ended.tail.splitlines() or [""])[-1]
    return {
        "name": path.parent.name,
        "cells": {},
        "error": f"{why_ended(ended.code, MINUTES)}: {last}",
        "seconds": ended.seconds,
    }


def main(given: list[str] | None = None) -> int:
    """The worker's command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("path", type=Path)
    parser.add_argument("seed", type=int)
    options = parser.parse_args(given)
    answers = Answers(own_output())
    leave_with_parent()
    row = read_scene(options.path, options.seed)
    dumps(row)  # refuses NaN before it is sent
    answers.say(row=row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
