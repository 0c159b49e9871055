"""Cases in worker processes, a few at a time: each under limits of time and memory, in a process group that is killed whole.

What a case does to its process stays its own: a crash, a hang or a refusal is that case's outcome. Finished outcomes are kept in the
cache by the code, the case and the seed, so a run that was stopped goes on where it was (failure-catalogue G4, G7).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any

from .. import cache
from ..processes import Ended, Processes, why_ended, workers
from .catalogue import Entry

MEMORY_MIB = 4096  # address space; a worker's libraries alone map 0.8 GiB
KIND = "stress"
# What a case measures is any of the product; the page and the text about it are not.
MEASURED_BY = ("reference", "fastpath", "validation")
Outcome = dict[str, Any]
Done = Callable[[Entry, Outcome], None]


class Runner:
    """Runs cases. seed: of all of them. memory_mib: address space of each."""

    def __init__(self, seed: int, jobs: int | None = None, memory_mib: int = MEMORY_MIB) -> None:
        self._seed, self._jobs, self._memory_mib = seed, workers(jobs), memory_mib
        self._processes = Processes()

    def run(self, entries: Sequence[Entry], done: Done) -> dict[str, Outcome]:
        """Outcomes by id. done: called in this thread as each comes in. Ctrl-C kills the workers and keeps what is finished."""
        outcomes: dict[str, Outcome] = {}
        with ThreadPoolExecutor(self._jobs) as pool:
            # The longest first: none is then left to run alone at the end.
            first = sorted(entries, key=lambda e: -e.case.minutes)
            futures = {pool.submit(self.recalled, entry): entry for entry in first}
            try:
                for future in as_completed(futures):
                    entry = futures[future]
                    outcomes[entry.case.id] = future.result()
                    done(entry, outcomes[entry.case.id])
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                self._processes.stop()
                raise
        return {entry.case.id: outcomes[entry.case.id] for entry in entries}

    def recalled(self, entry: Entry) -> Outcome:
        """The outcome kept before, or a fresh one; one that crashed is not kept."""
        if entry.case.out_of_scope:
            return empty()
        name = cache.key(KIND, entry.address, self._seed, cache.code_hash(*MEASURED_BY))
        kept = cache.load(KIND, name)
        if kept is not None:
            return {**cache.unpack_json(kept["outcome"]), "recalled": True}
        outcome = self.measure(entry)
        if outcome["crash"] is None:
            cache.store(KIND, name, {"outcome": cache.pack_json(outcome)})
        return outcome

    def measure(self, entry: Entry) -> Outcome:
        """One case in a process of its own."""
        command = [sys.executable, "-m", f"{__package__}.worker", entry.address, str(self._seed),
                   "--memory-mib", str(self._memory_mib)]  # fmt: skip
        return outcome_of(self._processes.run(command, entry.case.minutes), entry.case.minutes)


def empty() -> Outcome:
    """The outcome of a case that was not run."""
    return {
        "readings": [],
        "breaking": None,
        "crash": None,
        "seconds": 0.0,
        "cpu_s": 0.0,
        "peak_mib": 0.0,
        "recalled": False,
    }


def outcome_of(ended: Ended, minutes: float) -> Outcome:
    """What a worker's answers amount to. minutes: its time limit."""
    found = {**empty(), "seconds": ended.seconds}
    at, error, finished = None, "", False
    for line in ended.told:
        at = line.get("begin", at)
        error = line.get("error", error)
        if "readings" in line:
            found["readings"].append(line)
        found["breaking"] = line.get("breaking", found["breaking"])
        if line.get("done"):
            finished = True
            found |= {"cpu_s": line["cpu_s"], "peak_mib": line["peak_mib"]}
    if finished and ended.code == 0:
        return found
    return {**found, "crash": {"value": at, "why": error or why_ended(ended.code, minutes), "stderr": ended.tail}}
