"""pyviewfactor in a process of its own, so that its compiler and ours never meet: `python -m … QUADS.npy OUT.npy OBSTACLES`.

Reads quads (N, 4, 3), the last OBSTACLES of which may stand in the way, computes the matrix once, which also compiles, writes it to
OUT and prints "ready". Then it computes the matrix once for every line on standard input, and prints the seconds taken.
"""

from __future__ import annotations

import importlib
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from ...reference.datatypes import F64


def surface(quads: F64) -> Any:
    """Quads as a pyvista.PolyData."""
    pyvista = importlib.import_module("pyvista")
    corners = np.arange(4 * len(quads)).reshape(-1, 4)
    faces = np.column_stack([np.full(len(quads), 4), corners]).ravel()
    return pyvista.PolyData(np.asarray(quads, np.float64).reshape(-1, 3), faces)


def main(quads_file: Path, out: Path, obstacles: int) -> None:
    """See above."""
    pyviewfactor = importlib.import_module("pyviewfactor")
    quads = np.load(quads_file, allow_pickle=False)
    mesh, obstacle = surface(quads), surface(quads[len(quads) - obstacles :])

    def matrix() -> F64:
        # Visibility and obstruction checks are on; F[i, j] is the factor from j to i.
        return np.asarray(pyviewfactor.compute_viewfactor_matrix(mesh, obstacles=obstacle)).T

    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever libraries print, the answers stay clean
    np.save(out, matrix())
    print("ready", file=answers, flush=True)
    for _ in sys.stdin:
        begin = time.perf_counter()
        matrix()
        print(time.perf_counter() - begin, file=answers, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
