"""The radiosity solvers on cornell, each to the same residual: sweeps' worth of row operations, and milliseconds.

A row operation is one row of form factors gathered, or one column shot; P of them are one Jacobi sweep.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...reference import pipeline
from ...reference.progress import Progress
from ...reference.transport.solver_types import matrix_system
from ...reference.transport.solvers import METHODS, solve
from ...reference.transport.spectral import estimate_spectrum
from .places import bundled
from .rows import Group, Row, Wanted, row_of

TOLERANCE = 1e-5
REPEATS = 5
NAMES = tuple(f"solver_{name}_{unit}" for name in METHODS for unit in ("sweeps", "ms"))


def solvers(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """Two rows a method, on one system on the host."""
    del wanted
    scene = bundled("cornell")
    surfaces = pipeline.bake_surfaces(scene, 0, progress)
    light = pipeline.light_patches(scene, surfaces, 0, progress)
    p = surfaces.patches
    system = matrix_system(surfaces.rows, p.albedo, p.exitance + p.albedo * light.direct, p.area)
    spectrum = estimate_spectrum(system)
    note = f"cornell, {p.count} patches, to {TOLERANCE:g} of the source, spectral radius {spectrum.radius:.3f}"
    for number, (name, method) in enumerate(METHODS.items()):
        found = [solve(system, method, TOLERANCE, spectrum=spectrum) for _ in range(REPEATS)]
        sweeps = [s.row_operations / p.count for s in found]
        yield row_of(f"solver_{name}_sweeps", sweeps, "sweeps", "lower", note=note)
        yield row_of(f"solver_{name}_ms", [1e3 * s.seconds for s in found], "ms", "lower", note=note)
        progress("solvers", number + 1, len(METHODS))


GROUPS = (Group(NAMES, solvers),)
