"""A child process that measures one case: `python -m lightgauge.validation.stress.worker MODULE:ID SEED --memory-mib N`.

It answers on standard output, one JSON object a line: what it is about to do, then what it read. Whatever it and the libraries
below it print goes to standard error. A reading that is not finite is sent as null, with its name.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TextIO

from .bisect import Breaking, breaking
from .case import Case, Reading
from .catalogue import find_case

FAILED = 1
WATCH_S = 1.0


@dataclass
class Answers:
    """Writes lines to the parent."""

    stream: TextIO

    def say(self, **fields: Any) -> None:
        """One line."""
        self.stream.write(json.dumps(fields) + "\n")
        self.stream.flush()


def reading_json(reading: Reading) -> dict[str, Any]:
    """A reading for the wire."""
    value, se = float(reading.value), float(reading.se)
    if se < 0.0:
        raise ValueError(f"a standard error cannot be negative, got {se}")
    finite = math.isfinite(value) and math.isfinite(se)
    sent: dict[str, Any] = {"value": value if finite else None, "se": se if finite else None, "n": int(reading.n)}
    if reading.df is not None:
        sent["df"] = float(reading.df)
    return sent if finite else {**sent, "not_finite": f"{value} ± {se}"}


def measured(case: Case, value: float, seed: int, answers: Answers) -> Mapping[str, Reading]:
    """One value of the parameter: announced, measured, answered. ValueError for a curve that the case does not name."""
    answers.say(begin=value)
    started = time.perf_counter()
    readings = case.measure(value, seed)
    unknown = set(readings) - {curve.name for curve in case.curves}
    if unknown:
        raise ValueError(f"stress case {case.id} reads {sorted(unknown)}, which are none of its curves")
    sent = {name: reading_json(reading) for name, reading in readings.items()}
    answers.say(value=value, readings=sent, seconds=time.perf_counter() - started)
    return readings


def work(case: Case, seed: int, answers: Answers) -> None:
    """The sweep, then the point of failure."""
    known: dict[float, Reading] = {}
    for value in case.values:
        readings = measured(case, value, seed, answers)
        if case.breaks is not None and case.breaks in readings:
            known[value] = readings[case.breaks]
    if case.breaks is not None:
        name = case.breaks

        def look(value: float) -> Reading | None:
            return measured(case, value, seed, answers).get(name)

        answers.say(breaking=_breaking_json(breaking(case, known, look)))
    used = resource.getrusage(resource.RUSAGE_SELF)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime + children.ru_utime + children.ru_stime
    answers.say(done=True, cpu_s=cpu, peak_mib=max(used.ru_maxrss, children.ru_maxrss) / 1024)


def _breaking_json(found: Breaking) -> dict[str, Any]:
    return {"low": found.low, "high": found.high, "at": found.at, "said": found.said, "looks": sorted(found.looks)}


def limit(memory_mib: int) -> None:
    """Bound this process's address space; no core file."""
    for what, most in ((resource.RLIMIT_AS, memory_mib << 20), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(what)[1]
        value = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (value, value))


def leave_with_parent() -> None:
    """End this process and all that it started, once the process that started it is gone (killed, and so not able to)."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpgrp(), signal.SIGKILL)
        os._exit(FAILED)

    threading.Thread(target=watch, daemon=True).start()


def own_output() -> TextIO:
    """Standard output kept for us alone: file descriptor 1 becomes standard error for everybody else."""
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return stream


def main(given: list[str] | None = None) -> int:
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("address")
    parser.add_argument("seed", type=int)
    parser.add_argument("--memory-mib", type=int, required=True, help="address space")
    options = parser.parse_args(given)
    answers = Answers(own_output())
    limit(options.memory_mib)
    leave_with_parent()
    try:
        work(find_case(options.address), options.seed, answers)
    except MemoryError:
        return _end(answers, f"needs more than {options.memory_mib} MiB of memory")
    except Exception as error:  # whatever a case raises is an answer, and fails that case alone
        traceback.print_exception(error)
        return _end(answers, f"{type(error).__name__}: {error}")
    return 0


def _end(answers: Answers, message: str) -> int:
    answers.say(error=" ".join(message.split())[:1000])
    return FAILED


if __name__ == "__main__":
    sys.exit(main())
