"""Runs `repair_worker` on one mesh and takes nothing from it on trust."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I64, Bool

WORKER = (sys.executable, "-P", str(Path(__file__).with_name("repair_worker.py")))  # -P: its folder is no import path
# One thread each: their stacks and arenas would count against the address space.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
MAX_REASON = 400


class WorkerFailed(RuntimeError):
    """Why a mesh could not be repaired, one line."""


@dataclass(frozen=True)
class Limits:
    """seconds: clock and processor time. memory_mib: address space."""

    seconds: float
    memory_mib: int


def limits_for(faces: int) -> Limits:
    """Measured on two shared cores: 1.3 s for 2e5 faces, 6 s and 0.6 GiB resident for 2e6; ten times that is allowed."""
    return Limits(20.0 + 4e-5 * faces, 2048 + faces // 1024)


def turned_by_worker(vertices: F64, faces: I64, limits: Limits, command: Sequence[str] = WORKER) -> Bool:
    """(F,) true for faces (F, 3) of vertices (V, 3) that the worker winds the other way round.

    Raises WorkerFailed if it lacks pymeshlab, crashes, runs over its limits, or answers with other triangles.
    """
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(source, vertices=vertices, faces=faces.astype(np.int32))
        _run([*command, str(source), str(target)], limits, folder)
        answer = _read(target)
    return _turned(faces, answer)


def _run(command: list[str], limits: Limits, folder: str) -> None:
    full = [*command, "--seconds", str(limits.seconds), "--memory-mib", str(limits.memory_mib)]
    try:
        done = subprocess.run(
            full,
            cwd=folder,
            env=os.environ | ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise WorkerFailed(f"mesh repair took longer than {limits.seconds:g} s") from error
    except OSError as error:
        raise WorkerFailed(f"mesh repair could not be started: {error.strerror}") from error
    if done.returncode == -signal.SIGXCPU:
        raise WorkerFailed(f"mesh repair took longer than {limits.seconds:g} s")
    lines = done.stderr.decode("utf-8", "replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "no message")
    said = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in last[:MAX_REASON])
    if done.returncode < 0:
        raise WorkerFailed(f"mesh repair crashed ({signal.strsignal(-done.returncode)}; {said})")
    if done.returncode:
        raise WorkerFailed(f"mesh repair failed: {said}")


def _read(path: Path) -> npt.NDArray[np.generic]:
    try:
        with np.load(path, allow_pickle=False) as answer:
            return np.asarray(answer["faces"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise WorkerFailed(f"mesh repair gave no readable answer ({type(error).__name__})") from error


def _turned(faces: I64, answer: npt.NDArray[np.generic]) -> Bool:
    if answer.shape != faces.shape or not np.issubdtype(answer.dtype, np.integer):
        raise WorkerFailed(f"mesh repair gave {answer.shape} {answer.dtype} for {faces.shape} faces")
    same = np.zeros(len(faces), bool)
    turned = np.zeros(len(faces), bool)
    for k in range(3):
        rolled = np.roll(answer, k, axis=1)
        same |= (rolled == faces).all(axis=1)
        turned |= (rolled[:, ::-1] == faces).all(axis=1)
    if not np.all(same ^ turned):
        raise WorkerFailed(f"mesh repair changed triangle {int(np.argmin(same ^ turned))}, only its winding may change")
    return turned
