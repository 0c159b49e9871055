"""Commands in processes of their own, a few at a time, each under a time limit and in a process group that is killed whole.

What a command does to its process stays its own: a crash or a hang is an answer. Commands answer on standard output, one JSON object a
line.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any

from .machine import memory, usable_cores

WORKER_BYTES = 2 << 30  # what a worker is expected to hold
TAIL = 1500
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}


@dataclass(frozen=True)
class Ended:
    """told: the command's answers. code: its exit code, negative for a signal, None where it ran out of time. tail: the end of its
    standard error. seconds: how long it took."""

    told: tuple[dict[str, Any], ...]
    code: int | None
    tail: str
    seconds: float


def workers(jobs: int | None) -> int:
    """How many at a time: as asked for, else one a core as far as memory goes."""
    if jobs is not None:
        return jobs
    available = memory()[1]
    fits = max(1, available // WORKER_BYTES) if available else usable_cores()
    return max(1, min(usable_cores(), fits))


class Processes:
    """Starts commands; `stop` kills those that run, and lets none start any more."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._live: set[subprocess.Popen[bytes]] = set()
        self._stopped = False

    def run(self, command: Sequence[str], minutes: float) -> Ended:
        """Wait for a command, from any thread. Raises KeyboardInterrupt once stopped."""
        began = time.perf_counter()
        with tempfile.TemporaryFile() as answers, tempfile.TemporaryFile() as errors:
            code = self._wait(command, answers, errors, 60.0 * minutes)
            return Ended(_lines(answers), code, _tail(errors), time.perf_counter() - began)

    def _wait(self, command: Sequence[str], answers: IO[bytes], errors: IO[bytes], seconds: float) -> int | None:
        """Exit code of the command, None where it ran out of time. Whatever it started is gone afterwards."""
        with self._lock:
            if self._stopped:
                raise KeyboardInterrupt
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=answers, stderr=errors, env=os.environ | ENVIRONMENT,
                start_new_session=True,
            )  # fmt: skip
            self._live.add(process)
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            return None
        finally:
            with self._lock:
                self._live.discard(process)
            kill_group(process)

    def stop(self) -> None:
        """Kill every command with its children."""
        with self._lock:
            self._stopped = True
            for process in self._live:
                kill_group(process)


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a group, and all of the group. One that is gone already is no error."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _lines(stream: IO[bytes]) -> tuple[dict[str, Any], ...]:
    """The answers; a last line that was not finished is left out."""
    stream.seek(0)
    found = []
    for line in stream.read().decode("utf-8", "replace").splitlines():
        try:
            told = json.loads(line)
        except ValueError:
            continue
        if isinstance(told, dict):
            found.append(told)
    return tuple(found)


def _tail(stream: IO[bytes]) -> str:
    stream.seek(0, os.SEEK_END)
    stream.seek(max(0, stream.tell() - TAIL))
    return stream.read().decode("utf-8", "replace").strip()


def why_ended(code: int | None, minutes: float) -> str:
    """What an exit code other than 0 says."""
    if code is None:
        return f"time limit: {minutes:g} min were over"
    if code < 0:
        return f"crashed: {signal.strsignal(-code) or f'signal {-code}'}"
    return f"ended with exit code {code} before it was done"
