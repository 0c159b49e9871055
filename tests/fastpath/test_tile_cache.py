"""Tiles filled on the device against the plain filling of reference/volume/tiles.py."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.layout import WEIGHT_STEPS, WEIGHT_TYPE, Layout
from lightgauge.fastpath.sampler import Sampler
from lightgauge.fastpath.tile_cache import TileCache, Tiles
from lightgauge.reference.datatypes import F32, I32
from lightgauge.reference.texture_types import Storage, TileTable, VirtualTexture, exposure_of
from lightgauge.reference.volume.indirection import build_indirection
from lightgauge.reference.volume.layout import TileLayout, build_layout
from lightgauge.reference.volume.sampler import sample
from lightgauge.reference.volume.table import tile_table
from lightgauge.reference.volume.tiles import fill_tiles, probe_texels, with_copies
from small_scenes import random_tree, random_units

PACKED: tuple[tuple[Storage, Layout], ...] = (("float32", "packed"), ("half", "packed"))
IMAGES: tuple[tuple[Storage, Layout], ...] = (("half", "images"), ("half16", "images"), ("half8", "images"))
FILLED = [(*f, 4) for f in (*PACKED, *IMAGES)] + [(*f, 9) for f in PACKED]


class World:
    """A random octree with levels 0 … 4, a quarter of its probes without light, each tile in a random slot."""

    def __init__(self, components: int = 4, seed: int = 11) -> None:
        tree = random_tree(4, 0.45, seed)
        self.layout: TileLayout = build_layout(tree)
        rng = np.random.default_rng(seed)
        self.light: F32 = rng.normal(size=(len(tree.corners), components, 3)).astype(np.float32)
        self.light[:, 0] = np.abs(self.light[:, 0]) + 1.0
        self.light_from: I32 = np.arange(len(self.light), dtype=np.int32)
        self.light_from[rng.random(len(self.light)) < 0.25] = -1
        self.table: TileTable = tile_table(self.layout, self.light_from)
        self.slot: I32 = rng.permutation(self.table.tiles + 7)[: self.table.tiles].astype(np.int32)

    def tiles(self) -> Tiles:
        t = self.table
        parent = np.where(t.parent >= 0, self.slot[np.maximum(t.parent, 0)], -1).astype(np.int32)
        return Tiles(self.slot, parent, t.octant, t.tile_level, t.cell, t.sources)

    def twin(self, light: F32, storage: Storage) -> F32:
        used, valid = with_copies(light, self.light_from)
        finite = np.isfinite(used).all(axis=(1, 2))
        brightest = float(np.abs(used[valid][np.isfinite(used[valid])]).max())
        used = np.where(finite[:, None, None], used, 0.0).astype(np.float32)
        return fill_tiles(self.layout, probe_texels(used, valid & finite), storage, exposure_of(brightest))


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


def read(device: OpenDevice, cache: TileCache, slot: I32, storage: Storage, layout: Layout) -> F32:
    """Texels (T, 27, 13 or 28) as the device holds them, with the exposure put back."""
    parts = packed(device, cache, slot, storage) if layout == "packed" else images(device, cache, slot, storage)
    if storage != "float32":
        parts = np.where(np.arange(parts.shape[2]) == 12, parts, parts * np.float32(cache.exposure))
    return parts.astype(np.float32)


def packed(device: OpenDevice, cache: TileCache, slot: I32, storage: Storage) -> F32:
    found = []
    for buffer, count in zip(cache.textures, (13, 15), strict=False):
        host = np.empty(
            (buffer.size // (16 * (4 if storage == "float32" else 2)), 16),
            np.float32 if storage == "float32" else np.float16,
        )
        cl.enqueue_copy(device.queue, host, buffer)
        found.append(host.reshape(-1, 27, 16)[slot, :, :count].astype(np.float32))
    return np.concatenate(found, axis=2)


def images(device: OpenDevice, cache: TileCache, slot: I32, storage: Storage) -> F32:
    x, y, z = (int(n) for n in cache.shape)
    volumes = []
    for image, kind, steps in zip(
        cache.textures[:4], (np.float16,) * 3 + (WEIGHT_TYPE[storage],), (1, 1, 1, WEIGHT_STEPS[storage]), strict=True
    ):
        host: Any = np.empty((3 * z, 3 * y, 3 * x, 4), kind)
        cl.enqueue_copy(device.queue, host, image, origin=(0, 0, 0), region=(3 * x, 3 * y, 3 * z))
        volumes.append(host.astype(np.float32) / np.float32(steps))
    whole = np.concatenate([*volumes[:3], volumes[3][..., :1]], axis=-1)
    return whole.reshape(z, 3, y, 3, x, 3, 13).transpose(0, 2, 4, 5, 3, 1, 6).reshape(-1, 27, 13)[slot]


@pytest.mark.parametrize("on_device", [False, True])
@pytest.mark.parametrize(("storage", "layout", "components"), FILLED)
def test_filled_as_the_plain_filling_says(
    device: OpenDevice, storage: Storage, layout: Layout, on_device: bool, components: int
) -> None:
    """All levels of virtual probes, host light and light that is on the device: bit for bit, but for 8-bit weights, where 1/255
    is rounded in other ways: one unit of a half, or where a weight is as near to one step as to the next a step of it, and the light
    that is stored times it with it."""
    world = World(components)
    cache = TileCache(device, world.table.tiles + 7, storage, layout, world.table.used(), components == 9)
    light: Any = pyopencl.array.to_device(device.queue, world.light) if on_device else world.light
    cache.relight(light)
    assert cache.put(world.tiles()) > 100 * world.table.tiles
    for lit in (world.light, world.light[::-1].copy() * np.float32(7.0)):
        if lit is not world.light:
            cache.relight(pyopencl.array.to_device(device.queue, lit) if on_device else lit)
        twin = world.twin(lit, storage)
        got = read(device, cache, world.slot, storage, layout)
        limit = 2.0**-10 if storage == "half8" else 0.0
        tie = np.abs(got[..., 12] - twin[..., 12]) > 1e-3 if storage == "half8" else np.zeros(got.shape[:2], np.bool_)
        assert (np.abs(got - twin) <= limit * np.abs(twin))[~tie].all()
        assert tie.mean() < 1e-3 and (np.abs(got[tie, 12] - twin[tie, 12]) < 1.01 / 255).all()
        np.testing.assert_allclose(got[tie] / got[tie, 12:13], twin[tie] / twin[tie, 12:13], rtol=4 * 2.0**-11)
        assert len(np.unique(world.table.tile_level)) == 4 and (twin[..., 12] % 1.0 > 0).any(), (
            "virtual probes with fractions"
        )


def test_tiles_that_come_in_batches_are_the_same(device: OpenDevice) -> None:
    """Level by level, in small batches, with slots that others take over between: what is put is what a filling at once would be."""
    world = World()
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(world.light)
    tiles = world.tiles()
    for batch in np.array_split(np.arange(world.table.tiles), 9):
        cache.put(tiles.take(batch))
    last = np.flatnonzero(world.table.tile_level == 4)[::3]
    guests = tiles.take(last)
    cache.put(dataclasses.replace(guests, slot=np.roll(guests.slot, 1)))
    assert (read(device, cache, world.slot, "half", "packed") != world.twin(world.light, "half")).any()
    cache.put(guests)
    assert cache.resident == world.table.tiles
    np.testing.assert_array_equal(read(device, cache, world.slot, "half", "packed"), world.twin(world.light, "half"))
    owners = np.empty((int(np.prod(cache.shape)), 4), np.int32)
    cl.enqueue_copy(device.queue, owners, cache.owners)
    np.testing.assert_array_equal(owners[tiles.slot], np.column_stack([tiles.cell, tiles.level]))


def test_new_slots_are_zero_and_belong_to_nobody(device: OpenDevice) -> None:
    world = World()
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    host = np.ones((int(np.prod(cache.shape)) * 27, 16), np.float16)
    cl.enqueue_copy(device.queue, host, cache.textures[0])
    assert not host.any()
    cache.relight(world.light)
    cache.put(world.tiles())
    owners = np.ones((int(np.prod(cache.shape)), 4), np.int32)
    cl.enqueue_copy(device.queue, owners, cache.owners)
    free = np.setdiff1d(np.arange(len(owners)), world.slot)
    assert len(free) >= 7 and not owners[free].any() and owners[world.slot, 3].all()


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_light_that_is_not_finite_counts_as_unknown(device: OpenDevice, poison: float) -> None:
    """Failure-catalogue E2: it would enter every neighbour's filter with weight 0, and 0 times it is NaN."""
    world = World()
    light = world.light.copy()
    light[::17, 2, 1] = poison
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(light)
    cache.put(world.tiles())
    got = read(device, cache, world.slot, "half", "packed")
    assert np.isfinite(got).all()
    np.testing.assert_array_equal(got, world.twin(light, "half"))


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1.0, 1e6, 1e12])
def test_exposure_keeps_half_floats_in_range(device: OpenDevice, scale: float) -> None:
    """Failure-catalogue E3: 65,520 and more would be infinite, under 3e-8 nothing; with light divided by a power of two each
    coefficient within five decades of the brightest keeps 2^-11."""
    world = World()
    light = world.light * np.float32(scale)
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(light)
    cache.put(world.tiles())
    got = read(device, cache, world.slot, "half", "packed")
    source = world.table.sources
    exact = light[np.maximum(source, 0)].transpose(0, 1, 3, 2).reshape(*source.shape, 12)
    real = (source >= 0)[..., None] & (np.abs(exact) > 1e-5 * np.abs(light).max())
    assert np.abs(got[..., :12] / np.where(real, exact, 1.0) - 1.0)[real].max() <= 2.0**-11
    assert cache.exposure == exposure_of(float(np.abs(light[world.table.used()]).max()))


def test_what_is_refused(device: OpenDevice) -> None:
    world = World()
    cache = TileCache(device, world.table.tiles, "half", "packed", world.table.used())
    with pytest.raises(ValueError, match="no light yet"):
        cache.put(world.tiles())
    for light in (world.light[:, :3], world.light.astype(np.float64), np.zeros((4, 9, 3), np.float32)):
        with pytest.raises(ValueError, match="light must be"):
            cache.relight(light)
    cache.relight(world.light)
    with pytest.raises(ValueError, match="slots must be"):
        cache.put(world.tiles())
    for slots in (0, 256**3 + 1):
        with pytest.raises(ValueError, match="a tile cache holds"):
            TileCache(device, slots, "half", "packed", world.table.used())
    with pytest.raises(ValueError, match="a tile cache is packed"):
        TileCache(device, 8, "half", "split", world.table.used())


@pytest.mark.parametrize("on_device", [False, True])
def test_the_brightness_of_probes_that_no_tile_uses_costs_nothing(device: OpenDevice, on_device: bool) -> None:
    world = World()
    light = world.light.copy()
    light[world.light_from < 0] = 1e12
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(pyopencl.array.to_device(device.queue, light) if on_device else light)
    cache.put(world.tiles())
    np.testing.assert_array_equal(read(device, cache, world.slot, "half", "packed"), world.twin(light, "half"))
    assert cache.exposure < 1.0


def test_the_callers_array_is_his_own(device: OpenDevice) -> None:
    """Light on the host is copied: what its owner does with it later must not reach tiles that come later."""
    world = World()
    light = world.light.copy()
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(light)
    light *= np.float32(1e9)
    cache.put(world.tiles())
    np.testing.assert_array_equal(read(device, cache, world.slot, "half", "packed"), world.twin(world.light, "half"))


def test_light_on_the_device_must_be_whole(device: OpenDevice) -> None:
    world = World()
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    twice = pyopencl.array.to_device(device.queue, np.concatenate([world.light, world.light]))
    with pytest.raises(ValueError, match="a view perhaps"):
        cache.relight(twice[len(world.light) :])
    with pytest.raises(ValueError, match="different bakes"):
        cache.relight(world.light[:5])
    cache.relight(world.light)
    tiles = world.tiles()
    for wrong in (
        dataclasses.replace(tiles, sources=tiles.sources + np.int32(len(world.light))),
        dataclasses.replace(tiles, parent=tiles.parent + np.int32(cache.capacity)),
    ):
        with pytest.raises(ValueError, match="sources must be below"):
            cache.put(wrong)


@pytest.mark.parametrize("scale", [1e-30, 1e-38])
def test_very_dim_light_is_no_nan(device: OpenDevice, scale: float) -> None:
    world = World()
    cache = TileCache(device, world.table.tiles + 7, "half", "packed", world.table.used())
    cache.relight(world.light * np.float32(scale))
    cache.put(world.tiles())
    assert np.isfinite(read(device, cache, world.slot, "half", "packed")).all()


def test_a_sampler_over_a_cache_follows_its_light(device: OpenDevice) -> None:
    """Slots in the order of tiles: what runs sample. New light 8 times as bright is read 8 times as bright."""
    world = World()
    tiles = dataclasses.replace(
        world.tiles(), slot=np.arange(world.table.tiles, dtype=np.int32), parent=world.table.parent
    )
    texture = VirtualTexture(
        world.table.origin, world.table.finest, world.table.level, world.table.extent, build_indirection(world.layout),
        world.twin(world.light, "half"),
    )  # fmt: skip
    cache = TileCache(device, world.table.tiles, "half", "packed", world.table.used())
    cache.relight(world.light)
    cache.put(tiles)
    sampler = Sampler(device, texture, "half", "packed", filled=cache)
    p, n = np.random.default_rng(5).uniform(0, 16, (5000, 3)), random_units(5000, 6)
    before = sampler(p, n).irradiance
    np.testing.assert_allclose(before, sample(texture, p, n).irradiance, atol=1e-5 * np.abs(before).mean(), rtol=1e-4)
    cache.relight(world.light * np.float32(8.0))
    np.testing.assert_array_equal(sampler(p, n).irradiance, before * np.float32(8.0))
    with pytest.raises(ValueError, match="the cache holds"):
        Sampler(device, texture, "float32", "packed", filled=cache)
    partial = TileCache(device, world.table.tiles, "half", "packed", world.table.used())
    partial.relight(world.light)
    partial.put(tiles.take(np.arange(world.table.tiles - 1)))
    with pytest.raises(ValueError, match="different bakes"):
        Sampler(device, texture, "half", "packed", filled=partial)
