"""What case F6 measures: the truth and the sampler computed again on other numbers of threads, and what a record says of the machine.

Dr.Jit's threads are set in this process. PoCL counts its own once, as it is loaded: the kernel runs in a process a number of threads,
`python -m lightgauge.validation.stress.truth_again SEED FILE`, which writes what it read and on how many compute units.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np

from ...fastpath.device import POCL_PINNED, POCL_THREADS
from ...fastpath.sampler import Sampler
from ...reference.datatypes import F32, F64
from ...reference.progress import silent
from ...reference.truth.mitsuba_scene import TruthScene, build_truth_scene
from ...reference.truth.path_traced import path_depth, picture
from ...reference.truth.points import Points
from ..provenance import provenance
from .case import Reading
from .scenes import box, grey, scene_of
from .texture_worlds import device, inside, random_world, units
from .trees import random_tree

FACTS = ("cpu", "llvm", "vector_width", "opencl", "cores")
ROOM_POINTS, ROOM_PATHS, SAMPLES = 1000, 64, 20_000
CHILD_SECONDS = 120.0
Sampled = tuple[int, F32]  # compute units; irradiance (N, 3)


def again(threads: float, seed: int) -> Mapping[str, Reading]:
    """F6: values of the truth and of the sampler that differ between one thread and `threads`; the truth on so many from random numbers
    of its own, as another machine may draw them, over that on one, minus 1; facts that a record must hold and does not."""
    count = round(threads)
    first, second, other = _traced(1, seed, seed), _traced(count, seed, seed, True), _traced(count, seed, seed + count)
    apart = (other.mean(axis=(0, 2)) - first.mean(axis=(0, 2))) / first.mean()
    spread = float(apart.std(ddof=1)) / math.sqrt(len(apart))
    found = {
        "truth, values that differ": Reading(float((first != second).sum()), 0.0, first.size),
        "truth, other random numbers": Reading(float(apart.mean()), spread, len(apart)),
        **sampled_again(_sampled_on_one(seed), sampled_on(count, seed), count),
    }
    if count == 1:  # what is recorded does not depend on the number of threads
        recorded = provenance(device(), {}, seed, "stress")
        missing = sum(not recorded.get(name) for name in FACTS)
        found["facts not recorded"] = Reading(float(missing), 0.0, len(FACTS))
    return found


@contextmanager
def _on(threads: int) -> Iterator[None]:
    """Dr.Jit with so many threads."""
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(threads)
    if dr.thread_count() != threads:
        raise RuntimeError(f"Dr.Jit runs on {dr.thread_count()} threads, not on {threads}")
    try:
        yield
    finally:
        dr.set_thread_count(before)


@cache
def _traced(threads: int, scene_seed: int, seed: int, once_more: bool = False) -> F64:
    """Irradiance (B, N, 3), W·m⁻², of the room's receivers on so many threads. once_more: computed anew, not what is kept."""
    del once_more
    t, points, depth = _room(scene_seed)
    with _on(threads):
        return picture(t, points, ROOM_PATHS, depth, seed, silent).irradiance


@cache
def _room(seed: int) -> tuple[TruthScene, Points, int]:
    """A closed room with a lamp in the air, and receivers on its floor."""
    lights = {"lamp": {"type": "point", "position": (0.4, 0.6, 0.5), "intensity": (1, 2, 3)}}
    s = scene_of([box((0, 0, 0), (1, 1, 1))], [grey(0.5)], lights=lights)
    rng = np.random.default_rng([seed, 42])
    p = np.column_stack([rng.random(ROOM_POINTS), np.zeros(ROOM_POINTS), rng.random(ROOM_POINTS)])
    points = Points(p, np.tile([0.0, 1.0, 0.0], (ROOM_POINTS, 1)), np.zeros(ROOM_POINTS, np.int32))
    return build_truth_scene(s), points, path_depth(s, 1e-3)


def sampled_again(on_one: Sampled, on_many: Sampled, threads: int) -> dict[str, Reading]:
    """Samples on `threads` that differ from those on one thread. {} where the device has another number of threads than it was told to
    have."""
    (one, first), (many, second) = on_one, on_many
    if (one, many) != (1, threads):
        return {}
    return {"sampler, values that differ": Reading(float((first != second).sum()), 0.0, first.size)}


def sampled_on(threads: int, seed: int) -> Sampled:
    """Compute units, and irradiance (N, 3) f32 that the kernel reads in a process whose PoCL has so many threads."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sampled.npz"
        command = [sys.executable, "-m", __name__, str(seed), str(file)]
        environment = (
            os.environ | dict.fromkeys(POCL_THREADS, str(threads)) | {POCL_PINNED: "0"}
        )  # there may be fewer cores
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=CHILD_SECONDS, check=False
        )
        if done.returncode != 0:
            raise RuntimeError(f"the sampler on {threads} threads ended with {done.returncode}: {done.stderr[-500:]}")
        with np.load(file) as kept:
            return int(kept["units"]), kept["irradiance"]


@cache
def _sampled_on_one(seed: int) -> Sampled:
    return sampled_on(1, seed)


def main(seed: int, file: Path) -> None:
    """Sample a random octree and write the irradiance (N, 3) and the device's compute units."""
    w = random_world(random_tree(4, 0.6, [seed, 1]), 0.2, seed)
    p, n = inside(w, SAMPLES, seed), units(SAMPLES, seed)
    read = Sampler(device(), w.texture, "half", "packed")(p, n)
    np.savez(file, irradiance=read.irradiance, units=device().info.compute_units)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
