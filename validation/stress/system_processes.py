"""G4, G7, G10: processes that crash, are killed, or start on a machine that lacks something."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from ..record import dumps, write_json_atomic
from .case import Reading

MESHES = 6
REPAIR_SECONDS = 1.0
# Programs in the place of the repair worker: native crash, wild read, hang, memory, silence, another mesh.
ENDS = (
    "import os; os.abort()",
    "import ctypes; ctypes.string_at(0)",
    "import time; time.sleep(60)",
    "import resource; resource.setrlimit(resource.RLIMIT_AS, (1 << 28,) * 2); bytearray(1 << 30)",
    "pass",
    "import sys, numpy as np; m = np.load(sys.argv[1]); np.savez(sys.argv[2], faces=m['faces'] + 1)",
)
KILLS = 12
LINES = 400


def repair_crashes(crashing: float, seed: int) -> Mapping[str, Reading]:
    """G4: six meshes with flipped faces, of which so many end their repair worker in different ways."""
    from ...reference.errors import InputError
    from ...reference.scene.document import MeshArrays
    from ...reference.scene.mesh_repair import repair
    from ...reference.scene.primitives import sphere
    from ...reference.scene.repair_process import WORKER, Limits, turned_by_worker

    ball = sphere()
    faces = ball.faces.copy()
    faces[[3, 70]] = faces[[3, 70], ::-1]
    mesh = MeshArrays(ball.vertices, faces)
    limits = Limits(REPAIR_SECONDS, 2048)
    unsaid = lost = taken = 0
    longest = 0.0
    for number in range(MESHES):
        bad = number < crashing
        command = (sys.executable, "-c", ENDS[number]) if bad else WORKER

        def turner(v: object, f: object, given: object, command: tuple[str, ...] = command, bad: bool = bad) -> object:
            return turned_by_worker(v, f, limits if bad else given, command)  # type: ignore[arg-type]

        started = time.perf_counter()
        kept = repair(mesh, "meshes.ball", has_front=False, turner=turner)  # type: ignore[arg-type]
        longest = max(longest, time.perf_counter() - started) if bad else longest
        said = " ".join(kept.notes)
        unsaid += bad and "mesh repair" not in said
        lost += not bad and "turned" not in said
        if bad:
            try:
                repair(mesh, "meshes.ball", has_front=True, turner=turner)  # type: ignore[arg-type]
                taken += 1
            except InputError as error:
                unsaid += "meshes.ball" not in str(error)
    return {
        "crashes not said": Reading(unsaid),
        "sound meshes not mended": Reading(lost),
        "taken though the front matters": Reading(taken),
        "longest wait": Reading(longest),
    }


def kills(milliseconds: float, seed: int) -> Mapping[str, Reading]:
    """G7: a writer of records killed after so many milliseconds; the file that is found, by our way and by a plain one."""
    return {
        "half files": Reading(halves(write_json_atomic, milliseconds), n=KILLS),
        "half files, written plainly": Reading(halves(written_plainly, milliseconds), n=KILLS),
    }


def halves(write: Callable[[Path, Any], None], milliseconds: float) -> int:
    """Kills, of KILLS, after which the file is neither the old record nor the new one. A forked child writes one after the other."""
    found = 0
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder:
        path = Path(folder) / "results.json"
        for number in range(KILLS):
            write_json_atomic(path, record_number(0))
            child = os.fork()
            if child == 0:
                write_for_ever(write, path)
            time.sleep((milliseconds + 0.37 * number) / 1e3)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            found += not whole(path)
    return found


def record_number(k: int) -> dict[str, Any]:
    """One of two records that differ from beginning to end."""
    return {"a": k % 2, "lines": [f"{k % 2} " * 40] * LINES, "end": k % 2}


def write_for_ever(write: Callable[[Path, Any], None], path: Path) -> NoReturn:
    """The child's work: ends by being killed, or with the process if a write fails."""
    k = 0
    try:
        while True:
            k += 1
            write(path, record_number(k))
    finally:
        os._exit(1)


def written_plainly(path: Path, record: Any) -> None:
    """As it would be without care: opened, emptied, filled."""
    with path.open("w", encoding="utf-8", buffering=256) as file:
        file.write(dumps(record))


def whole(path: Path) -> bool:
    """Whether the file is one of the two records."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return record in (record_number(0), record_number(1))


OLDEST = 14
LACKS: tuple[tuple[dict[str, str], str], ...] = (
    ({"DRJIT_LIBLLVM_PATH": "/nonexistent/libLLVM.so.19"}, "To mend it: "),
    ({"OCL_ICD_VENDORS": "/nonexistent", "POCL_DEVICES": "none"}, "To mend it: pip install 'pyopencl[pocl]'"),
    ({"PATH": "/nonexistent"}, "To mend it: "),
)


def lacking(major: float, seed: int) -> Mapping[str, Reading]:
    """G10: Dr.Jit with an LLVM of this major version; at the oldest, also whole runs without LLVM, OpenCL and linker."""
    from ...reference import variant
    from ...reference.errors import EnvironmentLacks

    status = variant.LlvmStatus((int(major), 0, 0), f"/usr/lib/libLLVM-{int(major)}.so")
    taken, unsaid = 1.0, 0.0
    try:
        variant.require_llvm(status, {})
    except EnvironmentLacks as error:
        taken, unsaid = 0.0, float("To mend it: " not in str(error) or str(int(major)) not in str(error))
    found = {"taken": Reading(taken), "refused without a line": Reading(unsaid)}
    if int(major) == OLDEST:
        wrong = sum(map(badly_ended, LACKS))
        found["runs that end otherwise"] = Reading(wrong, n=len(LACKS))
    return found


def badly_ended(lack: tuple[dict[str, str], str]) -> bool:
    """Whether `run` on such a machine ends with another code than 3, without the line, or after writing anything."""
    environment, line = lack
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder:
        out = Path(folder) / "out"
        command = [sys.executable, "-m", "lightgauge.validation.cli", "run", "cornell", "--quiet", "--out", str(out)]
        done = subprocess.run(
            command, env=os.environ | environment, capture_output=True, text=True, check=False, timeout=120
        )
        return done.returncode != 3 or line not in done.stderr or out.exists() or bool(done.stdout)
