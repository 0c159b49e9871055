"""Sampling during a flight: what the streamed texture says, which tiles it read wrongly, and what the whole one says there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastpath.device import OpenDevice
from ...fastpath.launch import DeviceSamples
from ...fastpath.streamed import StreamedTexture
from ...reference.datatypes import F32, F64, I32
from ...reference.texture_types import Samples, Viewer
from .world import Watched, World

# A point may differ by this share of the mean light from what the whole texture answers at the same level: twice what half floats keep.
TWIN = 1e-3
NOTHING = Samples(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))


@dataclass(frozen=True, eq=False)
class Read:
    """One sampling of N points. wrong: tiles of another place that were read. seconds: device time."""

    irradiance: F32
    level: I32
    wrong: int
    seconds: float


class Reader:
    """Points on the device, relative to an anchor (3,) m, uploaded once and sampled as often as wanted."""

    def __init__(self, device: OpenDevice, watched: Watched, anchor: F64) -> None:
        """Upload."""
        import pyopencl.array

        self.count, self.anchor = len(watched.positions), anchor
        if not self.count:  # a view of the sky; OpenCL has no empty buffers
            return
        at = (watched.positions - anchor).astype(np.float32)
        put = pyopencl.array.to_device
        self._positions = put(device.queue, np.ascontiguousarray(at))
        self._normals = put(device.queue, np.ascontiguousarray(watched.normals, dtype=np.float32))

    def streamed(self, texture: StreamedTexture, blend: float) -> Read:
        """What the streamed texture says now."""
        if not self.count:
            return Read(NOTHING.irradiance, NOTHING.level, 0, 0.0)
        return _read(texture.on_device(self._positions, self._normals, self.anchor, blend))

    def whole(self, world: World, viewer: F64 | None, blend: float) -> Samples:
        """What the whole texture says at the level of detail for a viewer at `viewer`, at the finest everywhere without one."""
        if not self.count:
            return NOTHING
        lod = None if viewer is None else Viewer(viewer, world.lod_distance, blend)
        return world.whole.on_device(self._positions, self._normals, lod, self.anchor).host()


def _read(found: DeviceSamples) -> Read:
    found.event.wait()
    seconds = (found.event.profile.end - found.event.profile.start) * 1e-9
    samples = found.host()
    return Read(samples.irradiance, samples.level, int(found.wrong.get().sum()), seconds)


def unlike(streamed: Read, whole: Samples, scale: float, missing: int) -> tuple[int, int]:
    """How many points fell to a coarser level than the whole texture answers with; and how many differ from it without a reason: by
    over TWIN of `scale`, W·m⁻², at the same level, with a finer level, or with a coarser one though no tile is `missing`."""
    fell = streamed.level < whole.level
    apart = np.abs(streamed.irradiance.astype(np.float64) - whole.irradiance).max(axis=1, initial=0.0) > TWIN * scale
    strange = ~fell & (apart | (streamed.level > whole.level))
    return int(fell.sum()), int(strange.sum()) + (int(fell.sum()) if missing == 0 else 0)
