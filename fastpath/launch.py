"""One launch of the sampling kernel: what it is told of the lattice, where its results go, and what must outlive it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F64, I64, Samples, Storage, Viewer, anchor_cell, check_lod
from .arrays import check_triples, empty, is_on_device, uploaded
from .device import OpenDevice, pyopencl_module
from .layout import Layout, build_options, check_format
from .programs import program

RECONSTRUCTIONS = ("linear", "clamped", "nonlinear", "zh3", "l2")
_GRID = np.dtype(
    [
        ("anchor_fraction", np.float32, 4),
        ("viewer", np.float32, 4),
        ("anchor_cell", np.int32, 4),
        ("extent", np.int32, 4),
        ("cache", np.int32, 4),
        ("scale", np.float32, 4),
    ]
)
# Work items of a group. Said, as PoCL builds a kernel anew (0.1 s) for every global size where it may choose the local one.
GROUP = 64


def grouped(count: int) -> tuple[tuple[int], tuple[int]]:
    """Global and local size of a launch with `count` work items or a few more: kernels are told the count."""
    return (-(-count // GROUP) * GROUP,), (GROUP,)


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where a texture's voxels are: origin (3,) f64 m, finest voxel, m, level L, extent (3,) in finest voxels; cache (3,): tiles
    per axis; window: log2 of a clipmap's texels per axis, 0 without one."""

    origin: F64
    finest: float
    level: int
    extent: I64
    cache: I64
    window: int = 0


@dataclass(frozen=True, eq=False)
class Source:
    """What a launch reads. textures: the cache's arguments; indirection, lods: buffers; exposure: stored light is multiplied by it;
    owners: whose tile each slot holds, None where nobody asks."""

    textures: tuple[Any, ...]
    indirection: Any
    lods: Any
    exposure: float
    owners: Any = None


@dataclass(frozen=True, eq=False)
class DeviceSamples:
    """`Samples` that stay on the device (pyopencl.array.Array): irradiance (N, 3) f32, level (N,) i32, weight (N,) f32; wrong (N,)
    i32, tiles of another place that were read, None where nobody asked. Ready when `event` is."""

    irradiance: Any
    level: Any
    weight: Any
    wrong: Any
    event: Any

    def host(self) -> Samples:
        """A copy on the host; waits."""
        return Samples(self.irradiance.get(), self.level.get(), self.weight.get())


class Launcher:
    """The sampling kernel in one format, on one device. seconds: device time of the last launch that was waited for."""

    def __init__(
        self,
        device: OpenDevice,
        storage: Storage,
        layout: Layout,
        reconstruction: str = "linear",
        options: tuple[str, ...] = (),
    ) -> None:
        """options: more -D of sampler.cl. Raises ValueError for a format that does not exist, EnvironmentLacks for a device without 3D
        images where they are wanted."""
        check_format(storage, layout)
        if reconstruction not in RECONSTRUCTIONS:
            raise ValueError(f"reconstruction must be one of {', '.join(RECONSTRUCTIONS)}, got {reconstruction!r}")
        self.device, self.seconds = device, 0.0
        self._options = [
            *build_options(storage, layout),
            f"-DRECONSTRUCTION={RECONSTRUCTIONS.index(reconstruction)}",
            *options,
        ]
        self._options += ["-DBAND2"] if reconstruction == "l2" else []
        self._pending: deque[tuple[Any, tuple[Any, ...]]] = deque()

    def __call__(
        self, lattice: Lattice, source: Source, positions: Any, normals: Any, lod: Any = None, anchor: F64 | None = None
    ) -> Samples | DeviceSamples:
        """Sample. positions, normals (N, 3): NumPy arrays give `Samples`; arrays on the device, positions in metres from `anchor`, give
        `DeviceSamples` and are not copied. lod: int, (N,) i32 on the host, or Viewer. Raises ValueError for other shapes or types."""
        n = check_triples("positions", positions)
        check_triples("normals", normals, n)
        at = lattice.origin if anchor is None else np.asarray(anchor, dtype=np.float64)
        words = grid_words(lattice, at, lod, source.exposure)
        kernel, lods = self._kernel(lod, source), None
        if not isinstance(lod, Viewer):
            check_lod(lod, lattice.level, n)
            own = np.asarray(lattice.level if lod is None else lod, dtype=np.int32)
            lods = uploaded(self.device, own) if own.ndim else None
        on_device = is_on_device(positions)
        if on_device != is_on_device(normals):
            raise ValueError("positions and normals must both be on the host or both on the device")
        p, d = positions, normals
        if not on_device:
            p = uploaded(self.device, (np.asarray(positions, np.float64) - at).astype(np.float32))
            d = uploaded(self.device, np.asarray(normals, dtype=np.float32))
        made = self._enqueue(kernel, words, source, lods, p, d, n)
        if on_device:
            return made
        if n:
            made.event.wait()
            self.seconds = (made.event.profile.end - made.event.profile.start) * 1e-9
        return made.host()

    def _kernel(self, lod: Any, source: Source) -> Any:
        chosen = ["-DLOD_DISTANCE"] if isinstance(lod, Viewer) else ["-DLOD_OWN"] if np.ndim(lod) else ["-DLOD_ALL"]
        chosen += ["-DBLEND"] if isinstance(lod, Viewer) and lod.blend > 0.0 else []
        chosen += ["-DOWNERS"] if source.owners is not None else []
        return pyopencl_module().Kernel(program(self.device, "sampler.cl", [*self._options, *chosen]), "sample")

    def _enqueue(self, kernel: Any, words: Any, source: Source, lods: Any, p: Any, d: Any, n: int) -> DeviceSamples:
        device = self.device
        results = [empty(device, (n, 3), np.float32), empty(device, (n,), np.int32), empty(device, (n,), np.float32)]
        wrong = None if source.owners is None else empty(device, (n,), np.int32)
        arguments = [*source.textures, source.indirection, source.lods, words]
        arguments += [] if lods is None else [lods]
        arguments += [a.base_data if is_on_device(a) else a for a in (p, d, *results)]
        arguments.append(np.int32(n))
        arguments += [] if wrong is None else [source.owners, wrong.base_data]
        if n == 0:
            return DeviceSamples(results[0], results[1], results[2], wrong, None)
        event = kernel(device.queue, *grouped(n), *arguments)
        # OpenCL does not own kernel arguments: all of them, samplers and caller's arrays too, must live until the launch is over.
        complete = pyopencl_module().command_execution_status.COMPLETE
        while self._pending and self._pending[0][0].command_execution_status == complete:
            self._pending.popleft()
        self._pending.append((event, (*arguments, p, d)))
        return DeviceSamples(results[0], results[1], results[2], wrong, event)


def grid_words(lattice: Lattice, anchor: F64, lod: Any, exposure: float) -> Any:
    """The kernel's `Grid`. Raises ValueError for an anchor that is not three finite numbers within reach of 32-bit cells."""
    cell, fraction = anchor_cell(lattice.origin, lattice.finest, anchor)
    words = np.zeros((), dtype=_GRID)
    words["anchor_fraction"] = [*fraction, 1.0 / lattice.finest]
    words["anchor_cell"] = [*cell, lattice.level]
    words["extent"] = [
        *lattice.extent,
        lattice.level if lod is None or isinstance(lod, Viewer) or np.ndim(lod) else lod,
    ]
    words["cache"] = [*lattice.cache, lattice.window]
    words["scale"] = [exposure, 0.0, 0.0, 0.0]
    if isinstance(lod, Viewer):
        words["viewer"] = [*(np.asarray(lod.position, np.float64) - anchor), 1.0 / lod.lod_distance**2]
        if lod.blend > 0.0:
            band = np.float32(lod.blend)
            words["scale"][1:3] = band, np.float32(1.0) / band
    return words[()]
