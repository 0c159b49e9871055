"""The hybrid against pyviewfactor (contour integrals, https://pypi.org/project/pyviewfactor) on the same cube in a cube.

    speed_vs_pyviewfactor = our pairs/s / its pairs/s        error_vs_pyviewfactor = our rms over pairs / its rms

On 1,836 quads, the published box's 204 each cut in nine; rows that end in _816 (cut in four) and _204 (the box itself) say how much of
the gain hangs on size: our overhead is by the quad, its work by the pair. Both from mesh to matrix, in turn, on all cores; its own
compilation is over before the first repeat. Its obstacle is the inner cube alone: nothing else can stand in the way, and
it is faster so.
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
from .places import scene_of_quads, split
from .rows import CannotMeasure, Group, Row, Wanted, row_of
from .timing import interleaved

PACKAGE = "pyviewfactor"
MEND = ".venv/bin/pip install -c constraints.txt -e '.[bench]'"
NOISE = 1e-3  # a tenth of its error, and some
REPEATS = 7
FINE_REPEATS = 5
FINE = {"": (3, 1.75e-4), "_816": (2, 3.1e-4)}  # cuts of each edge, noise
AGREES = 3e-6  # rms per pair
KINDS = ("speed_vs_pyviewfactor", "error_vs_pyviewfactor", "pyviewfactor_pairs_per_s", "hybrid_pairs_per_s",
         "pyviewfactor_rms", "hybrid_vs_pyviewfactor_rms")  # fmt: skip
NAMES = tuple(kind + suffix for suffix in (*FINE, "_204") for kind in KINDS)


@contextmanager
def peer(box: Box, folder: Path) -> Iterator[tuple[F64, Callable[[int], float]]]:
    """Its matrix (N, N), and a task that lets it compute that once more. Raises CannotMeasure if it is absent or fails."""
    _require_peer()
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
    """All rows of the comparison: the finer boxes, and the published one of 204 quads, whose overhead is a larger share."""
    _require_peer()
    ensure_variant()
    for suffix, (cut, noise) in FINE.items():
        if wanted & {kind + suffix for kind in KINDS}:
            yield from _rows(fine_box(cut, noise), noise, FINE_REPEATS, suffix, progress)
    if wanted & {kind + "_204" for kind in KINDS}:
        yield from _rows(published_box(), NOISE, REPEATS, "_204", progress)


def _require_peer() -> None:
    if find_spec(PACKAGE) is None:
        raise CannotMeasure(f"the package {PACKAGE} is not installed. To mend it: {MEND}")


def fine_box(cut: int, noise: float) -> Box:
    """The cube in a cube with every published quad cut in cut². The truth is our own hybrid with a tenth of the noise,
    which added up over the pieces has to give the published form factors. Raises CannotMeasure where it does not."""
    coarse = published_box()
    quads = np.concatenate([split(q, cut) for q in coarse.quads])
    scene = scene_of_quads(quads)
    truth = build(scene, OUTSIDE_RAYS, noise / 10.0, 99).matrix
    n = len(coarse.quads)
    together = truth.reshape(n, cut**2, n, cut**2).sum(axis=3).mean(axis=1)
    if rms(together, coarse.truth) > AGREES:
        raise CannotMeasure(f"the finer box adds up to {rms(together, coarse.truth):.2g} rms from the published one")
    return Box(scene, quads, truth)


def _rows(box: Box, noise: float, repeats: int, suffix: str, progress: Progress) -> Iterator[Row]:
    errors: list[float] = []

    def ours(repeat: int) -> float:
        built = build(box.scene, OUTSIDE_RAYS, noise, 2 + repeat)
        if repeat >= 0:
            errors.append(rms(built.matrix, box.truth))
        return built.seconds

    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder, peer(box, Path(folder)) as (matrix, task):
        s = interleaved({"ours": ours, "its": task}, repeats, progress, PACKAGE)
    its_error, pairs = rms(matrix, box.truth), len(box.quads) ** 2
    note = f"{len(box.quads)} quads, our noise {noise:g}"
    speed, error = (None, None) if suffix else (10.0, 0.1)
    yield row_of(f"speed_vs_pyviewfactor{suffix}", s["its"] / s["ours"], "ratio", "higher", speed, note)
    yield row_of(f"error_vs_pyviewfactor{suffix}", np.array(errors) / its_error, "ratio", "lower", error, note)
    yield row_of(f"pyviewfactor_pairs_per_s{suffix}", pairs / s["its"], "1/s", "higher")
    yield row_of(f"hybrid_pairs_per_s{suffix}", pairs / s["ours"], "1/s", "higher", note=note)
    yield row_of(f"pyviewfactor_rms{suffix}", its_error, "per pair", "lower")
    yield row_of(f"hybrid_vs_pyviewfactor_rms{suffix}", errors, "per pair", "lower", note=note)


GROUPS = (Group(NAMES, compared),)
