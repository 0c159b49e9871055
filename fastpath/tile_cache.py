"""The tile cache on a device: a pool of slots that tiles are put into, filled and lit in place. Host side of tile_cache.cl.

Which tiles are in it is somebody else's business (`residency`), as is who points to them (`clipmap`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32, I32
from ..reference.texture_types import Storage, cache_shape, exposure_of
from .arrays import buffer_of, check_contiguous, empty, is_on_device, uploaded
from .device import OpenDevice, pyopencl_module
from .images import empty_images, image_texel_bytes
from .layout import LIGHT_TYPE, PACKED_SIZE, TEXELS, Layout, build_options, check_format, texel_bytes
from .programs import program

_LANES = 256
_GROUP = (TEXELS,)  # said, as PoCL builds a kernel anew for every global size where it may choose the local one


@dataclass(frozen=True, eq=False)
class Tiles:
    """Tiles to be put into slots, n of them, coarse levels first: slot (n,) i32; parent (n,) i32, slot of the tile above, -1 for
    the root; octant (n,) i32 of the parent, level (n,) i32, cell (n, 3) i32, sources (n, 27) i32 as in `TileTable`."""

    slot: I32
    parent: I32
    octant: I32
    level: I32
    cell: I32
    sources: I32

    def take(self, which: npt.NDArray[np.integer]) -> Tiles:
        """Some of them."""
        return Tiles(*(a[which] for a in (self.slot, self.parent, self.octant, self.level, self.cell, self.sources)))


@dataclass(frozen=True, eq=False)
class _Lists:
    """Tiles as the kernel reads them, on the device, and where each level begins among them. bytes: uploaded."""

    slots: Any
    above: Any
    sources: Any
    places: Any
    begin: tuple[int, ...]
    bytes: int


class TileCache:
    """Slots on a device. Light comes with `relight`, tiles with `put`. `seconds`: device time of the last of the two."""

    def __init__(
        self,
        device: OpenDevice,
        slots: int,
        storage: Storage,
        layout: Layout,
        used: I32,
        order2: bool = False,
    ) -> None:
        """Room for `slots` tiles, all zero. layout: packed, or images. used (n,): probes that tiles may take light from, of
        which the brightest sets the exposure (`TileTable.used`). Raises ValueError for a format that does not exist, or more
        tiles than an indirection texel addresses; EnvironmentLacks where the device cannot hold them."""
        check_format(storage, layout)
        if layout == "split" or (order2 and layout != "packed"):
            raise ValueError(f"a tile cache is packed, or images with light of order 1, got {layout}")
        self._device, self.storage, self.layout, self.order2 = device, storage, layout, order2
        self._used = np.asarray(used, dtype=np.int32)
        self._used_there = uploaded(device, self._used)
        self.shape = cache_shape(slots)
        self.capacity = slots
        self.exposure, self.seconds = 1.0, 0.0
        self._probes: Any = None
        self._light: Any = None
        self._staging: Any = None
        self._resident = _none_resident(slots)
        self._lists: tuple[_Lists, npt.NDArray[np.integer] | None] | None = None  # of all, until one comes
        self._allocate()
        options = [*build_options(storage, layout), f"-DCOMPONENTS={9 if order2 else 4}"]
        built = program(device, "tile_cache.cl", options)
        cl = pyopencl_module()
        self._fill = cl.Kernel(built, "fill")
        self._most = cl.Kernel(built, "brightest")
        self._place = cl.Kernel(built, "place") if layout == "images" else None

    def _allocate(self) -> None:
        import pyopencl.array

        places = int(np.prod(self.shape))
        zeros = pyopencl.array.zeros
        self.owners = zeros(self._device.queue, (places, 4), np.int32).base_data
        if self.layout == "images":
            self.textures = empty_images(self._device, self.shape, self.storage)
            self.bytes = places * (TEXELS * image_texel_bytes(self.storage) + 16)
            return
        kind = LIGHT_TYPE[self.storage]
        made = [
            zeros(self._device.queue, (places * TEXELS, PACKED_SIZE), kind).base_data
            for _ in range(2 if self.order2 else 1)
        ]
        self.textures = tuple(made)
        self.bytes = places * (len(made) * TEXELS * texel_bytes(self.storage, "packed") + 16)

    @property
    def resident(self) -> int:
        """Tiles that are in the cache."""
        return int((self._resident.level > 0).sum())

    def relight(self, light: Any) -> None:
        """New light for all tiles: radiance SH (P, 4 or 9, 3) f32 of the world's probes, on the host or on the device. It is kept,
        as a copy where it is on the host and as it is on the device: tiles that are put later take theirs from it.

        Raises ValueError for another shape or type.
        """
        components = 9 if self.order2 else 4
        shape: Any = getattr(light, "shape", ())
        kind = getattr(light, "dtype", None)
        if len(shape) != 3 or tuple(shape[1:]) != (components, 3) or kind != np.float32:
            raise ValueError(f"light must be (P, {components}, 3) float32, got {shape} {kind}")
        check_contiguous("light", light)
        most = max(int(self._resident.sources.max(initial=-1)), int(self._used.max(initial=-1)))
        if most >= shape[0]:
            raise ValueError(
                f"light of {shape[0]} probes for tiles that name probe {most}: they come from different bakes"
            )
        if is_on_device(light) != (self._probes is not None):
            self._lists = None  # sources number other probes then
        self._light = light if is_on_device(light) else np.array(light)
        self._probes = light if is_on_device(light) else None
        self.exposure, spent = 1.0, 0.0
        if self.storage != "float32":
            brightest, spent = self._brightest(light)
            self.exposure = exposure_of(brightest)
        lists, used = self._lists or self._all()
        self._lists = (lists, used)
        self.seconds = spent + self._filled(lists, used)

    def put(self, tiles: Tiles) -> int:
        """Put tiles into their slots, lit. Parents must be in the cache or among them. Returns the bytes uploaded.

        Raises ValueError before any light is known, for slots that do not exist, or tiles that are not ordered by level.
        """
        if self._light is None:
            raise ValueError("no light yet: call relight before put")
        if not len(tiles.slot):
            self.seconds = 0.0
            return 0
        if tiles.slot.min() < 0 or tiles.slot.max() >= self.capacity or (np.diff(tiles.level) < 0).any():
            raise ValueError(
                f"slots must be 0 … {self.capacity - 1} and levels ascend, got {tiles.slot} and {tiles.level}"
            )
        most, above = int(tiles.sources.max(initial=-1)), tiles.parent
        if most >= len(self._light) or above.min() < -1 or above.max() >= self.capacity:
            raise ValueError(
                f"sources must be below the {len(self._light)} probes that light is known of and parents slots or -1, got "
                f"{most} and {above.min()} … {above.max()}"
            )
        for name in ("slot", "parent", "octant", "level", "cell", "sources"):
            getattr(self._resident, name)[tiles.slot] = getattr(tiles, name)
        self._lists = None
        lists, used = self._upload(tiles)
        self.seconds = self._filled(lists, used)
        return lists.bytes + (0 if used is None else used.size * self._light[:1].nbytes)

    def _all(self) -> tuple[_Lists, npt.NDArray[np.integer] | None]:
        """All resident tiles, coarse first."""
        order = np.flatnonzero(self._resident.level > 0)
        return self._upload(self._resident.take(order[np.argsort(self._resident.level[order], kind="stable")]))

    def _brightest(self, light: Any) -> tuple[float, float]:
        """Largest absolute value, of those that are finite, of the probes that tiles may take light from; seconds on the device."""
        if not is_on_device(light):
            values: F32 = np.abs(light[self._used])
            return float(values.max(initial=0.0, where=np.isfinite(values))), 0.0
        found = empty(self._device, (_LANES,), np.float32)
        which = (self._used_there, np.int32(len(self._used)))
        event = self._most(self._device.queue, (_LANES,), (_LANES,), light.base_data, *which, found.base_data)
        brightest = float(found.get().max())
        return brightest, 1e-9 * (event.profile.end - event.profile.start)

    def _upload(self, tiles: Tiles) -> tuple[_Lists, npt.NDArray[np.integer] | None]:
        """The tiles on the device, and which probes their sources number: only those go up with them; None where all light is there."""
        used = None
        if self._probes is None:
            used = np.unique(tiles.sources[tiles.sources >= 0])
            tiles = _renumbered(tiles, used)
        above = np.column_stack([tiles.parent, tiles.octant]).astype(np.int32)
        places = np.column_stack([tiles.cell, tiles.level]).astype(np.int32)
        arrays = [np.ascontiguousarray(a, dtype=np.int32) for a in (tiles.slot, above, tiles.sources, places)]
        begin = np.flatnonzero(np.diff(tiles.level, prepend=-1)).tolist()
        made = [uploaded(self._device, a) for a in arrays]
        lists = _Lists(made[0], made[1], made[2], made[3], (*begin, len(tiles.slot)), sum(a.nbytes for a in arrays))
        return lists, used

    def _filled(self, lists: _Lists, used: npt.NDArray[np.integer] | None) -> float:
        """Fill the listed tiles, level by level; waits, and gives the seconds on the device. used: the probes that `sources`
        number, all of the world's if None."""
        probes = self._probes
        if probes is None:
            probes = uploaded(self._device, self._light[used])
        light = buffer_of(probes)
        cache, exposure = np.array([*self.shape, 0], np.int32), np.float32(self.exposure)
        events = []
        for first, end in zip(lists.begin[:-1], lists.begin[1:], strict=True):
            size = ((end - first) * TEXELS,)
            read = (
                lists.slots,
                lists.above,
                lists.sources,
                lists.places,
                light,
                self.owners,
                np.int32(first),
                cache,
                exposure,
            )
            if self._place is None:
                held = (self.textures[0], self.textures[-1])
            else:
                self._staging = self._room(size[0])
                held = (*self.textures[:4], self._staging)
            events.append(self._fill(self._device.queue, size, _GROUP, *held, *read))
            if self._place is not None:
                placed = (*self.textures[:4], self._staging, lists.slots, np.int32(first), cache)
                events.append(self._place(self._device.queue, size, _GROUP, *placed))
        for event in events:
            event.wait()
        return 1e-9 * sum(e.profile.end - e.profile.start for e in events)

    def _room(self, texels: int) -> Any:
        """Staging for so many texels, kept and grown."""
        cl = pyopencl_module()
        wanted = texels * PACKED_SIZE * 4
        if self._staging is not None and self._staging.size >= wanted:
            return self._staging
        return cl.Buffer(self._device.context, cl.mem_flags.READ_WRITE, wanted)


def _none_resident(slots: int) -> Tiles:
    def empty(*shape: int) -> I32:
        return np.zeros(shape, dtype=np.int32)

    return Tiles(
        np.arange(slots, dtype=np.int32),
        empty(slots),
        empty(slots),
        empty(slots),
        empty(slots, 3),
        empty(slots, TEXELS),
    )


def _renumbered(tiles: Tiles, used: npt.NDArray[np.integer]) -> Tiles:
    """The tiles with sources that count among `used` probes, ascending; those below 0 stay as they are."""
    sources = tiles.sources
    local = np.where(sources >= 0, np.searchsorted(used, sources), sources).astype(np.int32)
    return Tiles(tiles.slot, tiles.parent, tiles.octant, tiles.level, tiles.cell, local)
