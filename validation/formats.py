"""Which storage and layout a run samples with: by what `doctor` measured on this device, as long as the kernels are the same, else
what its kind is known to like."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..fastpath.device import DeviceInfo
from ..fastpath.layout import LAYOUTS, Layout
from ..fastpath.speed import Speeds, preferred
from ..reference.texture_types import Storage
from . import cache

KIND = "layouts"


def _key(info: DeviceInfo) -> str:
    return cache.key(KIND, dataclasses.asdict(info), cache.code_hash("fastpath"))


def remember(info: DeviceInfo, speeds: Speeds) -> None:
    """Keep what was measured, samples/s by layout, for the runs to come."""
    cache.store(KIND, _key(info), {layout: np.array(value) for layout, value in speeds.items()})


def remembered(info: DeviceInfo) -> Speeds | None:
    """What was measured on this device with these kernels, None if nothing was."""
    kept = cache.load(KIND, _key(info))
    return None if kept is None else {layout: float(kept[layout]) for layout in LAYOUTS if layout in kept}


def sampling_format(info: DeviceInfo, reconstruction: str) -> tuple[Storage, Layout]:
    """Storage and layout for runs on this device. Light of order 2 is held packed only."""
    return ("half", "packed") if reconstruction == "l2" else preferred(info, remembered(info))
