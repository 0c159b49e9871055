"""Launches of the sampling kernel: which variant, where results go, and what must outlive it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..reference.datatypes import F64
from ..reference.texture_types import Samples, Storage, Viewer, check_lod
from .arrays import buffer_of, check_triples, empty, events_of, is_on_device, uploaded
from .device import OpenDevice, pyopencl_module
from .grid import Lattice, grid_words
from .layout import Layout, build_options, check_format
from .programs import program

LANES_FOR = ("linear", "clamped")
RECONSTRUCTIONS = ("linear", "clamped", "nonlinear", "zh3", "l2")
# Work items of a group. Said, as PoCL builds a kernel anew (0.1 s) for every global size where it may choose the local one.
GROUP = 64
# Groups of eight samples that a work item takes, alone in its work group: see groups.clh. 16, 32 and 64 were equally fast where
# neighbours share voxels, 8 two percent slower; of scattered samples 32 were the fastest.
BATCH = 32


def grouped(count: int, group: int = GROUP) -> tuple[tuple[int], tuple[int]]:
    """Global and local size of a launch with `count` work items or a few more: kernels are told the count."""
    return (-(-count // group) * group,), (group,)


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

    def fits(self, count: int, counted: bool) -> bool:
        """True for results of `count` samples, with wrong reads counted or not."""
        wanted = ((self.irradiance, (count, 3)), (self.level, (count,)), (self.weight, (count,)))
        whole = all(tuple(a.shape) == shape and a.offset == 0 for a, shape in wanted)
        return whole and (self.wrong is not None) == counted and (self.wrong is None or len(self.wrong) == count)

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
        # Eight samples side by side where a core runs one work item at a time, and neighbours can share what they fetch.
        self._lanes = 8 if device.info.kind == "cpu" and layout == "packed" and reconstruction in LANES_FOR else 1
        self._batch = BATCH if self._lanes > 1 else 1
        self._options += [f"-DLANES={self._lanes}", f"-DBATCH={self._batch}"]
        self._kernels: dict[tuple[str, ...], Any] = {}

    def __call__(
        self, lattice: Lattice, source: Source, positions: Any, normals: Any, lod: Any = None, anchor: F64 | None = None,
        out: DeviceSamples | None = None,
    ) -> Samples | DeviceSamples:  # fmt: skip
        """Sample. positions, normals (N, 3): NumPy arrays give `Samples`; arrays on the device, positions in metres from `anchor`, give
        `DeviceSamples` and are not copied. lod: int, (N,) i32 on the host, or Viewer. out: earlier results of N samples on the
        device, to write over: new memory costs a page fault every 4 KiB. Raises ValueError for other shapes or types."""
        n = check_triples("positions", positions)
        check_triples("normals", normals, n)
        on_device = is_on_device(positions)
        if on_device != is_on_device(normals):
            raise ValueError("positions and normals must both be on the host or both on the device")
        if out is not None and not (on_device and out.fits(n, source.owners is not None)):
            raise ValueError(
                f"out must be results of {n} samples on the device, with wrong reads counted or not as here"
            )
        at = lattice.origin if anchor is None else np.asarray(anchor, dtype=np.float64)
        words = grid_words(lattice, at, lod, source.exposure)
        lods = None
        if not isinstance(lod, Viewer):
            check_lod(lod, lattice.level, n)
            lods = uploaded(self.device, np.asarray(lod, dtype=np.int32)) if np.ndim(lod) else None
        p, d = positions, normals
        if not on_device:
            p = uploaded(self.device, (np.asarray(positions, np.float64) - at).astype(np.float32))
            d = uploaded(self.device, np.asarray(normals, dtype=np.float32))
        made = self._enqueue(self._kernel(lod, source), words, source, lods, p, d, out or self._room(n, source), n)
        if on_device:
            return made
        if n:
            made.event.wait()
            self.seconds = (made.event.profile.end - made.event.profile.start) * 1e-9
        return made.host()

    def _room(self, n: int, source: Source) -> DeviceSamples:
        """Where results of n samples go."""
        made = [empty(self.device, s, t) for s, t in (((n, 3), np.float32), ((n,), np.int32), ((n,), np.float32))]
        wrong = None if source.owners is None else empty(self.device, (n,), np.int32)
        return DeviceSamples(made[0], made[1], made[2], wrong, None)

    def _kernel(self, lod: Any, source: Source) -> Any:
        chosen = ["-DLOD_DISTANCE"] if isinstance(lod, Viewer) else ["-DLOD_OWN"] if np.ndim(lod) else ["-DLOD_ALL"]
        chosen += ["-DBLEND"] if isinstance(lod, Viewer) and lod.blend > 0.0 else []
        chosen += ["-DOWNERS"] if source.owners is not None else []
        key = tuple(chosen)
        if (
            key not in self._kernels
        ):  # kept, as pyopencl writes the code of its first launch anew for each kernel object (0.2 ms)
            built = program(self.device, "sampler.cl", [*self._options, *chosen])
            self._kernels[key] = pyopencl_module().Kernel(built, "sample")
        return self._kernels[key]

    def _enqueue(
        self, kernel: Any, words: Any, source: Source, lods: Any, p: Any, d: Any, out: DeviceSamples, n: int
    ) -> DeviceSamples:
        if n == 0:
            return out
        arguments = [*source.textures, source.indirection, source.lods, words]
        arguments += [] if lods is None else [lods]
        read_written = (p, d, out.irradiance, out.level, out.weight)
        arguments += [buffer_of(a) for a in read_written]
        arguments.append(np.int32(n))
        arguments += [] if out.wrong is None else [source.owners, buffer_of(out.wrong)]
        shape = grouped(-(-n // (self._lanes * self._batch)), GROUP if self._batch == 1 else 1)
        event = kernel(self.device.queue, *shape, *arguments, wait_for=events_of(p, d) or None)
        self.device.keep(event, (*arguments, *read_written))
        return dataclasses.replace(out, event=event)
