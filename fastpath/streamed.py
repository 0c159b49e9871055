"""A virtual texture of any size, streamed around a viewer within a fixed budget of tiles (talk, "3D virtual texture", "Per-pixel LOD",
"Indirection texture clipmap"). The tile cache holds light, the clipmap points into it, the residency decides who is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F32, F64, I64
from ..reference.errors import InputError
from ..reference.texture_types import Samples, Storage, TileTable, Viewer
from .arrays import check_triples, is_on_device
from .clipmap import Clipmap, Entries, pointers
from .device import OpenDevice
from .grid import Lattice
from .launch import DeviceSamples, Launcher, Source
from .layout import Layout
from .readback import held_texels
from .residency import Plan, Residency, check_budget
from .tile_cache import TileCache, Tiles
from .windows import in_voxels


@dataclass(frozen=True)
class Moved:
    """What a move did. wanted: tiles that the viewer's distances ask for; hits: of those, in the cache before; loaded, evicted: tiles;
    missing: wanted tiles that are absent, whose parents answer for them; resident: tiles in the cache; bytes: to the device;
    shifted_lods: windows that moved; seconds: on the device, of it clipmap_seconds for the windows."""

    wanted: int
    hits: int
    loaded: int
    evicted: int
    missing: int
    resident: int
    bytes: int
    shifted_lods: int
    seconds: float
    clipmap_seconds: float


class StreamedTexture:
    """Sample what is around a viewer: `relight` once, then `move` and call, again and again. A tile that is absent is answered
    for by its nearest ancestor; the root is always there.

    seconds: device time of the last sampling that was waited for. wrong_reads: see `check_owners`. bytes: on the device.
    """

    def __init__(
        self,
        device: OpenDevice,
        table: TileTable,
        budget: int,
        lod_distance: float,
        *,
        storage: Storage = "half",
        layout: Layout = "packed",
        reconstruction: str = "linear",
        check_owners: bool = False,
        per_move: int | None = None,
    ) -> None:
        """budget: tiles in the cache; lod_distance, m: the finest level serves up to there, the next twice as far, and so on; per_move:
        most tiles that one move loads. check_owners: count samples that read the tile of another place: `DeviceSamples.wrong`, and for
        NumPy arrays their sum in `wrong_reads`.

        Raises InputError for a budget under what the coarsest level needs or over what an indirection texel addresses, a
        lod_distance not above 0 or whose windows do not fit the device; ValueError for a format that does not exist.
        """
        check_budget(table, budget, lod_distance, per_move)
        self.budget, slots = budget, min(budget, table.tiles)
        self._cache = TileCache(device, slots, storage, layout, table.used(), reconstruction == "l2")
        self._clipmap = Clipmap(device, table.level, table.finest, table.extent, lod_distance, self._cache.shape, slots)
        self._residency = Residency(table, slots, lod_distance / table.finest, per_move)
        self._launcher = Launcher(device, storage, layout, reconstruction, ("-DCLIPMAP",))
        self._device, self._table, self._distance, self._check = device, table, lod_distance, check_owners
        self._viewer: F64 | None = None
        self._lit = False
        held = np.zeros(slots, np.int32), np.zeros((slots, 3), np.int32), np.zeros(slots, np.uint32)
        self._in_slot = Entries(*held)  # level 0: nothing
        self.lattice = Lattice(
            table.origin, table.finest, table.level, table.extent, self._cache.shape, self._clipmap.log2
        )
        self.wrong_reads = 0
        self.bytes = self._cache.bytes + self._clipmap.bytes

    @property
    def window(self) -> int:
        """Texels per axis of each LOD's indirection window."""
        return self._clipmap.side

    @property
    def seconds(self) -> float:
        """Device time of the last sampling with NumPy arrays."""
        return self._launcher.seconds

    @property
    def update_seconds(self) -> float:
        """Device time of the last `relight`, or of the last tiles put."""
        return self._cache.seconds

    def resident_tiles(self) -> I64:
        """Tiles in the cache, (n,), ascending."""
        return np.sort(self._residency.resident()[0])

    def resident_texels(self) -> tuple[I64, F32]:
        """Tiles in the cache, (n,), ascending, and the texels (n, 27, 13 or 28) that it holds of them: a copy, for checks."""
        tiles = self.resident_tiles()
        return tiles, held_texels(self._device, self._cache, self._residency.slot_of[tiles])

    def relight(self, light: Any) -> None:
        """New light for all tiles: radiance SH (P, 4 or 9, 3) f32 of all P probes of the world, as `TileCache.relight` takes it.

        Raises InputError for the light of another number of probes: it belongs to another bake.
        """
        count = getattr(light, "shape", (0,))[0]
        if count != self._table.probes:
            raise InputError(
                f"light of {count} probes for a tile table of {self._table.probes}: they come from different bakes; bake again"
            )
        self._cache.relight(light)
        self._lit = True

    def move(self, viewer: F64) -> Moved:
        """The viewer is at `viewer` (3,) f64 m now: windows follow, tiles come and go. Any distance: a teleport is a long step.

        In this order, on one queue: windows move; nothing points any more to tiles that leave; their slots get other tiles; those are
        pointed to. Raises ValueError before any light is known, or for a viewer that is not three finite numbers.
        """
        if not self._lit:
            raise ValueError("no light yet: call relight before move")
        table = self._table
        at = in_voxels(viewer, table.origin, table.finest)
        plan = self._residency.plan(at)
        self._clipmap.seconds, self._clipmap.uploaded = 0.0, 0
        shifted = self._clipmap.move(at, self._in_slot)
        self._viewer = np.array(viewer, dtype=np.float64)
        self._leave(plan)
        uploaded = self._arrive(plan)
        put = self._cache.seconds if len(plan.into) else 0.0
        seconds = self._clipmap.seconds
        return Moved(
            wanted=plan.wanted,
            hits=plan.hits,
            loaded=len(plan.into),
            evicted=len(plan.out),
            missing=plan.missing,
            resident=int((self._residency.tile_in >= 0).sum()),
            bytes=uploaded + self._clipmap.uploaded,
            shifted_lods=shifted,
            seconds=seconds + put,
            clipmap_seconds=seconds,
        )

    def _leave(self, plan: Plan) -> None:
        """Tiles go only for others: the cache forgets them as their slots are filled anew."""
        if len(plan.out):
            self._clipmap.leave(self._in_slot.take(plan.out_slots))
            self._residency.leave(plan.out)
            self._in_slot.level[plan.out_slots] = 0

    def _arrive(self, plan: Plan) -> int:
        """Bytes that went to the cache."""
        if not len(plan.into):
            return 0
        table, tiles, slots = self._table, plan.into, plan.into_slots
        level, cell, parent = table.tile_level[tiles], table.cell[tiles], table.parent[tiles]
        self._residency.arrive(tiles, slots)
        above = np.where(parent >= 0, self._residency.slot_of[np.maximum(parent, 0)], -1).astype(np.int32)
        uploaded = self._cache.put(Tiles(slots, above, table.octant[tiles], level, cell, table.sources[tiles]))
        came = Entries(level, cell, pointers(slots, level, self._cache.shape))
        for held, new in (
            (self._in_slot.level, level),
            (self._in_slot.cell, cell),
            (self._in_slot.pointer, came.pointer),
        ):
            held[slots] = new
        self._clipmap.arrive(came)
        return uploaded

    def __call__(
        self,
        positions: Any,
        normals: Any,
        anchor: F64 | None = None,
        blend: float = 0.0,
        out: DeviceSamples | None = None,
    ) -> Samples | DeviceSamples:
        """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3), the level of detail by distance from the last viewer
        moved to; blend: see `Viewer`. NumPy arrays, in world coordinates, give `Samples`; arrays on the device, f32, metres from
        `anchor` (3,) f64 m, the viewer if None, give `DeviceSamples`, in the memory of `out` if given. Raises ValueError for other
        arrays, and before the first move.
        """
        if self._viewer is None:
            raise ValueError("no viewer yet: call move before sampling")
        lod = Viewer(self._viewer, self._distance, blend)
        at = self._viewer if anchor is None else np.asarray(anchor, dtype=np.float64)
        owners = self._cache.owners if self._check else None
        source = Source(self._cache.textures, self._clipmap.texels, self._clipmap.lods, self._cache.exposure, owners)
        if not self._check or is_on_device(positions) or is_on_device(normals):
            return self._launcher(self.lattice, source, positions, normals, lod, at, out)
        return self._counted(source, positions, normals, lod, at)

    def _counted(self, source: Source, positions: Any, normals: Any, lod: Viewer, at: F64) -> Samples:
        """With NumPy arrays, and wrong reads counted."""
        import pyopencl.array

        check_triples("normals", normals, check_triples("positions", positions))
        queue = self._device.queue
        p = pyopencl.array.to_device(queue, np.ascontiguousarray(positions - at, dtype=np.float32))
        n = pyopencl.array.to_device(queue, np.ascontiguousarray(normals, dtype=np.float32))
        found = self._launcher(self.lattice, source, p, n, lod, at)
        assert isinstance(found, DeviceSamples)
        self.wrong_reads = int(found.wrong.get().sum())
        return found.host()

    def on_device(
        self,
        positions: Any,
        normals: Any,
        anchor: F64 | None = None,
        blend: float = 0.0,
        out: DeviceSamples | None = None,
    ) -> DeviceSamples:
        """The same for arrays that are on the device, with the type said."""
        found = self(positions, normals, anchor, blend, out)
        assert isinstance(found, DeviceSamples)
        return found
