"""A program of its own: turns flipped faces with pymeshlab, under limits of time and memory.

    python -m lightgauge.reference.scene.repair_worker IN.npz OUT.npz --seconds 20 --memory-mib 2048

pymeshlab is under the GPL, and native code that can crash: it is imported here and nowhere else (failure-catalogue G4).
IN.npz holds `vertices` (V, 3) f64 and `faces` (F, 3) i32; OUT.npz gets `faces` (F, 3) i32, the same triangles in the
same order, wound so that neighbours agree; which side of a piece is its front is left to the caller. Exit 0: done;
1: failed; 3: pymeshlab cannot be imported. The last line on standard error says why.
"""

from __future__ import annotations

import argparse
import math
import resource
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # run by its path, this file has no package around it, and starts in half the time
    from ..datatypes import F64, I32

FAILED, LACKING = 1, 3
INSTALL = "make setup, or: python -m pip install 'pymeshlab>=2025.7'"
FILTER = "meshing_re_orient_faces_coherently"
LIBRARIES = "apt-get update && apt-get install -y libgl1 libopengl0"


class Lacking(RuntimeError):
    """pymeshlab is not here. Carries the line that mends it."""


def limit(seconds: float, memory_mib: int) -> None:
    """Bound this process: address space, processor time, no core file. On Linux; elsewhere the caller's clock holds."""
    for what, value, grace in (
        (resource.RLIMIT_AS, memory_mib << 20, 0),
        (resource.RLIMIT_CPU, math.ceil(seconds), 5),  # between the two SIGXCPU tells what happened
        (resource.RLIMIT_CORE, 0, 0),
    ):
        hard = resource.getrlimit(what)[1]
        most = value + grace if hard == resource.RLIM_INFINITY else min(value + grace, hard)
        resource.setrlimit(what, (min(value, most), most))


def oriented(vertices: F64, faces: I32) -> I32:
    """(F, 3) the faces, wound coherently over each connected piece. Raises Lacking."""
    try:
        import pymeshlab
    except ModuleNotFoundError as error:
        raise Lacking(f"pymeshlab is not installed ({error}). To mend it, type: {INSTALL}") from error
    except ImportError as error:
        if "cannot open shared object file" not in str(error):  # "failed to map": the memory limit, for one
            raise
        raise Lacking(f"pymeshlab lacks a library ({error}). To mend it, type: {LIBRARIES}") from error
    meshes = pymeshlab.MeshSet(verbose=False)
    if not hasattr(meshes, FILTER):  # without libOpenGL it starts, and leaves its plugins out
        raise Lacking(f"pymeshlab could not load its plugin for {FILTER}. To mend it, type: {LIBRARIES}")
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=vertices, face_matrix=faces))
    getattr(meshes, FILTER)()
    return np.asarray(meshes.current_mesh().face_matrix(), np.int32)


def main(arguments: list[str] | None = None) -> int:
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--seconds", type=float, required=True, help="processor time")
    parser.add_argument("--memory-mib", type=int, required=True, help="address space")
    options = parser.parse_args(arguments)
    limit(options.seconds, options.memory_mib)
    try:
        with np.load(options.source, allow_pickle=False) as mesh:
            faces = oriented(mesh["vertices"], mesh["faces"])
        np.savez(options.target, faces=faces)
    except Lacking as error:
        return _end(str(error), LACKING)
    except MemoryError:
        return _end(f"needs more than {options.memory_mib} MiB of memory", FAILED)
    except Exception as error:  # pymeshlab raises its own and plain ones; the caller wants one line
        return _end(f"{type(error).__name__}: {error}", FAILED)
    return 0


def _end(message: str, code: int) -> int:
    sys.stderr.write(" ".join(message.split()) + "\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
