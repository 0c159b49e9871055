"""All faults, one process each, and the sound product over many seeds: what the gates say of them.

A finished answer is kept by the code, the gates and the fault, so that a campaign that was stopped goes on where it was.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .. import cache
from ..processes import Ended, Processes, why_ended, workers
from .catalogue import FAULTS
from .fault import Fault
from .power import ERROR
from .worker import CLEAN, THE_RUN

MINUTES = 15.0
SEEDS_PER_PROCESS = 20  # imports and compiled kernels are shared by so many
CLEAN_SEEDS = {"sphere": 200}
KIND = "fault"
# What the gates ask about, and nothing of pages and cases.
MEASURED_BY = (
    "reference", "fastpath", "validation/*", "validation/metrics", "validation/statistics", "validation/leaks", "validation/culling",
    "validation/flight", "validation/efficiency", "validation/faults",
)  # fmt: skip
Row = dict[str, Any]
Tick = Callable[[int, int], None]


@dataclass(frozen=True)
class Task:
    """arguments: of the worker. fault, size: None for runs of the sound product."""

    arguments: tuple[str, ...]
    fault: Fault | None = None
    size: float | None = None


@dataclass(frozen=True)
class Answers:
    """faults: one row per fault and size. clean: one row per scene and seed of the sound product."""

    faults: list[Row] = field(default_factory=list)
    clean: list[Row] = field(default_factory=list)


class Campaign:
    """gates: the limits' file. jobs: processes at a time."""

    def __init__(self, gates: Path, jobs: int | None) -> None:
        self._gates, self._jobs, self._processes = gates, workers(jobs), Processes()

    def run(self, tick: Tick, clean_seeds: Mapping[str, int] | None = None) -> Answers:
        """Everything: sound runs of all scenes first (their references are kept for the faulty ones), then faults, each of a size at
        those sizes that say where it begins to be noticed, then the sound product's seeds. On Ctrl-C workers are killed and what is
        finished stays kept."""
        seeds = CLEAN_SEEDS if clean_seeds is None else clean_seeds
        flown = {name for fault in FAULTS if fault.fly for name in fault.scenes}
        scenes = sorted({name for fault in FAULTS for name in fault.scenes})
        first = [[Task((CLEAN, name, "0", "1", *(["fly"] if name in flown else [])))] for name in scenes]
        faults = [_tasks(fault) for fault in FAULTS]
        chunks = [
            [Task((CLEAN, name, str(k), str(min(SEEDS_PER_PROCESS, count - k))))]
            for name, count in seeds.items()
            for k in range(1, count, SEEDS_PER_PROCESS)
        ]
        total = len(first) + len(faults) + len(chunks)
        done = 0
        answers = Answers()
        for batch in (first, faults, chunks):
            for task, row in self._all(batch, lambda n, base=done: tick(base + n, total)):  # type: ignore[misc]
                if task.fault is None:
                    answers.clean.extend(row["runs"])
                else:
                    answers.faults.append(row)
            done += len(batch)
        return answers

    def _all(self, chains: Sequence[Sequence[Task]], tick: Callable[[int], None]) -> list[tuple[Task, Row]]:
        rows: dict[int, list[tuple[Task, Row]]] = {}
        with ThreadPoolExecutor(self._jobs) as pool:
            futures = {pool.submit(self._chain, tasks): i for i, tasks in enumerate(chains)}
            try:
                for n, future in enumerate(as_completed(futures), 1):
                    rows[futures[future]] = future.result()
                    tick(n)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                self._processes.stop()
                raise
        return [answer for i in range(len(chains)) for answer in rows[i]]

    def _chain(self, tasks: Sequence[Task]) -> list[tuple[Task, Row]]:
        """One task, or the sizes of one fault, largest first: the error that gates must notice; smaller ones down to the first that is
        missed, below which nothing is asked; larger ones only where it is missed itself."""
        if tasks[0].size is None:
            return [(tasks[0], self._recalled(tasks[0]))]
        asked = [(task, task.size or 0.0) for task in tasks]
        larger = [task for task, size in reversed(asked) if size > ERROR]
        smaller = [task for task, size in asked if size < ERROR]
        found = [(task, self._recalled(task)) for task, size in asked if size == ERROR]
        noticed = all(row["caught"] for _, row in found)
        for task in smaller if noticed else larger:
            row = self._recalled(task)
            found.append((task, row))
            if row["caught"] != noticed:
                break
        return sorted(found, key=lambda answer: -(answer[0].size or 0.0))

    def _recalled(self, task: Task) -> Row:
        digest = None if task.fault is None else (task.fault.digest(task.size), task.fault.scenes, task.fault.fly)
        key = cache.key(KIND, task.arguments, digest, self._gates.read_text(), cache.code_hash(*MEASURED_BY))
        kept = cache.load(KIND, key)
        if kept is not None:
            return dict(cache.unpack_json(kept["row"]))
        command = [sys.executable, "-m", f"{__package__}.worker", str(self._gates), *task.arguments]
        row = _row(task, self._processes.run(command, MINUTES))
        if not row.get("unfinished"):
            cache.store(KIND, key, {"row": cache.pack_json(row)})
        return row


def _tasks(fault: Fault) -> list[Task]:
    """One, or one for each size."""
    if not fault.sizes:
        return [Task((fault.id,), fault)]
    return [Task((fault.id, repr(size)), fault, size) for size in fault.sizes]


def _row(task: Task, ended: Ended) -> Row:
    """What a process said. A sound run that does not end well is a flag; so is a faulty one that dies."""
    finished = any(line.get("done") for line in ended.told)
    why = "" if finished else why_ended(ended.code, MINUTES)
    if task.fault is None:
        runs = [line for line in ended.told if "seed" in line]
        if not finished:
            runs.append(
                {"seed": -1, "scene": task.arguments[1], "flags": [_died(task.arguments[1], why)], "metrics": {}}
            )
        return {"runs": runs, "unfinished": not finished, "tail": ended.tail if not finished else ""}
    looked = [line for line in ended.told if "scene" in line]
    flags = [flag for line in looked for flag in line["flags"]]
    injected = any("injected" in line for line in ended.told)
    # A process that ends with an error of its own, before a scene was judged or while it was, is a fault that does not apply.
    valid = injected and (finished or ended.code is None or ended.code < 0)
    if valid and not finished:
        flags.append(_died(task.fault.scenes[min(len(looked), len(task.fault.scenes) - 1)], why))
    return {
        "id": task.fault.id,
        "title": task.fault.title,
        "file": task.fault.file,
        "size": task.size,
        "valid": valid,
        "caught": bool(flags),
        "by_gate": any(flag["metric"] != THE_RUN for flag in flags),
        "flags": flags,
        "scenes": [line["scene"] for line in looked],
        "seconds": ended.seconds,
        "died": why,
        "tail": "" if valid else ended.tail,
        "unfinished": not valid,
    }


def _died(scene: str, why: str) -> Row:
    return {"scene": scene, "metric": THE_RUN, "reason": why, "limit": "must end well", "value": None, "se": None}
