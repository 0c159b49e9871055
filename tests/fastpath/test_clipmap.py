"""The clipmap's windows, and its texels against a build from nothing (failure-catalogue E6, E8)."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pyopencl as cl
import pytest
from lightgauge.fastpath.clipmap import Clipmap, Entries, pointers
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.windows import check_bits, first_cells, in_voxels, tile_edges, window_bytes, window_log2
from lightgauge.reference.datatypes import F64, I64
from lightgauge.reference.errors import InputError
from lightgauge.reference.texture_types import TileTable
from lightgauge.reference.volume.clipmap import window_texels
from lightgauge.reference.volume.indirection import pack, slot_offset
from lightgauge.reference.volume.layout import build_layout
from lightgauge.reference.volume.table import tile_table
from small_scenes import random_tree

PLENTY = 1 << 40
SHAPE = np.array([16, 16, 16])


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@pytest.mark.parametrize("d0", [0.3, 3.5, 7.0, 14.9, 15.1, 31.0, 60.0])
def test_every_lod_covers_its_radius_wherever_the_viewer_stands(d0: float) -> None:
    level, extent = 10, np.full(3, 1 << 10)
    log2 = window_log2(d0, 1.0, extent, PLENTY, level)
    side, rng, edges = 1 << log2, np.random.default_rng(1), tile_edges(level)[:, None]
    spare = np.inf
    for held in (
        *rng.uniform(0, 1024, (300, 3)),
        np.full(3, 512.0),
        np.full(3, 513.0),
        np.zeros(3),
        np.full(3, 1024.0),
    ):
        first = first_cells(held, extent, level, log2)
        radius = d0 * 2.0 ** np.arange(level - 1, -1, -1)[:, None]
        low, high = np.floor((held - radius) / edges), np.floor((held + radius) / edges)
        assert (low >= first).all() and (high < first + side).all()
        spare = min(spare, (low - first).min(), (first + side - 1 - high).min())
    assert log2 == 3 or spare < side / 4 + 1, "half as many texels would do"


def test_windows_nest() -> None:
    rng = np.random.default_rng(2)
    for held, log2 in itertools.product(rng.uniform(0, 4096, (500, 3)), (3, 4, 5)):
        first, side = first_cells(held, np.full(3, 4096), 12, log2).astype(np.int64), 1 << log2
        for fine, coarse in zip(first[1:], first[:-1], strict=True):
            assert (fine >> 1 >= coarse).all() and (fine + side - 1 >> 1 < coarse + side).all()


def test_a_small_world_needs_no_large_window() -> None:
    extent = np.array([20, 9, 3])
    log2 = window_log2(1e9, 1.0, extent, PLENTY, 5)
    for corner in itertools.product((0.0, 1.0), repeat=3):
        first = first_cells(1e6 * (np.array(corner) - 0.5), extent, 5, log2)
        assert (first <= 0).all() and (first + (1 << log2) > (extent - 1) // tile_edges(5)[:, None]).all()
    assert 1 << log2 == 32


def test_windows_too_large_for_the_device_are_refused_with_a_distance_that_is_not() -> None:
    extent, memory = np.full(3, 1 << 16), 1 << 30
    with pytest.raises(
        InputError, match=r"lod_distance 5000 m asks for clipmap windows of 8192\^3 texels.*use at most"
    ) as info:
        window_log2(5000.0, 1.0, extent, memory, 16)
    most = float(str(info.value).split()[-2])
    log2 = window_log2(most, 1.0, extent, memory, 16)
    assert window_bytes(log2, 16) <= memory / 4 < window_bytes(log2 + 1, 16)
    with pytest.raises(InputError):
        window_log2(most * 1.01, 1.0, extent, memory, 16)
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="lod_distance must be above 0"):
            window_log2(bad, 1.0, extent, memory, 16)


def test_offsets_and_levels_beyond_eight_bits_are_refused() -> None:
    """E6: an offset of 255 and a level of 255 fit, 256 does not."""
    check_bits(np.array([256, 256, 256]), 255)
    for axis in range(3):
        with pytest.raises(InputError, match="8 bits per axis address 256"):
            check_bits(np.where(np.arange(3) == axis, 257, 1), 1)
    with pytest.raises(InputError, match="256 levels, the 8 bits"):
        check_bits(np.array([1, 1, 1]), 256)
    slots, shape = np.array([0, 1, 255, 256, 65535, 65536, 256**3 - 1]), np.array([256, 256, 256])
    for level in (1, 255):
        expected = pack(slot_offset(slots, shape), level)
        np.testing.assert_array_equal(pointers(slots, np.full(len(slots), level), shape), expected)


def test_a_viewer_that_is_no_place_is_refused() -> None:
    for bad in (np.zeros(2), np.full(3, np.nan), np.array([0.0, np.inf, 0.0])):
        with pytest.raises(ValueError, match="three finite numbers"):
            in_voxels(bad, np.zeros(3), 1.0)


class Maps:
    """A clipmap on the device with random tiles of a random world in its cache, and the same from nothing."""

    def __init__(self, device: OpenDevice, seed: int) -> None:
        tree = random_tree(6, 0.4, seed)
        self.table: TileTable = tile_table(build_layout(tree), np.arange(len(tree.corners), dtype=np.int32))
        self.rng, self.device = np.random.default_rng(seed), device
        self.slots: dict[int, int] = {0: 0}
        self.map = Clipmap(device, 6, 1.0, self.table.extent, 6.0, SHAPE, 4096)
        self.arrive(self.rng.permutation(self.table.tiles))

    def entries(self, tiles: I64) -> Entries:
        slots = np.array([self.slots[t] for t in tiles.tolist()], dtype=np.int64)
        level = self.table.tile_level[tiles]
        return Entries(level, self.table.cell[tiles], pointers(slots, level, SHAPE))

    def arrive(self, tiles: I64) -> None:
        free = iter(set(range(4096)) - set(self.slots.values()))
        come = np.array([t for t in tiles.tolist() if t not in self.slots][:300], dtype=np.int64)
        self.slots |= {int(t): next(free) for t in come}
        self.map.arrive(self.entries(come))

    def leave(self, tiles: I64) -> None:
        go = np.array([t for t in tiles.tolist() if t in self.slots and t > 0], dtype=np.int64)  # none, by chance
        self.map.leave(self.entries(go))
        for t in go.tolist():
            del self.slots[t]

    def move(self, held: F64) -> int:
        return self.map.move(held, self.entries(np.array(sorted(self.slots))))

    def texels(self) -> np.ndarray:
        out = np.empty((6, *[self.map.side] * 3), dtype=np.uint32)
        cl.enqueue_copy(self.device.queue, out, self.map.texels)
        return out

    def stale(self) -> int:
        first = self.map.first
        assert first is not None
        return int(
            (self.texels() != window_texels(self.table, self.slots, SHAPE, first.astype(np.int64), self.map.side)).sum()
        )


MOVES = {
    "one": [2, 0, 0], "back": [-2, 0, 0], "y": [0, 2, 0], "z": [0, 0, -2], "three": [6, 0, 0], "seven": [0, 0, 14],
    "half": [0, 8, 0], "whole": [16, 0, 0], "diagonal": [2, 2, 2], "other diagonal": [-4, 6, -2],
    "teleport": [25, -30, 20], "outside": [-90, 70, 0],
}  # fmt: skip


@pytest.mark.parametrize("name", MOVES)
def test_no_texel_is_stale_after_a_shift(device: OpenDevice, name: str) -> None:
    maps, held = Maps(device, 4), np.array([33.0, 31.0, 32.6])
    assert maps.move(held) == 6 and maps.stale() == 0
    for place in (held + MOVES[name], held):
        shifted = maps.move(place)
        assert shifted > 0 and maps.stale() == 0


def test_no_texel_is_stale_while_tiles_come_and_go(device: OpenDevice) -> None:
    maps = Maps(device, 5)
    held = np.full(3, 32.0)
    maps.move(held)
    for share in (0.002, 0.02, 0.5, 1.0):
        maps.leave(np.flatnonzero(maps.rng.random(maps.table.tiles) < share))
        assert maps.stale() == 0
        maps.arrive(maps.rng.permutation(maps.table.tiles))
        assert maps.stale() == 0
        held = np.clip(held + maps.rng.normal(size=3) * 4, 0, 64)
        maps.move(held)
        assert maps.stale() == 0


def test_only_what_enters_is_written(device: OpenDevice) -> None:
    """One texel of the finest LOD: a slab of it, and nothing of the others where they stay."""
    maps = Maps(device, 6)
    maps.move(np.full(3, 31.1))
    poison = np.full((6, *[maps.map.side] * 3), 0xFFFFFFFF, dtype=np.uint32)
    cl.enqueue_copy(device.queue, maps.map.texels, poison)
    before = maps.map.first
    assert maps.move(np.array([33.1, 31.1, 31.1])) >= 1
    assert before is not None and maps.map.first is not None
    steps = np.abs(maps.map.first - before).sum(axis=1)
    written = (maps.texels() != 0xFFFFFFFF).sum(axis=(1, 2, 3))
    np.testing.assert_array_equal(written, steps * maps.map.side**2)
    assert steps[-1] == 1 and maps.move(np.array([33.2, 31.1, 31.1])) == 0


def test_the_world_may_be_any_size(device: OpenDevice) -> None:
    """The same tiles at the far end of a deep world take the same work, and find the same."""
    work, found = [], []
    for level in (6, 16):
        corner = np.int64(1 << level) - 64
        cells = np.array([[c, c, c] for c in ((corner + 9 >> (level - k + 1)) for k in range(1, level + 1))])
        tiles = Entries(
            np.arange(1, level + 1, dtype=np.int32),
            cells.astype(np.int32),
            np.arange(level, 0, -1).astype(np.uint32),
        )
        made = Clipmap(device, level, 1.0, np.full(3, 1 << level), 6.0, SHAPE, 64)
        made.move(corner + np.full(3, 9.0), tiles)
        made.uploaded = 0
        made.move(corner + np.array([11.0, 9.0, 9.0]), tiles)
        texels = np.empty((level, made.side**3), dtype=np.uint32)
        cl.enqueue_copy(device.queue, texels, made.texels)
        work.append(made.uploaded - 16 * level)
        found.append(texels[-1])
    assert set(np.unique(found[0])) >= {1, 2, 3}
    assert work[0] == work[1]
    np.testing.assert_array_equal(*found)
