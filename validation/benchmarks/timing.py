"""Time several tasks side by side, so that what else the machine does falls on all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from ...reference.datatypes import F64
from ...reference.progress import Progress

Task = Callable[[int], float]


def timed(work: Callable[[], object]) -> Task:
    """`work` as a task: called with the number of the repeat, it gives the seconds taken."""

    def task(repeat: int) -> float:
        del repeat
        begin = time.perf_counter()
        work()
        return time.perf_counter() - begin

    return task


def interleaved(tasks: Mapping[str, Task], repeats: int, progress: Progress, stage: str) -> dict[str, F64]:
    """What each task gave in each repeat, (repeats,). First every task runs once unrecorded, to compile and to touch
    its memory; then all run in turn, every other time backwards, so that none always follows the same one."""
    names = list(tasks)
    for name in names:
        tasks[name](-1)
    found = {name: np.zeros(repeats) for name in names}
    for repeat in range(repeats):
        progress(stage, repeat, repeats)
        for name in names if repeat % 2 == 0 else reversed(names):
            found[name][repeat] = tasks[name](repeat)
    progress(stage, repeats, repeats)
    return found
