"""The fast path's bench: the peers do the same work as the sampler, the worlds are what the rows say, lacks are said."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath import device as device_module
from lightgauge.fastpath import speed
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.sampler import Sampler
from lightgauge.reference.datatypes import F32
from lightgauge.reference.errors import EnvironmentLacks
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import irradiance
from lightgauge.reference.texture_types import VIRTUAL
from lightgauge.reference.volume.sampler import sample
from lightgauge.validation import cli, formats
from lightgauge.validation.benchmarks import fastpath_peers as peers
from lightgauge.validation.benchmarks import fastpath_rows, growth_child, registry, stream_rows
from lightgauge.validation.benchmarks.fastpath_world import World, build_world, grid_of, height, scattered, view

PROMISED = (
    "coherent_vs_image", "random_vs_image", "coherent_vs_half4", "coherent_vs_map_coordinates", "coherent_vs_drjit_texture",
    "coherent_msamples", "tiles_cost_ratio_1e6_1e3", "lods_cost_ratio_8_1", "update_ms", "clipmap_shift_ms", "flythrough_growth_mib",
)  # fmt: skip
EYE = np.array([-7.0, 3.0, 0.5])
PIXELS = (48, 27)


@pytest.fixture(scope="module")
def opened() -> OpenDevice:
    return open_device()


@pytest.fixture(scope="module")
def small() -> World:
    return build_world(32)


@pytest.fixture(scope="module")
def seen(small: World) -> tuple[F32, F32]:
    return view(small.grid, EYE, PIXELS)


def test_promised_rows_once() -> None:
    names = [name for group in registry.fastpath() for name in group.names]
    assert set(PROMISED) <= set(names) and len(set(names)) == len(names)


def test_view_is_of_the_hills(small: World, seen: tuple[F32, F32]) -> None:
    p, n = seen
    grid, above = small.grid, p[:, 1] - height(p[:, 0], p[:, 2])
    low, top = grid.origin, grid.origin + grid.extent * grid.finest
    assert p.shape == (48 * 27, 3) and (p >= low - 1e-4).all() and (p <= top + 1e-4).all()
    assert above.min() > -1e-3
    on_hills = above < 5e-3
    assert 0.3 < on_hills.mean() < 0.9  # the rest leaves the world
    assert (np.abs(p[~on_hills] - low).min(1) < 1e-3).astype(int).sum() + (
        np.abs(p[~on_hills] - top).min(1) < 1e-3
    ).sum() > 0
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-6)
    e = 1e-4
    uphill = (height(p[:, 0] + e, p[:, 2]) - height(p[:, 0] - e, p[:, 2])) / (2 * e)
    assert (np.sign(uphill) == -np.sign(n[:, 0]))[np.abs(uphill) > 0.1].mean() > 0.99


def test_worlds_hold_the_same_places(small: World) -> None:
    """Four times the ground, the same light at the same place, tiles in proportion."""
    large = build_world(64)
    p, n = scattered(small.grid, 2_000)
    inside = (np.abs(p[:, [0, 2]]) < 6.0).all(axis=1)
    one, other = (sample(w.texture, p[inside], n[inside], anchor=np.zeros(3)) for w in (small, large))
    finest = (one.level == small.grid.level) & (other.level == large.grid.level)
    assert finest.mean() > 0.2
    np.testing.assert_allclose(one.irradiance[finest], other.irradiance[finest], rtol=1e-4, atol=1e-5)
    assert 3.0 < large.layout.tiles / small.layout.tiles < 5.0
    assert 0.02 < (small.light_from < 0).mean() < 0.4


def test_peers_look_up_the_same(opened: OpenDevice, small: World, seen: tuple[F32, F32]) -> None:
    """By the book, in SciPy and in Dr.Jit: the same irradiance as the sampler's, or the ratios would compare different work."""
    texture, (p, n) = small.texture, seen
    found = Sampler(opened, texture, "float32", "packed")(p, n, anchor=np.zeros(3))
    # Eight shares add up to 1 within rounding; beside invalid probes a dense grid holds what the level above answers at its corners.
    sound = found.weight > 1.0 - 1e-6
    want, scale = found.irradiance, float(found.irradiance.mean())
    assert sound.mean() > 0.9

    def same(got: F32, tolerance: float) -> None:
        np.testing.assert_allclose(got[sound], want[sound], atol=tolerance * scale)

    at = peers.on_device(opened, p, n)
    peers.Half4(opened, texture)(at).wait()
    same(at.irradiance.get(), 1e-3)
    dense = peers.dense_grid(texture)

    def of_channels(channels: Any) -> F32:
        c = np.stack([np.asarray(channel) for channel in channels[:13]], axis=1).astype(np.float64)
        light = (c[:, :12] / c[:, 12:]).reshape(-1, 3, 4).transpose(0, 2, 1)
        return irradiance(light, n).astype(np.float32)

    same(of_channels(peers.map_coordinates(texture, dense, p)()), 1e-5)
    for way in fastpath_rows.DRJIT.values():
        looked_up = peers.drjit_texture(texture, dense, p, n, *way)()
        same(np.stack([np.asarray(c) for c in looked_up], axis=1) if way[1] else of_channels(looked_up), 1e-5)


def test_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fastpath_rows, "SIDE", 32)
    monkeypatch.setattr(fastpath_rows, "EYE", EYE)
    monkeypatch.setattr(fastpath_rows, "WIDTH", PIXELS[0])
    monkeypatch.setattr(fastpath_rows, "HEIGHT", PIXELS[1])
    monkeypatch.setattr(fastpath_rows, "view", lambda grid, eye: view(grid, eye, PIXELS))
    monkeypatch.setattr(fastpath_rows, "REPEATS", 2)
    monkeypatch.setattr(fastpath_rows, "DRJIT", {"drjit_13": ((13,), False), "drjit_16": ((16,), False)})
    wanted = frozenset({"coherent_vs_image", "random_msamples", "floor_share"})  # no peer by the wall clock
    rows = {r.name: r for r in fastpath_rows.rates(wanted, silent)}
    assert wanted <= set(rows) and "coherent_vs_map_coordinates" not in rows
    assert all(r.value > 0.0 and r.n == 2 for r in rows.values())
    share = rows["floor_cycles_per_sample"].value / rows["cycles_per_sample"].value
    assert rows["floor_share"].value == pytest.approx(share, rel=0.5)


def test_the_same_view_in_worlds_of_any_size(small: World, seen: tuple[F32, F32]) -> None:
    """Nothing is on the smallest world's faces, where larger worlds would read other voxels; and nothing else has moved."""
    p, _ = stream_rows._within(seen, EYE)
    grid, large = small.grid, grid_of(64)

    def voxels(g: Any, places: F32) -> Any:
        return np.floor((places - EYE + (EYE - g.origin)) / g.finest).astype(int)

    def outside(places: F32) -> Any:
        own = voxels(grid, places)
        return ((own < 0) | (own >= grid.extent)).any(axis=1)

    shift = np.round((grid.origin - large.origin) / grid.finest).astype(int)
    np.testing.assert_array_equal(voxels(grid, p) + shift, voxels(large, p))
    assert outside(seen[0]).any() and not outside(p).any()
    assert np.abs(p - seen[0]).max() < 1e-3


def test_timed_ratios() -> None:
    times = {"packed": np.array([2.0, 4.0]), "half4": np.array([6.0, 8.0]), "drjit_13": np.array([5.0, 5.0])}
    found = fastpath_rows.Timed(times, {}, 8_000_000)
    assert found.ratio("half4", "packed").tolist() == [3.0, 2.0] and found.rate("packed").tolist() == [4.0, 2.0]
    walls = {
        "packed": np.array([1.0]),
        "scipy": np.array([2.0]),
        "drjit_13": np.array([9.0]),
        "drjit_16": np.array([3.0]),
    }
    walls |= {"drjit_rgba": np.array([6.0]), "drjit_fused": np.array([0.5])}
    rows = {r.name: r.value for r in fastpath_rows._against_wall(fastpath_rows.Timed({}, walls, 80), "here")}
    assert rows["coherent_vs_map_coordinates"] == 16.0  # an eighth of the samples
    assert (rows["coherent_vs_drjit_texture"], rows["coherent_vs_drjit_rgba"], rows["coherent_vs_drjit_fused"]) == (
        3.0,
        6.0,
        0.5,
    )


def test_sizes_are_the_talks() -> None:
    rows = {r.name: r for r in fastpath_rows.sizes(frozenset(), silent)}
    assert rows["bytes_per_texel_talk"].value == rows["bytes_per_texel_talk"].target == 25.0
    assert rows["bytes_per_tile_talk"].value == 675.0 and rows["bytes_per_texel_packed"].value == 32.0


def test_streaming_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_rows, "SIDES", {"1e3": 32, "1e6": 64})
    monkeypatch.setattr(stream_rows, "view", lambda grid, eye: view(grid, eye, PIXELS))
    monkeypatch.setattr(stream_rows, "REPEATS", 2)
    monkeypatch.setattr(stream_rows, "FLIGHT_SIDE", 128)
    monkeypatch.setattr(stream_rows, "FLIGHT_BUDGET", 600)
    monkeypatch.setattr(stream_rows, "FRAMES", 100)
    wanted = frozenset(stream_rows.WORLD_NAMES[:1])
    (ratio, *rates) = stream_rows.worlds(wanted, silent)
    assert ratio.name == "tiles_cost_ratio_1e6_1e3" and ratio.value > 0.0 and len(rates) == 2
    rows = {r.name: r for r in stream_rows.shift(frozenset(), silent)}
    assert set(rows) == set(stream_rows.SHIFT_NAMES)
    assert 0.0 < rows["clipmap_shift_ms"].value <= rows["clipmap_shift_worst_ms"].value <= 50.0
    assert rows["tiles_per_move"].value > 0.0
    assert rows["clipmap_shift_ms"].value < rows["move_ms"].value < rows["move_wall_ms"].value


def test_update(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_rows, "UPDATE_SIDE", 32)
    monkeypatch.setattr(stream_rows, "UPDATE_PROBES", 1_500)
    monkeypatch.setattr(stream_rows, "REPEATS", 2)
    device_ms, wall = stream_rows.update(frozenset(), silent)
    assert 0.0 < device_ms.value < wall.value and device_ms.target == 10.0


def test_culled_world() -> None:
    world = build_world(32, sparse=True)
    table, virtual = stream_rows.culled(world, 1_500)
    used = np.unique(table.sources[table.sources >= 0])
    assert len(used) == 1_500 and (world.light_from[used] >= 0).all()
    assert virtual == world.layout.virtual_probes + (world.light_from >= 0).sum() - 1_500
    assert ((table.sources == VIRTUAL) >= (world.table.sources == VIRTUAL)).all()
    with pytest.raises(ValueError, match="1000000 valid probes"):
        stream_rows.culled(world, 1_000_000)


def test_the_view_has_eight_levels_of_detail() -> None:
    eye = stream_rows.lod_eye()
    p, _ = view(grid_of(stream_rows.LOD_VIEW), eye, (192, 108))
    assert stream_rows.lods_in_view(p, eye, stream_rows.LOD_FAR) == 1
    assert (
        stream_rows.lods_in_view(
            np.array([[eye[0] + d, *eye[1:]] for d in (0.5, 0.6, 1.2, 40.0)], np.float32), eye, 0.55
        )
        == 4
    )


def test_a_flight_in_a_process_of_its_own_finds_no_wrong_tile() -> None:
    found = growth_child.measure(30, 64)
    assert found["wrong"] == 0 and found["loaded"] > 0 and found["peak"] > abs(found["growth"])
    assert found["samples"] == 30 * growth_child.PIXELS[0] * growth_child.PIXELS[1]


# ---- the choice of layout


def info(kind: device_module.Kind, images: int = 256) -> device_module.DeviceInfo:
    return device_module.DeviceInfo(0, "p", "n", "3", "1", kind, 2, 1 << 33, (images,) * 3, False, images > 0)


@pytest.mark.parametrize(
    ("kind", "images", "speeds", "wanted"),
    [
        ("cpu", 256, None, ("half", "packed")),
        ("gpu", 256, None, ("half8", "images")),
        ("gpu", 0, None, ("half", "packed")),
        ("cpu", 256, {"packed": 2.0, "split": 0.5, "images": 2.5}, ("half", "packed")),  # no clear difference
        ("cpu", 256, {"packed": 2.0, "split": 9.0, "images": 0.1}, ("half", "packed")),  # split is for comparison only
        ("cpu", 256, {"packed": 2.0, "split": 0.1, "images": 4.0}, ("half8", "images")),
        ("gpu", 256, {"packed": 9.0, "split": 4.0, "images": 1.0}, ("half", "packed")),
        ("gpu", 256, {}, ("half8", "images")),
    ],
)
def test_preferred(kind: device_module.Kind, images: int, speeds: Any, wanted: tuple[str, str]) -> None:
    assert speed.preferred(info(kind, images), speeds) == wanted


def test_measured_and_remembered(opened: OpenDevice, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    monkeypatch.setattr(speed, "BUDGET_S", 0.01)
    found = speed.measure(opened)
    assert set(found) == set(speed.layouts_of(opened.info)) and min(found.values()) > 1e4
    assert formats.remembered(opened.info) is None
    formats.remember(opened.info, {"packed": 1.0, "images": 2.0})
    assert formats.remembered(opened.info) == {"packed": 1.0, "images": 2.0}
    assert formats.sampling_format(opened.info, "linear") == ("half8", "images")
    assert formats.sampling_format(opened.info, "l2") == ("half", "packed")
    other = dataclasses.replace(opened.info, driver="another")
    assert formats.remembered(other) is None  # another driver may like another layout


def test_a_driver_that_aborts_is_no_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed.sys, "executable", "/bin/false")
    assert speed.measure_isolated(info("cpu")) == {}


# ---- what the machine lacks


def test_no_device_is_3(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(device_module, "_raw_devices", list)
    assert cli.main(["run", "sphere", "--quiet"]) == 3
    assert "no OpenCL device. To mend it: pip install" in capsys.readouterr().err
    assert cli.main(["bench", "fastpath", "--row", "update_ms", "--json", "--quiet"]) == 3
    assert "not measured: update_ms: no OpenCL device" in capsys.readouterr().err
    two = ["--row", "update_ms", "--row", "bytes_per_tile_talk"]  # one needs no device
    assert cli.main(["bench", "fastpath", *two, "--json", "--quiet"]) == 3
    printed = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in printed["rows"]] == ["bytes_per_tile_talk"] and printed["lacking"] == ["update_ms"]


def test_images_on_a_device_without_them(opened: OpenDevice, small: World) -> None:
    bare = dataclasses.replace(opened, info=dataclasses.replace(opened.info, image3d=(0, 0, 0)))
    with pytest.raises(EnvironmentLacks, match=r"3D images up to .* use the packed or split layout"):
        Sampler(bare, small.texture, "half8", "images")
    assert "image" not in fastpath_rows.launches(bare, small.texture)
    assert speed.layouts_of(bare.info) == ["packed", "split"]
