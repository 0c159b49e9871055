"""The waterfall: its statistics on made-up links, and the whole chain in a small room.

The room is 4 × 3 × 4 m with glowing walls and a block that is black for the path tracer and gray for the bake, so that the first
link is known to be large, and a lod_distance, so that the last one is.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chance import standard_errors
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.reference import pipeline
from lightgauge.reference.errors import InputError
from lightgauge.reference.progress import silent
from lightgauge.reference.reconstruction import LUMINANCE
from lightgauge.reference.sh import irradiance
from lightgauge.reference.texture_types import Viewer
from lightgauge.reference.volume.sampler import sample
from lightgauge.validation import run
from lightgauge.validation.bake import Baked, bake, sample_points
from lightgauge.validation.explain import story
from lightgauge.validation.explain.command import explain_command
from lightgauge.validation.explain.pixel import explain_pixel, pixel_point
from lightgauge.validation.explain.request import Dissection, PixelAddress, camera_of, dissection, pixel_address
from lightgauge.validation.explain.text import pixels_text
from lightgauge.validation.metrics.error import measure_error
from lightgauge.validation.report.page import write_report
from lightgauge.validation.report.pictures import CameraPictures, CameraPose, SceneView
from lightgauge.validation.report.pixel import pixel_context
from lightgauge.validation.report.waterfall import waterfall_context
from lightgauge.validation.sources import resolve_scene
from lightgauge.validation.waterfall import chain, reference
from lightgauge.validation.waterfall import story as waterfall_story
from lightgauge.validation.waterfall.chain import gathered_stages
from lightgauge.validation.waterfall.kept import Parts
from lightgauge.validation.waterfall.links import NAMES, STAGES
from lightgauge.validation.waterfall.measured import DIFFUSE_NOISE, enough_noise, measured
from lightgauge.validation.waterfall.pictures import differences, link_pictures, thinned
from lightgauge.validation.waterfall.record import waterfall_metrics, waterfall_table
from lightgauge.validation.waterfall.reference import REMAINDER, Reference, paths_needed, relative_noise
from lightgauge.validation.waterfall.statistics import links_of, waterfall
from lightgauge.validation.waterfall.story import with_waterfall
from lightgauge.validation.waterfall.text import waterfalls_text
from lightgauge.validation.waterfall.world import World, as_baked, world
from small_scenes import box, material, scene

HALF = 2.0**-9  # four roundings to half a unit of a half float's last place
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
SETTINGS: dict[str, Any] = {
    "placement": {"min_voxel": 0.5, "probe_rays": 128},
    "radiosity": {"patch_size": 1.0, "rays": 128},
    "cameras": {"eye": {"origin": [0.5, 1.7, 0.5], "target": [2.0, 1.0, 2.0], "width": 16, "height": 12}},
    "truth": {"points": 200, "noise": 0.1, "max_spp": 512, "picture_spp": 2},
    "sampling": {"lod_distance": 0.8},
}


def made_stages(seed: int, n: int = 4000, noise: float = 0.5) -> tuple[list[np.ndarray], np.ndarray]:
    """A reference of mean 1 with noisy batches, one link decided by noisy rays, one exact; and the links as they are."""
    rng = np.random.default_rng(seed)
    links = rng.normal((0.05, -0.02), (0.1, 0.03), (n, 3, 2))
    links[..., 1] += 0.2 * links[..., 0]  # they add up rather than cancel
    light = rng.uniform(0.5, 1.5, (n, 3))
    reference = light + noise * rng.normal(size=(8, n, 3))
    middle = light + links[..., 0] + 0.3 * rng.normal(size=(8, n, 3))
    return [reference, middle, (light + links.sum(axis=-1))[None]], links


def test_links_are_found_under_noise_larger_than_they_are() -> None:
    stages, links = made_stages(1)
    away = standard_errors(16, 5)  # 16 blocks or more, five values
    found, mean = waterfall(stages), float(stages[0].mean())
    for k in range(2):
        assert abs(found.signed[k] - links[..., k].mean() / mean) < away * found.signed_se[k]
        assert abs(found.rms[k] - np.sqrt((links[..., k] ** 2).mean()) / mean) < away * found.rms_se[k]
    whole = links.sum(axis=-1)
    expected = (links[..., 0] * whole).mean() / np.sqrt((links[..., 0] ** 2).mean() * (whole**2).mean())
    assert abs(found.correlation[0] - expected) < away * found.correlation_se[0]
    assert found.signed_se[0] < 0.01 and found.rms_se[0] < 0.05


def test_what_adds_up_adds_up() -> None:
    """Signed links to the whole; cross terms to the cross-half error that the product reports; shares and remainder to 1."""
    stages, _ = made_stages(2)
    found = waterfall(stages)
    reported = measure_error(stages[-1][0], stages[0])
    assert found.closure < 1e-12
    assert found.total_rms == pytest.approx(reported["relrmse"].value, rel=1e-9)
    assert found.total_signed == pytest.approx(reported["bias"].value, rel=1e-9)
    assert np.sqrt(found.cross.sum()) == pytest.approx(found.total_rms, rel=1e-9)
    assert found.share.sum() == pytest.approx(found.explained, rel=1e-9)
    seen = (((stages[-1][0] - stages[0].mean(axis=0)) / found.reference) ** 2).mean()
    assert found.seen == pytest.approx(seen) and found.explained < 0.9  # the rest is noise of the reference
    np.testing.assert_allclose(found.cross, found.cross.T)


def test_the_intervals_cover() -> None:
    """Over 60 draws the standard errors are those of the figures, within what 60 draws can tell."""
    found = [waterfall(made_stages(seed, 400)[0]) for seed in range(10, 70)]
    for name in ("signed", "share", "correlation"):
        values = np.array([getattr(f, name) for f in found])
        said = np.array([getattr(f, f"{name}_se") for f in found]).mean(axis=0)
        np.testing.assert_allclose(said / values.std(axis=0, ddof=1), 1.0, atol=0.4)


def test_a_dark_reference_is_refused() -> None:
    with pytest.raises(ValueError, match="not dark"):
        waterfall([np.zeros((8, 5, 3)), np.ones((1, 5, 3))])


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@pytest.fixture(scope="module")
def room(device: OpenDevice, tmp_path_factory: pytest.TempPathFactory) -> World:
    walls, dark = material(), dataclasses.replace(material(0.7), truth_bsdf=BLACK)
    block = box((1.5, 0.0, 2.5), (2.5, 1.2, 3.5), inward=False, mat=1, name="block")
    s = scene([box((0, 0, 0), (4, 3, 4), emission=1.0, name="walls"), block], [walls, dark], **SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIGHTGAUGE_CACHE", str(tmp_path_factory.mktemp("cache")))
        return world(s, device, 0, silent)


def sampled_by(room: World, **changed: Any) -> World:
    """The same bake, sampled with other settings."""
    sampling = room.scene.settings.sampling.model_copy(update=changed)
    settings = room.scene.settings.model_copy(update={"sampling": sampling})
    return dataclasses.replace(room, scene=dataclasses.replace(room.scene, settings=settings))


def test_the_room(room: World, device: OpenDevice) -> None:
    """It closes; the black block shows in the first link, levels by distance in the last; without them the end of the chain is what
    a run samples, bit for bit."""
    found = measured(room, silent)
    whole, table = found.sets["camera"], waterfall_table(room, found)
    assert whole.closure < 1e-6 and waterfall_metrics(table, {})["waterfall_closure"]["value"] < 1e-6
    of_run = {"value": float(whole.total_rms), "se": 0.0, "n": 1}
    apart = [
        waterfall_metrics(table, {"relrmse": {**of_run, "value": of_run["value"] + 5.0 * whole.total_rms_se * k}})
        for k in (0, 1)
    ]
    assert [a["waterfall_disagreement"]["value"] for a in apart] == pytest.approx([0.0, 5.0])
    assert whole.signed[0] > 4.0 * whole.signed_se[0] > 0.0
    assert whole.rms[NAMES.index("device")] > 0.01 and set(found.meshes) == {"walls", "block"}
    assert sum(link["share"]["value"] for link in table["sets"]["camera"]["links"].values()) + table["sets"]["camera"][
        "remainder"
    ] == pytest.approx(1.0)  # fmt: skip
    context = waterfall_context(table, [])
    assert context is not None and "svg" in context["sets"][0]["svg"]
    plain = sampled_by(room, lod_distance=None)
    points = room.truth.points["camera"]
    last = gathered_stages(plain, points, 64)[-1][0]
    octree = pipeline.place(plain.scene, room.surfaces, 0)
    baked = bake(plain.scene, device, (room.surfaces, room.light), octree, 0, silent)
    assert np.array_equal(last, sample_points(baked, points).irradiance.astype(np.float64))


def test_a_waterfall_that_was_stopped_goes_on(
    room: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: OpenDevice
) -> None:
    """Over what a run baked, nothing is baked again; stopped before the pictures, it ends as one that was not, with no path or ray of
    the finished parts traced again."""
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    baked = Baked(
        room.scene, room.surfaces, room.probes, room.light, room.coefficients, room.culled, room.sampler, {},
        room.uncut if room.uncut is not room.culled else None, room.storage, traced=room.traced,
    )  # fmt: skip
    monkeypatch.setattr(pipeline, "bake_surfaces", never)
    again = world(room.scene, device, room.seed, silent, Parts("key"), (room.truth, baked))
    assert np.array_equal(again.exact, room.exact) and np.array_equal(again.probe_light, room.probe_light)
    assert np.array_equal(again.kept.texels, room.kept.texels) and again.probe_rays == room.probe_rays

    def asked() -> tuple[dict[str, Any], list[SceneView]]:
        return with_waterfall({"metrics": {}}, [], "key", lambda: again, silent)

    pictures = waterfall_story.link_pictures
    monkeypatch.setattr(waterfall_story, "link_pictures", interrupted)
    with pytest.raises(KeyboardInterrupt):
        asked()
    monkeypatch.setattr(waterfall_story, "link_pictures", pictures)
    with monkeypatch.context() as patch:
        for module, name in ((chain, "ray_gather"), (reference, "irradiance_at")):
            patch.setattr(module, name, never)
        kept = measured(again, silent, Parts("key"))
        world(room.scene, device, room.seed, silent, Parts("key"), (room.truth, baked))
        with pytest.raises(AssertionError, match="again"):  # it is what they stand on
            measured(again, silent)
    assert waterfall_table(again, kept) == waterfall_table(room, measured(room, silent))
    assert asked()[0]["waterfall"] == waterfall_table(again, kept)


def test_a_run_hands_its_bake_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What was measured just now is what is taken apart; a run that only measures keeps no bake."""
    made, taken, kept = ("truth", "bake"), [], []

    def measure(*asked: Any) -> tuple[dict[str, Any], list[SceneView]]:
        kept.append(asked[-1] is not None)
        if asked[-1] is not None:
            asked[-1](*made)
        return {"name": "sphere", "status": "ok"}, []

    def dissect(record: dict[str, Any], views: list[SceneView], *asked: Any) -> tuple[dict[str, Any], list[SceneView]]:
        taken.append(asked[-1])
        return record, views

    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    monkeypatch.setattr(run, "measure_scene", measure)
    monkeypatch.setattr(run, "with_dissection", dissect)
    monkeypatch.setattr(run, "write_report", lambda *_: {})
    sphere = [resolve_scene("sphere")]
    for seed, asked in ((1, Dissection(True, None)), (1, Dissection(True, None)), (2, None)):
        run.run_scenes(sphere, {}, seed, tmp_path, True, "", dissected=asked)
    assert taken == [made, None] and kept == [True, False]  # the second run recalls the record


def never(*_: object, **__: object) -> None:
    raise AssertionError("made again")


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_exact_light_is_what_probes_should_hold(room: World) -> None:
    """The retraced probes agree with the bake's own within its noise, and the exact patches with the baked ones."""
    baked = pipeline.probe_light(room.scene, room.surfaces, room.traced, room.light)[:, 0]
    lit = (room.traced.light_from >= 0) & (baked > 0.0).all(axis=1)  # outside of the walls it is dark
    assert lit.sum() > 100 and np.abs(room.probe_light.mean(axis=0)[lit, 0] / baked[lit] - 1.0).mean() < 0.03
    light = room.light.radiosity.light
    lit = light[:, 0] > 0.0  # not the block's underside, nor the sky
    assert 0.0 < np.abs(room.exact[lit] / light[lit] - 1.0).mean() < 0.03


def test_the_scene_as_the_bake_sees_it(room: World) -> None:
    baked = as_baked(room.scene)
    assert baked is not None and baked.materials[1].truth_bsdf is None and baked.materials[1].albedo[0] == 0.7
    assert as_baked(baked) is None
    glass = dataclasses.replace(
        room.scene, materials=(room.scene.materials[0], dataclasses.replace(material(), passes_light=True))
    )
    left = as_baked(glass)
    assert left is not None and [m.name for m in left.meshes] == ["walls"]


@pytest.mark.parametrize("lod_distance", [None, 0.8])
def test_a_pixel(room: World, lod_distance: float | None) -> None:
    """Its links add up to ours less truth, and its eight probes to ours, whether all levels serve or those of the camera's distance."""
    room = sampled_by(room, lod_distance=lod_distance)
    found = explain_pixel(room, PixelAddress(8, 9, "eye"), silent)
    assert (found["level"] == found["finest_level"] == room.kept.level) is (lod_distance is None)
    ours, truth = np.array(found["ours"]), np.array(found["truth"])
    np.testing.assert_allclose(np.sum([link["signed"] for link in found["links"]], axis=0), ours - truth, atol=1e-9)
    assert len(found["links"]) == STAGES - 1 and max(found["truth_se"]) < 0.05 * truth.mean()
    probes = found["probes"]
    assert len(probes) == 8 and sum(row["weight"] for row in probes) == pytest.approx(1.0)
    np.testing.assert_allclose(np.sum([row["gives"] for row in probes], axis=0), ours, rtol=1e-5)  # kernel and twin
    np.testing.assert_allclose(np.sum([row["gives"] for row in found["behind"]], axis=0), ours, rtol=HALF)
    for row in probes:
        assert (row["kind"] == "invalid") == (row["validity"] == 0.0)
        if row["kind"] == "real":
            light = room.coefficients[row["probe"]]
            share = irradiance(light, np.array(found["normal"])) * row["weight"]
            np.testing.assert_allclose(row["gives"], share, rtol=HALF)
        if "blocked" in row:
            assert row["blocked"]["mesh"] in ("walls", "block")
    assert any("blocked" in row for row in probes)  # the floor lies between the pixel and what is under it
    context = pixel_context(found, [])
    assert context is not None and len(context["probes"]) == 8
    with pytest.raises(InputError, match="16 × 12 pixels"):
        camera_of(room.scene, PixelAddress(16, 0))
    with pytest.raises(InputError, match="no camera 'nose'"):
        camera_of(room.scene, PixelAddress(0, 0, "nose"))


def test_pixels_as_they_are_typed() -> None:
    assert pixel_address("320,200") == PixelAddress(320, 200)
    assert pixel_address("in:side:3,4") == PixelAddress(3, 4, "in:side")
    for wrong in ("320", "3,4,5", "-1,2", "a,b", ":3,4", "3.5,2", ""):
        with pytest.raises(InputError, match="--explain"):
            pixel_address(wrong)
    assert dissection(False, None) is None


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("lightgauge run house --out /tmp/a --json", "lightgauge run house --out /tmp/a-pixel --explain eye:{pixel}"),
        ("lightgauge run a house --set x.y=1 --waterfall", "lightgauge run house --set x.y=1 --explain eye:{pixel}"),
        ("lightgauge run p/house/scene.toml --explain 1,2", "lightgauge run p/house/scene.toml --explain eye:{pixel}"),
        ("lightgauge report --seed=3", "lightgauge run house --seed=3 --explain eye:{pixel}"),
        ("", "lightgauge run house --explain eye:{pixel}"),
        ("lightgauge run 'unclosed", "lightgauge run house --explain eye:{pixel}"),
    ],
)
def test_the_command_of_a_click(command: str, expected: str) -> None:
    assert explain_command(command, "house", "eye") == expected


def test_a_camera_with_a_blank_is_quoted() -> None:
    assert explain_command("", "house", "my eye").endswith("--explain 'my eye':{pixel}")


def test_pictures_of_the_links_add_up() -> None:
    rng = np.random.default_rng(5)
    hit = rng.random((12, 16)) < 0.8
    stages = [rng.uniform(1.0, 2.0, (1, int(hit.sum()))) for _ in range(STAGES)]
    found = differences(stages, hit, 0)
    assert list(found) == list(NAMES) and all((picture[~hit] == 0.0).all() for picture in found.values())
    exact = (stages[-3] - stages[-4])[0] / (stages[0][0] + 0.01 * stages[0].mean())
    np.testing.assert_allclose(found["culling"][hit], exact, rtol=1e-5)
    even = differences([np.full((1, hit.sum()), 1.0 + k) for k in range(STAGES)], hit, 2)
    for picture in even.values():  # whatever window, light that is even stays even up to the picture's edge
        np.testing.assert_allclose(picture[hit], 1.0 / 1.01, rtol=1e-5)


def test_the_picture_of_levels_by_distance(room: World) -> None:
    """Over a truth of one, each pixel shows what the levels by its distance from the camera change, by the kernel's plain twin."""
    points = room.truth.views["eye"].points
    even = dataclasses.replace(room.truth.pictures["eye"], irradiance=np.ones((2, len(points.positions), 3)))
    truth = dataclasses.replace(room.truth, pictures={"eye": even})
    shown = link_pictures(dataclasses.replace(room, truth=truth), silent)["eye"]["device"]
    where = pipeline.lifted(room.scene, room.kept, points)
    lods = (None, Viewer(np.array(SETTINGS["cameras"]["eye"]["origin"]), SETTINGS["sampling"]["lod_distance"]))
    every, some = (sample(room.kept, where, points.normals, lod).irradiance @ LUMINANCE for lod in lods)
    assert np.abs(some - every).max() > 0.1
    np.testing.assert_allclose(shown.ravel(), (some - every) / 1.01, rtol=1e-3, atol=1e-5)  # half floats


def test_large_pictures_are_read_at_some_pixels(room: World) -> None:
    """Every second pixel of 16 × 12 for 48; what is read there stands for its neighbours, and nothing where no surface is seen."""
    view = room.truth.views["eye"]
    few = thinned(view, 48)
    assert few.step == 2 and few.hit.shape == (6, 8) and len(few.number) == int(few.hit.sum()) == 48
    whole = thinned(view)
    assert whole.step == 1 and np.array_equal(whole.number, np.arange(192))
    index = few.number.reshape(6, 8)
    assert np.array_equal(index, np.arange(192).reshape(12, 16)[1::2, 1::2])
    hit = np.ones((12, 16), bool)
    hit[0, 0] = False
    large = few.enlarged(index.astype(np.float32), hit)
    assert large[0, 0] == 0.0 and large[0, 1] == index[0, 0] and large[11, 15] == index[-1, -1]
    assert np.array_equal(few.points.positions, view.points.positions[few.number])


def test_noise_that_a_stage_between_may_have() -> None:
    """A share of the error, and never less than the reference's own."""
    rng = np.random.default_rng(6)
    reference = Reference(1.0 + 0.01 * rng.normal(size=(8, 500, 3)), 64)
    own = relative_noise(reference.irradiance)
    assert enough_noise(reference, np.ones((500, 3))) == pytest.approx(own, rel=0.3)
    assert enough_noise(reference, np.full((500, 3), 1.5)) == pytest.approx(0.5 * DIFFUSE_NOISE, rel=0.02)


def test_paths_that_would_explain_more() -> None:
    """Noise e² of the squared error at 64 paths: so many paths leave 3 % of it, here with every reference drawn anew."""
    assert paths_needed(64, 0.05) == paths_needed(64, 1.0) == 0
    stages, _ = made_stages(8)
    remainder = 1.0 - waterfall(stages).explained
    assert remainder > 0.1
    needed = paths_needed(64, remainder)
    finer, _ = made_stages(8, noise=0.5 * np.sqrt(64 / needed))
    assert 1.0 - waterfall(finer).explained == pytest.approx(REMAINDER, abs=0.005)


def test_links_of_stages_with_and_without_batches() -> None:
    stages, _ = made_stages(3, 10)
    d = links_of(stages)
    assert d.shape == (2, 8, 10, 3)
    np.testing.assert_allclose(d.sum(axis=0), stages[-1] - stages[0])
    assert Reference(stages[0], 64).needed == 0


def test_the_story_is_kept(room: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: OpenDevice) -> None:
    """Waterfall and pixel share one bake, and a second run needs none."""
    baked: list[int] = []
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    monkeypatch.setattr(story, "world", lambda *_: baked.append(1) or room)
    record: dict[str, Any] = {"name": "test", "status": "ok", "metrics": {}}
    pose = CameraPose((0.5, 1.7, 0.5), (2.0, 1.0, 2.0), (0.0, 1.0, 0.0), 60.0, 16, 12)
    blank = np.zeros((12, 16, 3), np.float32)
    pictures = CameraPictures("test", "eye", blank, blank, np.ones((12, 16), bool), blank, 0.1, blank[..., 0])
    asked = Dissection(True, PixelAddress(3, 4))
    runs = [
        story.with_dissection(record, [SceneView(pictures, pose)], "key", asked, room.scene, device, 0, silent)
        for _ in range(2)
    ]
    assert len(baked) == 1 and runs[0][0] == runs[1][0]
    found, views = runs[1]
    assert views[0].links is not None and set(views[0].links) == set(NAMES)
    assert found["pixel"]["x"] == 3 and 0.0 < found["metrics"]["waterfall_explained"]["value"] <= 1.0
    context = waterfall_context(found["waterfall"], views)
    assert context is not None and "LOD and clipmap" in [p["label"] for p in context["views"][0]["pictures"]]
    results = {"schema": 1, "provenance": {"command": "lightgauge run test"}, "scenes": [found], "charts": []}
    write_report(tmp_path / "out", results, views)
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "Where the error comes from" in html and "Pixel 3, 4 of camera eye" in html
    assert "Interpolation and validity" in waterfalls_text(results) and "camera eye, pixel 3,4" in pixels_text(results)
    with pytest.raises(InputError, match="sees no surface"):
        nothing = dataclasses.replace(room.truth.views["eye"], hit=np.zeros(192, dtype=np.bool_))
        pixel_point(nothing, PixelAddress(3, 4, "eye"), "test")
