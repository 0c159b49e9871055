"""The main job: scenes in, results.json, pictures and the page out. What did not change is recalled, not recomputed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..fastpath.device import OpenDevice, open_device
from ..reference.datatypes import Scene
from ..reference.errors import InputError
from ..reference.scene import load_scene
from ..reference.variant import ensure_variant
from . import cache
from .explain.request import Dissection, camera_of
from .explain.story import with_dissection
from .flight.plan import FlightPlan
from .flight.story import with_flight
from .formats import sampling_format
from .leaks.story import recalled_story, write_story
from .measure import Keep, measure_scene
from .progress_bar import ProgressBar
from .provenance import provenance
from .report.page import write_report
from .report.pictures import CameraPictures, CameraPose, ProbeDots, SceneView
from .waterfall.world import Made

Explain = Callable[[int, str], str]
MEASURED_BY = ("reference", "fastpath", "validation/metrics")


def run_scenes(
    sources: Sequence[Path], overrides: Mapping[str, Any], seed: int, out: Path, quiet: bool, command: str,
    explain: Explain | None = None, flight: FlightPlan | None = None,
    dissected: Dissection | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Measure every scene and write the report into `out`; returns the results object. explain: the command line that applies the
    edit of a scene, by the number of its source and its name; with it leaks are explained and the files of `leaks.story` written.
    flight: the flight that is flown through each scene. dissected: whether the error is taken apart, and which pixel is explained.

    All scenes are read before the first is measured. Raises InputError for bad input, EnvironmentLacks for a machine
    that cannot run; on Ctrl-C what is finished stays in the cache, and the same command goes on from there.
    """
    ensure_variant()
    device = open_device()
    scenes = load_all(sources, overrides)
    if dissected is not None and dissected.pixel is not None and len(scenes) == 1:
        camera_of(scenes[0], dissected.pixel)  # now, not after the work
    records, views = [], []
    for number, scene in enumerate(scenes):
        with ProgressBar(scene.name, quiet) as progress:
            made: list[Made] = []  # what this scene's measuring baked: nothing bakes it again
            keep = None if dissected is None else lambda truth, baked, made=made: made.append((truth, baked))
            record, pictures = recalled(scene, device, seed, progress, alone=len(scenes) == 1, keep=keep)
            if explain is not None and record["status"] == "ok":
                story = recalled_story(result_key(scene, seed, device), scene, device, seed, progress)
                written = write_story(out, scene.name, story, explain(number, scene.name))
                record = {**record, "leaks": written["leaks"], "files": {**record["files"], **written["files"]}}
            if flight is not None and record["status"] == "ok":
                record = _flown(record, flight, scene, device, seed, progress, alone=len(scenes) == 1)
            if dissected is not None and record["status"] == "ok":
                record, pictures = _dissected(
                    (record, pictures), dissected, scene, device, seed, progress, len(scenes) == 1, made
                )
        records.append(record)
        views += pictures
    results = {
        "schema": 1,
        "provenance": provenance(device, overrides, seed, command),
        "scenes": records,
        "charts": kept_charts(scenes, seed, device),
    }
    return write_report(out, results, views)


def _flown(
    record: dict[str, Any], flight: FlightPlan, scene: Scene, device: OpenDevice, seed: int, progress: ProgressBar, alone: bool
) -> dict[str, Any]:  # fmt: skip
    """The record with the scene's flight. A flight that cannot be flown fails its scene alone, unless it is `alone`."""
    try:
        return with_flight(record, result_key(scene, seed, device), flight, scene, device, seed, progress)
    except InputError as error:
        if alone:
            raise
        return {**record, "status": "failed", "error": str(error)}


def _dissected(
    found: tuple[dict[str, Any], list[SceneView]], asked: Dissection, scene: Scene, device: OpenDevice, seed: int,
    progress: ProgressBar, alone: bool, made: Sequence[Made],
) -> tuple[dict[str, Any], list[SceneView]]:  # fmt: skip
    """Record and views with what was taken apart. What cannot be fails its scene alone, unless it is `alone`. made: truth and bake, if
    they were made just now."""
    key, one = result_key(scene, seed, device), made[0] if made else None
    try:
        return with_dissection(*found, key, asked, scene, device, seed, progress, one)
    except InputError as error:
        if alone:
            raise
        return {**found[0], "status": "failed", "error": str(error)}, found[1]


def load_all(sources: Sequence[Path], overrides: Mapping[str, Any]) -> list[Scene]:
    """Read the scenes. Raises InputError for a bad one, or two of one name (their files would overwrite each other)."""
    scenes = [load_scene(path, overrides) for path in sources]
    names = [s.name for s in scenes]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"two scenes are called {', '.join(twice)}: run them one at a time, with an --out each")
    return scenes


def result_key(scene: Scene, seed: int, device: OpenDevice) -> str:
    """Key of a finished result: all that it depends on, the layout that this device samples among it."""
    layout = sampling_format(device.info, scene.settings.sampling.reconstruction)
    return cache.key(
        "result", scene.content_hash, scene.name, seed, layout, cache.code_hash(*MEASURED_BY, "validation")
    )


def recalled(
    scene: Scene, device: OpenDevice, seed: int, progress: ProgressBar, alone: bool, keep: Keep | None = None
) -> tuple[dict[str, Any], list[SceneView]]:
    """Measure, or recall what was measured before. A scene that cannot be measured fails alone, unless it is `alone`. keep: see
    `measure_scene`; not called where the record is recalled."""
    name = result_key(scene, seed, device)
    kept = cache.load("result", name)
    if kept is not None:
        return unpack(kept)
    try:
        record, views = measure_scene(scene, device, seed, progress, keep)
    except InputError as error:
        if alone:
            raise
        return {"name": scene.name, "status": "failed", "error": str(error), "notes": list(scene.notes)}, []
    cache.store("result", name, pack(record, views))
    return record, views


def pack(record: Mapping[str, Any], views: Sequence[SceneView]) -> cache.Arrays:
    """A result as arrays."""
    arrays: cache.Arrays = {"record": cache.pack_json(record), "views": np.array(len(views))}
    for i, view in enumerate(views):
        fields = dataclasses.asdict(view.pictures)
        arrays |= {f"{i}.{k}": v for k, v in fields.items() if isinstance(v, np.ndarray)}
        plain = {k: v for k, v in fields.items() if not isinstance(v, np.ndarray)}
        arrays[f"{i}.plain"] = cache.pack_json({"pictures": plain, "pose": dataclasses.asdict(view.pose)})
        if view.dots is not None:
            arrays |= {f"{i}.dots.{k}": v for k, v in dataclasses.asdict(view.dots).items()}
    return arrays


def unpack(arrays: cache.Arrays) -> tuple[dict[str, Any], list[SceneView]]:
    """Inverse of `pack`."""
    views = []
    for i in range(int(arrays["views"])):
        plain = cache.unpack_json(arrays[f"{i}.plain"])
        own = {k.split(".", 1)[1]: v for k, v in arrays.items() if k.startswith(f"{i}.") and k != f"{i}.plain"}
        dots = {k.removeprefix("dots."): v for k, v in own.items() if k.startswith("dots.")}
        images = {k: v for k, v in own.items() if not k.startswith("dots.")}
        fields: dict[str, Any] = images | plain["pictures"]
        pictures = CameraPictures(**fields)
        views.append(SceneView(pictures, CameraPose(**plain["pose"]), ProbeDots(**dots) if dots else None))
    return cache.unpack_json(arrays["record"]), views


def kept_charts(scenes: Sequence[Scene], seed: int, device: OpenDevice) -> list[dict[str, Any]]:
    """Charts made before for exactly these scenes, to show beside them."""
    charts = []
    for scene in scenes:
        kept = cache.load("chart", result_key(scene, seed, device))
        if kept is not None:
            charts.append(cache.unpack_json(kept["chart"]))
    return charts
