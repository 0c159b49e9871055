"""The worker as a program: its limits, its absence, its crashes, and answers that are not to be trusted."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.scene import repair_worker
from lightgauge.reference.scene.primitives import sphere
from lightgauge.reference.scene.repair_process import WORKER, Limits, WorkerFailed, limits_for, turned_by_worker

BALL = sphere()
FACES = BALL.faces.astype(np.int64)
BAD = FACES.copy()
BAD[[3, 70]] = BAD[[3, 70], ::-1]
AMPLE = Limits(60.0, 4096)


def script(code: str) -> tuple[str, ...]:
    """A worker that does something else. Its arguments: IN, OUT, --seconds S, --memory-mib M."""
    return (sys.executable, "-c", code)


def failure(command: tuple[str, ...], limits: Limits = AMPLE) -> str:
    with pytest.raises(WorkerFailed) as caught:
        turned_by_worker(BALL.vertices, BAD, limits, command)
    assert str(caught.value).isprintable()
    return str(caught.value)


def test_it_turns_what_is_flipped() -> None:
    turned = turned_by_worker(BALL.vertices, BAD, AMPLE)
    flipped = np.isin(np.arange(len(BAD)), [3, 70])
    assert np.array_equal(turned, flipped) or np.array_equal(turned, ~flipped)


def test_as_a_module(tmp_path: Path) -> None:
    """`python -m …`, as its documentation says, with the answer in the order of the question."""
    np.savez(tmp_path / "in.npz", vertices=BALL.vertices, faces=BAD.astype(np.int32))
    command = [sys.executable, "-m", "lightgauge.reference.scene.repair_worker", "in.npz", "out.npz"]
    done = subprocess.run([*command, "--seconds", "60", "--memory-mib", "4096"], cwd=tmp_path, check=False)
    assert done.returncode == 0
    with np.load(tmp_path / "out.npz", allow_pickle=False) as answer:
        assert np.array_equal(np.sort(answer["faces"], axis=1), np.sort(FACES, axis=1))


def test_memory_limit() -> None:
    said = failure(WORKER, Limits(60.0, 150))
    assert "needs more than 150 MiB" in said or "failed to map" in said  # by Python, or by the loader of libraries


def test_clock() -> None:
    start = time.perf_counter()
    assert failure(script("import time; time.sleep(30)"), Limits(0.5, 4096)) == "mesh repair took longer than 0.5 s"
    assert time.perf_counter() - start < 10.0


def test_processor_time_limit() -> None:
    """The limit that the worker sets for itself, reached before the clock of its parent."""
    code = f"import runpy; runpy.run_path({repair_worker.__file__!r})['limit'](1.0, 4096)\nwhile True: pass"
    assert failure(script(code), Limits(30.0, 4096)) == "mesh repair took longer than 30 s"


def test_crash() -> None:
    said = failure(script("import os, sys; sys.stderr.write('half a\\x1b[31m word'); sys.stderr.flush(); os.abort()"))
    assert "crashed" in said and "Abort" in said and "half a" in said


def test_program_that_is_not_there() -> None:
    assert "could not be started" in failure(("/nowhere/python",))


@pytest.mark.parametrize(
    ("stub", "words"),
    [
        ("raise ModuleNotFoundError(\"No module named 'pymeshlab'\")", ["not installed", "make setup", "pip install"]),
        (
            "raise ImportError('libOpenGL.so.0: cannot open shared object file: No such file or directory')",
            ["libOpenGL.so.0", "apt-get install -y libgl1 libopengl0"],
        ),
        (
            "class MeshSet:\n    def __init__(self, verbose): pass\nclass Mesh: pass",
            ["plugin", "apt-get install -y libgl1 libopengl0"],
        ),
        ("raise ImportError('x.so: failed to map segment from shared object')", ["failed to map"]),
    ],
)
def test_pymeshlab_that_cannot_be_imported(
    tmp_path: Path, stub: str, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pymeshlab.py").write_text(stub)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    said = failure(WORKER)
    for word in words:
        assert word in said, said
    assert ("apt-get" in said) == ("apt-get" in "".join(words))


WRITE = "import sys, numpy as np; f = np.load(sys.argv[1])['faces']; "


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("pass", "no readable answer"),
        ("import sys; open(sys.argv[2], 'wb').write(b'PK' + bytes(99))", "no readable answer"),
        ("import sys; open(sys.argv[2], 'wb').write(b'junk')", "no readable answer"),
        (WRITE + "np.savez(sys.argv[2], other=f)", "no readable answer"),
        (WRITE + "np.savez(sys.argv[2], faces=np.array([{}], object))", "no readable answer"),
        (WRITE + "np.savez(sys.argv[2], faces=f[1:])", "gave (2047, 3)"),
        (WRITE + "np.savez(sys.argv[2], faces=f + 0.5)", "float64"),
        (WRITE + "np.savez(sys.argv[2], faces=f[::-1])", "changed triangle 0"),
        (WRITE + "f[5, 1] = 0; np.savez(sys.argv[2], faces=f)", "changed triangle 5"),
        ("raise SystemExit('out of luck')", "out of luck"),
    ],
)
def test_answers_that_are_none(code: str, words: str) -> None:
    assert words in failure(script(code))


def test_answers_may_start_at_any_corner() -> None:
    code = WRITE + "f = np.roll(f, 1, axis=1); f[4] = f[4, ::-1]; np.savez(sys.argv[2], faces=f)"
    turned = turned_by_worker(BALL.vertices, BAD, AMPLE, script(code))
    assert np.flatnonzero(turned).tolist() == [4]


def test_limits_grow_with_the_mesh() -> None:
    small, large = limits_for(100), limits_for(2_000_000)
    assert small.seconds < large.seconds <= 120.0 and 1024 < small.memory_mib < large.memory_mib
