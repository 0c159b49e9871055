"""A streamed texture against its plain twin: which level answers and with what, at any budget and after any step
(failure-catalogue E5, E7, E8)."""

from __future__ import annotations

import dataclasses
import math
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.residency import coarsest_need, wanted_tiles, working_set
from lightgauge.fastpath.sampler import Sampler
from lightgauge.fastpath.streamed import StreamedTexture
from lightgauge.reference.datatypes import F32, F64
from lightgauge.reference.errors import InputError
from lightgauge.reference.texture_types import Samples, TileTable, Viewer, VirtualTexture
from lightgauge.reference.volume.clipmap import resident_texture, sample_resident, window_texels
from lightgauge.reference.volume.indirection import build_indirection
from lightgauge.reference.volume.layout import TileLayout, build_layout
from lightgauge.reference.volume.sampler import locate, sample
from lightgauge.reference.volume.table import tile_table
from lightgauge.reference.volume.tiles import fill_tiles, probe_texels
from small_scenes import random_tree, random_units

D0 = 6.0


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@dataclasses.dataclass(frozen=True)
class World:
    """A random world of 64³ finest voxels with a third of its probes invalid."""

    layout: TileLayout
    table: TileTable
    light: F32
    valid: Any
    texture: VirtualTexture

    def at(self, origin: F64) -> World:
        table = dataclasses.replace(self.table, origin=origin)
        return dataclasses.replace(self, table=table, texture=dataclasses.replace(self.texture, origin=origin))

    def stored(self, storage: Any) -> VirtualTexture:
        texels = fill_tiles(self.layout, probe_texels(self.light, self.valid), storage)
        return dataclasses.replace(self.texture, texels=texels)


@pytest.fixture(scope="module")
def world() -> World:
    tree, rng = random_tree(6, 0.4, 3), np.random.default_rng(4)
    layout, probes = build_layout(tree), len(tree.corners)
    light, valid = (rng.random((probes, 4, 3)) + 0.5).astype(np.float32), rng.random(probes) > 0.33
    grid = tree.grid
    texels = fill_tiles(layout, probe_texels(light, valid))
    texture = VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, build_indirection(layout), texels)
    numbers = np.where(valid, np.arange(probes), -1).astype(np.int32)
    return World(layout, tile_table(layout, numbers), light, valid, texture)


def streamed(device: OpenDevice, world: World, budget: int, **more: Any) -> StreamedTexture:
    options = {"storage": "float32", "check_owners": True, **more}
    made = StreamedTexture(device, world.table, budget, D0, **options)
    made.relight(world.light)
    return made


def points(world: World, viewer: F64, seed: int, n: int = 1500) -> tuple[F64, F32]:
    """All over the world and beyond it, near the viewer, and on borders of tiles of all levels."""
    rng = np.random.default_rng(seed)
    everywhere = rng.uniform(-4, 68, (n, 3))
    near = viewer - world.table.origin + rng.normal(size=(n, 3)) * D0
    borders = np.round(rng.uniform(0, 64, (n, 3)) / 2.0 ** rng.integers(0, 6, (n, 1))) * 2.0 ** rng.integers(
        0, 5, (n, 1)
    )
    return world.table.origin + np.concatenate([everywhere, near, borders]), random_units(3 * n, seed).astype(
        np.float32
    )


def compare(got: Samples, expected: Samples, tolerance: float = 1e-5) -> None:
    np.testing.assert_array_equal(got.level, expected.level)
    scale = np.abs(expected.irradiance).max()
    assert np.abs(got.irradiance - expected.irradiance).max() <= tolerance * scale
    assert np.abs(got.weight - expected.weight).max() <= tolerance


def stale(texture: StreamedTexture, world: World) -> int:
    """Texels that differ from a build from nothing."""
    clipmap, (tiles, slots) = texture._clipmap, texture._residency.resident()
    out = np.empty((world.table.level, *[texture.window] * 3), dtype=np.uint32)
    cl.enqueue_copy(texture._device.queue, out, clipmap.texels)
    assert clipmap.first is not None
    held = dict(zip(tiles.tolist(), slots.tolist(), strict=True))
    fresh = window_texels(world.table, held, texture.lattice.cache, clipmap.first.astype(np.int64), texture.window)
    return int((out != fresh).sum())


START = np.array([30.7, 33.1, 31.9])
WALK = ([0, 0, 0], [2, 0, 0], [-2, 0, 0], [0, 2.5, 0], [0, 0, -9], [3, 3, 3], [-14, 8, 20], [200, 0, -50], [1, 0, 0])


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_the_device_answers_as_its_twin(device: OpenDevice, world: World, share: float) -> None:
    budget = int(share * working_set(world.table, START, D0))
    texture, shorts = streamed(device, world, budget), []
    for i, step in enumerate(WALK):
        viewer = START + step
        moved = texture.move(viewer)
        p, n = points(world, viewer, i)
        resident = texture.resident_tiles()
        assert len(resident) == moved.resident <= budget
        blend = 0.3 * (i % 2)
        expected = sample_resident(world.texture, resident.tolist(), p, n, Viewer(viewer, D0, blend), viewer)
        got = texture(p, n, blend=blend)
        assert isinstance(got, Samples)
        compare(got, expected)
        assert texture.wrong_reads == 0 and stale(texture, world) == 0
        full = sample(world.texture, p, n, Viewer(viewer, D0, blend), viewer)
        wanted, rank = wanted_tiles(world.table, viewer, D0)
        short = bool((rank[~np.isin(wanted, resident)] <= 1.0).any())
        fell = full.level > got.level
        assert (full.level >= got.level).all()
        shorts.append(short and fell.any())
        if not short:  # nobody can tell that not all is there, but where viewer and point both stand outside
            outside = ((viewer < 0) | (viewer > 64)).any() & ((p < -0.5) | (p > 64.5)).any(axis=1)
            assert not fell[~outside].any()
            error = np.abs(got.irradiance - full.irradiance)[~outside].max()
            assert error <= 1e-5 * np.abs(full.irradiance).max()
    assert share == 1.0 or any(shorts) == (share < 1.0)  # what is enough at the start may fall short on the way


def test_the_twin_finds_what_a_search_finds(world: World) -> None:
    table, rng = world.table, np.random.default_rng(12)
    resident = {0}
    for tile in rng.permutation(table.tiles)[:400].tolist():
        while tile not in resident:  # with all its ancestors
            resident.add(tile)
            tile = int(table.parent[tile])
    held = {(int(table.tile_level[t]), *table.cell[t].tolist()): t for t in resident}
    q, lod = rng.uniform(0, 64, (500, 3)), rng.integers(1, table.level + 1, 500)
    slot, level = locate(resident_texture(world.texture, resident), q, lod)
    for i in range(len(q)):
        found = int(lod[i])
        while (key := (found, *np.floor(q[i] / 2.0 ** (table.level - found + 1)).astype(int).tolist())) not in held:
            found -= 1
        assert (slot[i], level[i]) == (held[key], found)
    assert (level < lod).mean() > 0.2
    with pytest.raises(ValueError, match="root tile must be resident"):
        resident_texture(world.texture, resident - {0})


@pytest.mark.parametrize(("storage", "layout"), [("half", "packed"), ("half8", "images")])
def test_half_floats_and_images(device: OpenDevice, world: World, storage: Any, layout: Any) -> None:
    texture, stored = streamed(device, world, 300, storage=storage, layout=layout), world.stored(storage)
    for i, step in enumerate(WALK[:6]):
        texture.move(START + step)
        p, n = points(world, START + step, i)
        resident = texture.resident_tiles().tolist()
        expected = sample_resident(stored, resident, p, n, Viewer(START + step, D0), START + step)
        got = texture(p, n)
        assert isinstance(got, Samples) and texture.wrong_reads == 0
        same = got.level == expected.level  # a filter's fractions of 8 bits may decide otherwise at the least weight
        assert same.mean() > (0.999 if layout == "images" else 0.99999)
        error = np.abs(got.irradiance - expected.irradiance)[same].max() / np.abs(expected.irradiance).max()
        assert error <= (2e-2 if layout == "images" else 5e-4)


def test_far_from_the_origin_it_is_the_same(device: OpenDevice, world: World) -> None:
    """E5: 131 km away, the texture moved along, single precision resolves 16 mm; the answers are those at the origin, to the bit. The
    places are multiples of 2⁻³⁰ m, which double precision holds there too: no tie at an edge is rounded otherwise."""
    far = np.array([1.0, -1.0, 1.0]) * 2.0**17
    here, there = streamed(device, world, 400), streamed(device, world.at(far), 400)
    for i, step in enumerate(WALK[:7]):
        viewer = np.round((START + step) * 2.0**30) / 2.0**30
        here.move(viewer)
        there.move(viewer + far)
        p, n = points(world, viewer, i)
        p = np.round(p * 2.0**30) / 2.0**30
        near, away = here(p, n), there((p + far), n)
        assert isinstance(near, Samples) and isinstance(away, Samples)
        np.testing.assert_array_equal(near.level, away.level)
        np.testing.assert_array_equal(near.irradiance, away.irradiance)
        np.testing.assert_array_equal(here.resident_tiles(), there.resident_tiles())
        expected = sample_resident(
            world.at(far).texture, there.resident_tiles().tolist(), p + far, n, Viewer(viewer + far, D0), viewer + far
        )
        compare(away, expected)
        assert there.wrong_reads == 0


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_an_orbit_within_a_budget(device: OpenDevice, world: World, share: float) -> None:
    """E7: evictions settle, no tile of another place is read, what is absent is answered for by its parent."""
    budget = int(share * working_set(world.table, START, D0))
    texture, evicted, fell = streamed(device, world, budget), [], 0
    p, n = points(world, START, 9, 500)
    for t in np.arange(0, 4 * math.pi, math.pi / 12):
        viewer = START + 3 * np.array([math.cos(t), 0.3 * math.sin(2 * t), math.sin(t)])
        moved = texture.move(viewer)
        evicted.append(moved.evicted)
        got = texture(p, n)
        assert isinstance(got, Samples) and texture.wrong_reads == 0 and moved.resident <= budget
        full = sample(world.texture, p, n, Viewer(viewer, D0), viewer)
        fell += int((got.level < full.level).sum())
        assert moved.wanted >= moved.hits + moved.loaded and moved.missing >= max(0, moved.wanted - budget)
    if share == 2.0:
        assert sum(evicted[24:]) == 0 and fell == 0
    else:
        assert 0 < np.mean(evicted[24:]) < 0.2 * budget
    assert (fell > 0) == (share == 0.5) or share == 1.0


def test_a_texel_that_points_to_another_tile_is_found(device: OpenDevice, world: World) -> None:
    texture = streamed(device, world, 400)
    texture.move(START)
    p, n = points(world, START, 1)
    assert texture(p, n) is not None and texture.wrong_reads == 0
    texels = np.empty(world.table.level * texture.window**3, dtype=np.uint32)
    cl.enqueue_copy(device.queue, texels, texture._clipmap.texels)
    for level in range(1, world.table.level + 1):
        used = np.flatnonzero(texels >> 24 == level)
        texels[used] = np.roll(texels[used], 1)
    cl.enqueue_copy(device.queue, texture._clipmap.texels, texels)
    texture(p, n)
    assert texture.wrong_reads > 0


def on_device(device: OpenDevice, value: Any) -> Any:
    return pyopencl.array.to_device(device.queue, np.ascontiguousarray(value, dtype=np.float32))


def test_where_the_level_did_not_change_nothing_did(device: OpenDevice, world: World) -> None:
    """Temporal: after a one-texel shift of the clipmap, bit for bit."""
    texture = streamed(device, world, 3000)
    p, n = points(world, START, 5)
    arrays = on_device(device, p), on_device(device, n)
    before = None
    for step in ([0, 0, 0], [2, 0, 0], [2, 2, 0], [2, 2, -2], [4, 4, 0]):
        assert texture.move(START + step).missing == 0
        found = texture.on_device(*arrays, anchor=np.zeros(3))
        assert int(found.wrong.get().sum()) == 0
        after = found.host()
        if before is not None:
            same = before.level == after.level
            assert 0.5 < same.mean() < 1.0
            np.testing.assert_array_equal(before.irradiance[same], after.irradiance[same])
        before = after


def test_blending_lowers_the_pop(device: OpenDevice, world: World) -> None:
    """E8: the largest change from frame to frame, light and points at rest, viewer at 5 cm a frame. Random light is the worst
    there is. Places on borders and beyond the world, which are moved to its faces, are left out: there an edge between invalid
    probes has no light of its own, and the rounding of a position relative to the viewer decides whether it is read at all."""
    texture = streamed(device, world, 3000)
    p, n = (a[:3000] for a in points(world, START, 6))
    inside = ((p > world.table.origin) & (p < world.table.origin + 64.0)).all(axis=1)
    p, n = p[inside], n[inside]
    arrays = on_device(device, p), on_device(device, n)
    pops = {}
    for blend in (0.0, 0.25):
        frames = []
        for t in range(24):
            texture.move(START + np.array([0.05 * t, 0, 0]))
            frames.append(texture.on_device(*arrays, anchor=np.zeros(3), blend=blend).host().irradiance)
        change = np.abs(np.diff(frames, axis=0))
        pops[blend] = float(change.max() / np.mean(frames))
    assert pops[0.0] > 0.1 and pops[0.25] < 0.2 * pops[0.0]


def test_new_light_reaches_the_tiles_that_are_there_and_those_that_come(device: OpenDevice, world: World) -> None:
    texture = streamed(device, world, 300)
    texture.move(START)
    p, n = points(world, START, 7)
    first = texture(p, n)
    texture.relight(2.0 * world.light)
    twice = texture(p, n)
    assert isinstance(first, Samples) and isinstance(twice, Samples)
    np.testing.assert_array_equal(twice.irradiance, 2.0 * first.irradiance)
    texture.move(START + np.array([9.0, 0, 0]))
    later = texture(p, n)
    assert isinstance(later, Samples)
    viewer = Viewer(START + np.array([9.0, 0, 0]), D0)
    expected = sample_resident(world.texture, texture.resident_tiles().tolist(), p, n, viewer, viewer.position)
    compare(dataclasses.replace(later, irradiance=later.irradiance / 2), expected)


def test_per_move_spreads_the_loading(device: OpenDevice, world: World) -> None:
    texture, loaded = streamed(device, world, 2000, per_move=50), []
    for _ in range(40):
        moved = texture.move(START)
        loaded.append(moved.loaded)
        assert moved.bytes > 0 if moved.loaded else moved.bytes == 0
        got = texture(*points(world, START, 8, 100))
        assert texture.wrong_reads == 0 and got is not None
        if not moved.missing:
            break
    assert max(loaded) == 50 and len(loaded) > 5 and moved.missing == 0
    assert texture.move(START) == dataclasses.replace(
        moved, hits=moved.wanted, loaded=0, bytes=0, shifted_lods=0, seconds=0.0, clipmap_seconds=0.0
    )


def resident_kib() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() // 1024


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads the process's size from /proc")
def test_frames_leave_no_memory_behind(device: OpenDevice, world: World) -> None:
    """PoCL's device memory is the process's own. The first rounds grow what is kept; later ones nothing."""
    texture = streamed(device, world, 300, check_owners=False)
    p, n = points(world, START, 10, 100)
    arrays = on_device(device, p), on_device(device, n)

    def frames(count: int) -> None:
        for t in range(count):
            angle = 2 * math.pi * t / 40  # the same 40 places again and again
            texture.move(START + 5 * np.array([math.cos(angle), 0.2 * math.sin(2 * angle), math.sin(angle)]))
            texture.on_device(*arrays, anchor=START).event.wait()

    frames(120)
    before = resident_kib()
    frames(200)
    assert resident_kib() - before < 1024


def test_bad_input(device: OpenDevice, world: World) -> None:
    table = world.table
    for budget in (0, -5):
        with pytest.raises(InputError, match="coarsest level of detail in use alone needs 1 tiles"):
            StreamedTexture(device, table, budget, D0)
    for distance in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match="lod_distance must be above 0"):
            StreamedTexture(device, table, 100, distance)
    with pytest.raises(InputError, match="tiles per move"):
        StreamedTexture(device, table, 100, D0, per_move=0)
    with pytest.raises(ValueError, match="packed"):
        StreamedTexture(device, table, 100, D0, layout="split")
    texture = StreamedTexture(device, table, 100, D0, storage="float32")
    one = np.zeros((1, 3), np.float32)
    with pytest.raises(ValueError, match="call relight before move"):
        texture.move(START)
    with pytest.raises(InputError, match="come from different bakes"):
        texture.relight(world.light[1:])
    texture.relight(world.light)
    with pytest.raises(ValueError, match="call move before sampling"):
        texture(one, one)
    for bad in (np.zeros(2), np.full(3, np.nan)):
        with pytest.raises(ValueError, match="viewer of three finite numbers"):
            texture.move(bad)
    texture.move(START)
    for checked in (texture, streamed(device, world, 100)):
        checked.move(START)
        for p, n in (
            (np.zeros((2, 3)), np.zeros((3, 3))),
            (np.zeros((2, 2)), np.zeros((2, 2))),
            (np.zeros((1, 3), int), one),
        ):
            with pytest.raises(ValueError, match="expected"):
                checked(p, n)
    nan = np.array([[np.nan, 1, 1], [1.0, 1, 1]])
    got = texture(nan, np.array([[0.0, 1, 0]] * 2))
    assert isinstance(got, Samples) and np.isnan(got.irradiance[0]).all() and np.isfinite(got.irradiance[1]).all()


def test_a_texture_that_fits_whole_is_the_whole_texture(device: OpenDevice, world: World) -> None:
    """With all tiles in the cache, a distance wider than the world: the static sampler's answers."""
    texture = StreamedTexture(device, world.table, world.table.tiles, 1e4, storage="float32")
    texture.relight(world.light)
    assert texture.move(START).resident == world.table.tiles
    p, n = points(world, START, 11)
    got, expected = texture(p, n), Sampler(device, world.texture, "float32", "packed")(p, n, anchor=START)
    assert isinstance(got, Samples)
    np.testing.assert_array_equal(got.level, expected.level)
    np.testing.assert_allclose(got.irradiance, expected.irradiance, rtol=0, atol=1e-6)


def test_a_budget_must_hold_the_coarsest_level_in_use(device: OpenDevice, world: World) -> None:
    """A long lod_distance asks for fine tiles everywhere: all of them up to the level of the world's far corner must fit."""
    table = world.table
    across = float(np.linalg.norm(table.extent)) * table.finest
    for rings in (0, 1, 2):
        distance = 1.001 * across / 2**rings
        need = int((table.tile_level <= table.level - rings).sum())
        assert coarsest_need(table, distance) == need > 1
        with pytest.raises(InputError, match=f"alone needs {need} tiles"):
            StreamedTexture(device, table, need - 1, distance)
        StreamedTexture(device, table, need, distance)
