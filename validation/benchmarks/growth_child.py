"""Resident memory of a fly-through, in a process of its own: `python -m … FRAMES` prints one JSON object.

Every frame moves, samples a small picture and asks whose tiles it read; every tenth has new light. The frames before the count begins
visit the same places, so that compilers, caches and pools have what they keep.
"""

from __future__ import annotations

import gc
import json
import sys

import numpy as np

from ...fastpath.device import open_device
from ...fastpath.streamed import StreamedTexture
from .fastpath_world import build_world, view
from .memory_child import resident
from .stream_rows import FLIGHT_BUDGET, FLIGHT_DISTANCE, FLIGHT_SIDE, walk

PIXELS = (320, 180)
WARM_SHARE = 2  # as many frames come first, one part in so many: pools of the runtime level off by then


def measure(frames: int, side: int = FLIGHT_SIDE) -> dict[str, int]:
    """Bytes that resident memory grew by over `frames` frames, and its peak; tiles loaded and wrong reads in them; samples."""
    world = build_world(side)
    texture = StreamedTexture(open_device(), world.table, FLIGHT_BUDGET, FLIGHT_DISTANCE, check_owners=True)
    positions, normals = view(world.grid, np.array([0.0, 3.0, 0.0]), PIXELS)
    loaded = wrong = 0

    def frame(number: int) -> None:
        nonlocal loaded, wrong
        if number % 10 == 0:
            texture.relight(world.light * np.float32(1.0 + 0.1 * np.sin(number)))
        loaded += texture.move(walk(number)).loaded
        texture(positions + walk(number), normals)
        wrong += texture.wrong_reads

    for number in range(frames // WARM_SHARE):
        frame(number)
    gc.collect()
    before, loaded, wrong = resident("VmRSS"), 0, 0
    for number in range(frames):
        frame(number)
    gc.collect()
    return {
        "growth": resident("VmRSS") - before, "peak": resident("VmHWM"), "loaded": loaded, "wrong": wrong,
        "samples": frames * len(positions),
    }  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]))))
