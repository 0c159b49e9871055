"""The hybrid against pyviewfactor (contour integrals, https://pypi.org/project/pyviewfactor) on the same cube in a cube.

    speed_vs_pyviewfactor = our pairs/s / its pairs/s        error_vs_pyviewfactor = our rms over pairs / its rms

Both from mesh to matrix, in turn, on all cores; its own compilation is over before the first repeat. Its obstacle is the inner cube
alone: nothing else can stand in the way, and it is faster so.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ...reference.datatypes import F64
from ...reference.progress import Progress
from ...reference.variant import ensure_variant
from .box_rows import OUTSIDE_RAYS, Box, build, published_box, rms
from .rows import CannotMeasure, Group, Row, Wanted, row_of
from .timing import interleaved

PACKAGE = "pyviewfactor"
MEND = ".venv/bin/pip install -c constraints.txt -e '.[bench]'"
NOISE = 1e-3  # a tenth of its error, and some
REPEATS = 7
NAMES = (
    "speed_vs_pyviewfactor", "error_vs_pyviewfactor", "pyviewfactor_pairs_per_s", "hybrid_pairs_per_s", "pyviewfactor_rms",
    "hybrid_vs_pyviewfactor_rms",
)  # fmt: skip


@contextmanager
def peer(box: Box, folder: Path) -> Iterator[tuple[F64, Callable[[int], float]]]:
    """Its matrix (N, N), and a task that lets it compute that once more. Raises CannotMeasure if it is absent or fails."""
    if find_spec(PACKAGE) is None:
        raise CannotMeasure(f"the package {PACKAGE} is not installed. To mend it: {MEND}")
    inner = np.abs(box.quads).max(axis=(1, 2)) < 1.0
    order = np.argsort(inner, kind="stable")
    quads, out, errors = folder / "quads.npy", folder / "matrix.npy", folder / "errors.txt"
    np.save(quads, box.quads[order])
    command = [sys.executable, "-m", f"{__package__}.peer_child", str(quads), str(out), str(int(inner.sum()))]
    with (
        errors.open("w") as log,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True) as child,
    ):
        assert child.stdin is not None and child.stdout is not None

        def answer() -> str:
            assert child.stdout is not None
            line = child.stdout.readline().strip()
            if not line:
                said = (errors.read_text(errors="replace").strip().splitlines() or ["no message"])[-1]
                raise CannotMeasure(f"{PACKAGE} ended before it answered: {said}")
            return line

        def task(repeat: int) -> float:
            del repeat
            assert child.stdin is not None
            # Past Python's buffer, which could not be closed if the child ended; `answer` then says why it did.
            with suppress(BrokenPipeError):
                os.write(child.stdin.fileno(), b"again\n")
            return float(answer())

        answer()
        place = np.argsort(order)
        yield np.load(out, allow_pickle=False)[np.ix_(place, place)], task
        child.stdin.close()  # ends it


def compared(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """All rows of the comparison."""
    del wanted
    ensure_variant()
    box, errors = published_box(), []

    def ours(repeat: int) -> float:
        built = build(box.scene, OUTSIDE_RAYS, NOISE, 2 + repeat)
        if repeat >= 0:
            errors.append(rms(built.matrix, box.truth))
        return built.seconds

    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder, peer(box, Path(folder)) as (matrix, task):
        s = interleaved({"ours": ours, "its": task}, REPEATS, progress, PACKAGE)
    its_error, pairs = rms(matrix, box.truth), len(box.quads) ** 2
    note = f"{len(box.quads)} quads, our noise {NOISE:g}"
    yield row_of("speed_vs_pyviewfactor", s["its"] / s["ours"], "ratio", "higher", 10.0, note)
    yield row_of("error_vs_pyviewfactor", np.array(errors) / its_error, "ratio", "lower", 0.1, note)
    yield row_of("pyviewfactor_pairs_per_s", pairs / s["its"], "1/s", "higher")
    yield row_of("hybrid_pairs_per_s", pairs / s["ours"], "1/s", "higher", note=note)
    yield row_of("pyviewfactor_rms", its_error, "per pair", "lower")
    yield row_of("hybrid_vs_pyviewfactor_rms", errors, "per pair", "lower", note=note)


GROUPS = (Group(NAMES, compared),)
