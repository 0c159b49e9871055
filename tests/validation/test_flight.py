"""A flight through a small room: paths, what is measured, what must be 0, and that what is wrong is found.

The room is 8 × 3 × 8 m with a glowing ceiling and a block; its truth is a rough one, since only its presence matters here.
"""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.residency import working_set
from lightgauge.fastpath.streamed import StreamedTexture
from lightgauge.reference.datatypes import F64
from lightgauge.reference.errors import InputError
from lightgauge.reference.progress import silent
from lightgauge.validation import cli, gates, run
from lightgauge.validation.flight import story
from lightgauge.validation.flight.change import Lag, Still, jumps
from lightgauge.validation.flight.driver import Flight, fly
from lightgauge.validation.flight.paths import DWELL, PATHS, PER_SECOND, WALKING_SPEED, Places, viewer_path
from lightgauge.validation.flight.plan import BLEND, FlightPlan, flight_plan
from lightgauge.validation.flight.record import flight_metrics, flight_table
from lightgauge.validation.flight.texels import texel_deviation
from lightgauge.validation.flight.world import World, world
from lightgauge.validation.record import load_results, validate_results
from lightgauge.validation.record_models import SceneResult
from lightgauge.validation.report.flight import draw_frames, draw_path, flight_context, steps
from lightgauge.validation.report.page import render
from small_scenes import box, scene

SETTINGS: dict[str, Any] = {
    "placement": {"min_voxel": 0.5, "probe_rays": 128},
    "radiosity": {"patch_size": 1.0, "rays": 128},
    "cameras": {"eye": {"origin": [0.5, 1.7, 0.5], "target": [4.0, 1.0, 4.0], "width": 8, "height": 8}},
    "truth": {"points": 400, "noise": 0.5, "max_spp": 512, "picture_spp": 1},
    "sampling": {"lod_distance": 1.5},
}
FRAMES = 8


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@pytest.fixture(scope="module")
def room(device: OpenDevice, tmp_path_factory: pytest.TempPathFactory) -> World:
    block = box((3.0, 0.4, 3.0), (5.0, 1.6, 5.0), inward=False)
    s = scene([box((0, 0, 0), (8, 3, 8), emission=1.0), block], **SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIGHTGAUGE_CACHE", str(tmp_path_factory.mktemp("cache")))
        return world(s, device, 0, silent)


def streamed(room: World, device: OpenDevice, budget: int) -> StreamedTexture:
    texture = StreamedTexture(device, room.table, budget, room.lod_distance, check_owners=True)
    texture.relight(room.light)
    return texture


def most_wanted(room: World, name: str = "orbit") -> int:
    path = viewer_path(name, room.places, FRAMES)
    return max(working_set(room.table, p, room.lod_distance) for p in path.positions)


def flown(room: World, device: OpenDevice, budget: int, name: str = "orbit") -> tuple[Flight, dict[str, Any]]:
    path = viewer_path(name, room.places, FRAMES)
    texture = streamed(room, device, budget)
    flight = fly(room, device, texture, path, silent)
    return flight, flight_table(room, FlightPlan(name, FRAMES, budget), path, flight, texture.bytes)


@pytest.fixture(scope="module")
def short(room: World, device: OpenDevice) -> tuple[Flight, dict[str, Any]]:
    """A flight in a cache that holds half of what is wanted."""
    return flown(room, device, most_wanted(room) // 2)


@pytest.mark.parametrize("name", PATHS)
def test_paths_are_pure_and_stay_where_the_scene_is(name: str) -> None:
    rng = np.random.default_rng(1)
    places = Places(rng.random((500, 3)) * (100.0, 8.0, 40.0), np.array([[10.0, 2.0, 5.0]]))
    path, again = (viewer_path(name, places, 30) for _ in range(2))
    assert path.positions.shape == path.targets.shape == (30, 3)
    assert (path.positions == again.positions).all() and (path.targets == again.targets).all()
    assert (path.positions >= (-1e-9, 0.0, -1e-9)).all() and (path.positions <= (100.0, 8.0, 40.0)).all()
    assert (np.linalg.norm((path.targets - path.positions)[:, [0, 2]], axis=1) > 0.01).all()


def test_paths_do_what_they_say() -> None:
    rng = np.random.default_rng(2)
    places = Places(rng.random((2000, 3)) * (100.0, 1.0, 40.0), np.array([[10.0, 2.0, 5.0], [90.0, 2.0, 5.0]]))
    walk = np.linalg.norm(np.diff(viewer_path("line", places, 20).positions[:, [0, 2]], axis=0), axis=1)
    assert walk == pytest.approx(WALKING_SPEED / PER_SECOND)
    jumps_ = viewer_path("teleport", places, 3 * DWELL).positions
    assert (jumps_[:DWELL] == places.stops[0]).all() and (jumps_[DWELL : 2 * DWELL] == places.stops[1]).all()
    moved = np.linalg.norm(np.diff(jumps_, axis=0), axis=1) > 0.0
    assert np.flatnonzero(moved).tolist() == [DWELL - 1, 2 * DWELL - 1]
    orbit = viewer_path("orbit", places, 40)
    angle = np.arctan2(*(orbit.positions - places.middle)[:, [2, 0]].T)
    assert np.unwrap(angle)[-1] - angle[0] > 6.0 and (orbit.targets == places.middle).all()


def test_change_is_measured_as_defined() -> None:
    e = [np.full((2, 3), v, dtype=np.float32) for v in (1.0, 1.5, 1.0)]
    e[1][1] = 1.0
    still = Still(2, 2.0)
    for frame in e:
        still.frame(frame)
    assert still.pops == [0.25, 0.25] and still.worst.tolist() == [0.25, 0.0]
    assert still.flickers == pytest.approx([np.sqrt(0.5) * 1.0 / 2.0])
    assert jumps(e[0], e[1], 1.0).tolist() == [0.5, 0.0]


def test_enough_tiles_cost_nothing(room: World, device: OpenDevice) -> None:
    """Nothing is missing then, so streaming is exactly the whole texture, pops of levels of detail included (E8)."""
    _, table = flown(room, device, room.table.tiles)
    s = {name: m["value"] for name, m in table["summary"].items()}
    assert s["wrong_reads"] == s["unexplained"] == s["most_missing"] == s["fell_share"] == s["evicted"] == 0
    assert s["relrmse_streaming"] < 1e-6 and s["relrmse_lod"] > 1e-3
    assert 0.0 < s["twin_deviation"] < 1e-5  # places on all sides of the viewer, whom positions are told from
    assert s["texel_deviation"] < 2.0**-11 and table["summary"]["texel_deviation"]["n"] == 27 * s["most_resident"]
    assert s["pop"] == pytest.approx(s["pop_whole"], rel=1e-4) and s["pop"] > 0.0
    assert s["flicker_blend"] < s["flicker"]
    assert s["hit_share"] < 1.0 and s["loaded"] == s["most_resident"] >= s["most_wanted"]
    assert len({row["level"] for row in table["levels_used"]}) >= 2
    # Where the finest level answers, nothing is off it.
    assert (
        table["levels_used"][0]["level"] == room.table.level and table["levels_used"][0]["off_finest"]["value"] < 1e-6
    )


def test_too_few_tiles_fall_to_parents_and_never_read_wrong(short: tuple[Flight, dict[str, Any]]) -> None:
    """The working set is twice the cache (E7)."""
    flight, table = short
    f, s = table["per_frame"], {name: m["value"] for name, m in table["summary"].items()}
    assert s["wrong_reads"] == s["unexplained"] == 0 and s["texel_deviation"] < 2.0**-11
    assert s["frames_short"] > 0 and s["fell_share"] > 0.0 and s["relrmse_streaming"] > 0.0 and s["evicted"] > 0
    assert max(f["resident"]) <= table["budget"]
    for wanted, hits, loaded, missing, fell in zip(
        f["wanted"], f["hits"], f["loaded"], f["missing"], f["fell"], strict=True
    ):
        assert 0 <= missing <= wanted and hits <= wanted and missing <= wanted - min(hits, wanted) + loaded
        assert missing > 0 or fell == 0
    loads = itertools.accumulate(a - b for a, b in zip(f["loaded"], f["evicted"], strict=True))
    assert list(loads) == f["resident"]
    assert table["summary"]["wrong_reads"]["n"] == flight.samples > 2 * FRAMES * flight.points


class _Stale(StreamedTexture):
    """Forgets to tell the windows of tiles that leave."""

    def _leave(self, plan: Any) -> None:
        self._clipmap.leave = lambda entries: None  # type: ignore[method-assign]
        super()._leave(plan)


class _Dark(StreamedTexture):
    """Answers a hundredth too dark."""

    def on_device(self, positions: Any, normals: Any, anchor: F64 | None = None, blend: float = 0.0) -> Any:
        found = super().on_device(positions, normals, anchor, blend)
        found.irradiance.__imul__(np.float32(0.99))
        found.irradiance.finish()
        return found


@pytest.mark.parametrize(("kind", "figure"), [(_Stale, "wrong_reads"), (_Dark, "unexplained")])
def test_what_is_wrong_is_found(room: World, device: OpenDevice, kind: type[StreamedTexture], figure: str) -> None:
    texture = kind(device, room.table, most_wanted(room) // 2, room.lod_distance, check_owners=True)
    texture.relight(room.light)
    path = viewer_path("orbit", room.places, 2 * FRAMES)
    flight = fly(room, device, texture, path, silent)
    assert sum(flight.frames[figure]) > 0


class _Uncle(StreamedTexture):
    """Interpolates virtual probes from the slot after the parent's."""

    def _arrive(self, plan: Any) -> int:
        put, slots = self._cache.put, self._cache.capacity

        def beside(tiles: Any) -> int:
            parent = np.where(tiles.parent >= 0, (tiles.parent + 1) % slots, -1).astype(np.int32)
            return put(dataclasses.replace(tiles, parent=parent))

        self._cache.put = beside  # type: ignore[method-assign]
        arrived = super()._arrive(plan)
        self._cache.put = put  # type: ignore[method-assign]
        return arrived


def test_texels_from_the_wrong_parent_are_found(room: World, device: OpenDevice) -> None:
    texture = _Uncle(device, room.table, most_wanted(room), room.lod_distance, check_owners=True)
    texture.relight(room.light)
    texture.move(viewer_path("orbit", room.places, FRAMES).positions[0])
    tiles, held = texture.resident_texels()
    assert len(tiles) > 20 and texel_deviation(held, room.texture.texels[tiles]) > 0.1
    held[:] = np.nan
    assert texel_deviation(held, room.texture.texels[tiles]) == 1.0
    assert texel_deviation(held[:0], room.texture.texels[:0]) == 0.0


def test_looking_away_from_everything_is_no_error(room: World, device: OpenDevice) -> None:
    outside = np.tile([30.0, 1.0, 4.0], (3, 1))
    path = dataclasses.replace(
        viewer_path("line", room.places, 3), positions=outside, targets=outside + np.array([5.0, 0.0, 0.0])
    )
    flight = fly(room, device, streamed(room, device, 50), path, silent)
    table = flight_table(room, FlightPlan("line", 3, 50), path, flight, 0)
    assert flight.frames["seen"] == [0, 0, 0] and "relrmse_lod" not in table["summary"]
    assert "in 3 frames the viewer saw no probe-lit surface" in table["notes"]
    SceneResult.model_validate({"name": "a", "status": "ok", "fly": table})


def test_record_and_page(short: tuple[Flight, dict[str, Any]]) -> None:
    _, table = short
    record = {"name": "room", "status": "ok", "fly": table, "metrics": flight_metrics(table)}
    results = {"schema": 1, "provenance": {}, "scenes": [record]}
    validate_results(results)
    assert record["metrics"]["fly_wrong_reads"] == {"value": 0.0, "n": table["summary"]["wrong_reads"]["n"]}
    assert all(len(column) == FRAMES for column in table["per_frame"].values()) and len(table["viewer"]) == FRAMES
    context = flight_context(table)
    assert context is not None and "read a tile of another place" in context["said"]
    assert len(context["levels"]) == len(table["levels_used"]) and len(context["costs"]) == 4
    assert draw_frames(table) == draw_frames(table) and draw_path(table).count("<circle") >= len(table["places"])
    html = render(results, [], [])
    assert "Fly-through" in html and "nan" not in draw_frames(table) + draw_path(table)
    assert flight_context(None) is None
    assert f"{BLEND:g}" == "0.25"  # "the last quarter" on the page


def test_axis_steps() -> None:
    assert steps(0.0) == (1.0, 1.0) and steps(10.0) == (5.0, 10.0) and steps(3.9) == (1.0, 4.0)
    for most in (0.013, 0.9, 7.0, 88.0, 12345.0):
        step, top = steps(most)
        assert top >= most and 1 <= round(top / step) <= 4


def test_finished_flights_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: FilePath) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    calls: list[FlightPlan] = []

    def once(scene: Any, device: Any, seed: int, plan: FlightPlan, progress: Any) -> dict[str, Any]:
        calls.append(plan)
        return {"summary": {"wrong_reads": {"value": 0.0, "n": plan.frames}}}

    monkeypatch.setattr(story, "flown", once)
    asked = [FlightPlan("orbit", 5), FlightPlan("orbit", 5), FlightPlan("orbit", 6), FlightPlan("line", 5)]
    made = [story.with_flight({"metrics": {"a": 1}}, "key", plan, *[None] * 4) for plan in asked]  # type: ignore[arg-type]
    assert calls == [asked[0], asked[2], asked[3]]
    assert made[0] == made[1] and made[2]["metrics"]["fly_wrong_reads"]["n"] == 6 and made[0]["metrics"]["a"] == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--tile-budget", "2000"], "add --fly with orbit, line or teleport"),
        (["--frames", "9"], "add --fly"),
        (["--fly", "loop"], "take orbit, line or teleport"),
        (["--fly", "orbit", "--tile-budget", "0"], "1 to 16,777,216"),
        (["--fly", "line", "--frames", "2"], "expected 3 to 10,000"),
    ],
)
def test_bad_options_are_refused_before_any_work(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["run", "cornell", *words]) == 2
    assert said in capsys.readouterr().err


def test_no_flight_is_asked_for_by_default() -> None:
    assert flight_plan(None, None, None) is None
    assert flight_plan("line", 7, None) == FlightPlan("line", budget=7)


def test_a_scene_without_probes_is_refused(
    device: OpenDevice, monkeypatch: pytest.MonkeyPatch, tmp_path: FilePath
) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    s = scene([box((0, 0, 0), (4, 3, 4), emission=1.0)], **SETTINGS)
    unlit = dataclasses.replace(s, meshes=tuple(dataclasses.replace(m, lit_by_probes=False) for m in s.meshes))
    with pytest.raises(InputError, match="no probe placed"):
        story.flown(unlit, device, 0, FlightPlan("orbit", 3), silent)


def test_the_command_adds_the_flight_to_the_run(
    short: tuple[Flight, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: FilePath,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path / "cache"))
    nothing: dict[str, Any] = {"status": "ok", "metrics": {}, "files": {}, "notes": []}
    monkeypatch.setattr(run, "measure_scene", lambda scene, *_: ({"name": scene.name, **nothing}, []))
    asked: list[FlightPlan] = []

    def fake(scene: Any, device: Any, seed: int, plan: FlightPlan, progress: Any) -> dict[str, Any]:
        asked.append(plan)
        if scene.name == "sphere":
            raise InputError("tile budget 3: use at least 4")
        return short[1]

    monkeypatch.setattr(story, "flown", fake)
    words = ["--fly", "line", "--tile-budget", "77", "--frames", "9", "--quiet", "--out", str(tmp_path / "out")]
    assert cli.main(["run", "cornell", *words]) == 0
    assert asked == [FlightPlan("line", 9, 77)]
    said = capsys.readouterr().out
    assert "cornell, flight: 8 frames along orbit" in said and "evicted" in said
    record = load_results(tmp_path / "out")["scenes"][0]
    assert record["fly"] == short[1] and record["metrics"]["fly_wrong_reads"]["value"] == 0
    assert "Fly-through" in (tmp_path / "out" / "index.html").read_text()
    # A scene that cannot be flown through ends the run where it is alone, and fails alone among others.
    assert cli.main(["run", "sphere", *words]) == 2 and "use at least 4" in capsys.readouterr().err
    assert cli.main(["run", "sphere", "cornell", *words]) == 1
    assert [s["status"] for s in load_results(tmp_path / "out")["scenes"]] == ["failed", "ok"]


def test_gates_of_flights_are_judged_only_where_one_was_flown(short: tuple[Flight, dict[str, Any]]) -> None:
    limits = gates.Gates.model_validate({"room": {"fly_wrong_reads": {"max": 0, "only_with": "fly"}}})
    record: dict[str, Any] = {"name": "room", "status": "ok"}

    def judged(**more: Any) -> list[str]:
        results = {"schema": 1, "provenance": {}, "scenes": [{**record, **more}]}
        found = gates.judge(gates.Results.model_validate(results), limits).judgements
        return [j.verdict for j in found]

    table = short[1]
    assert judged() == [] and judged(status="failed") == ["fail"]
    assert judged(fly=table) == ["fail"]  # the metric is missing
    assert judged(fly=table, metrics=flight_metrics(table)) == ["pass"]
    assert judged(fly=table, metrics={"fly_wrong_reads": {"value": 1.0, "n": 9}}) == ["fail"]


def test_lag_is_the_longest_wait_for_the_light() -> None:
    """The first point waits twice, once for two frames; the second is off by under 1 % of the mean and never waits."""
    lag, there = Lag(2, 1.0), np.ones((2, 3), np.float32)
    for first in (0.5, 0.9, 1.0, 0.8, 1.0):
        lag.frame(np.array([[first] * 3, [0.995] * 3], np.float32), there)
    assert lag.longest.tolist() == [2, 0] and lag.waiting.tolist() == [0, 0]
