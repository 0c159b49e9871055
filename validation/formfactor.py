"""`lightgauge formfactor`: mesh files in, one form factor out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..reference.datatypes import F64, I32, Bool
from ..reference.errors import InputError
from ..reference.scene.checks import refuse_broken, repeated_faces, weld
from ..reference.scene.document import MeshArrays
from ..reference.scene.obj import read_obj
from ..reference.scene.ply import read_ply
from ..reference.transport.closed_forms.pair import LEAST_RAYS, MOST_RAYS, PairFormFactor, mesh_form_factor
from .polygon_fans import unfolded

# Twice the area over the squared longest edge under which a triangle has none: float64 coordinates say no more.
DEGENERATE = 1e-13
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class MeshFile:
    """A mesh from a file. vertices (V, 3) f64, in the file's unit; faces (F, 3) i32."""

    vertices: F64
    faces: I32


def read_mesh(path: Path, role: str, say: Say) -> MeshFile:
    """A PLY or OBJ file; what was dropped or turned in it is said. role: what the command line calls it.

    Raises InputError naming role and file for files that cannot be read, vertices that are not finite, and meshes
    without area.
    """
    arrays = _read(path, role, say)
    where = f"{role}: {path.name}"
    refuse_broken(arrays, where)
    faces, mended = unfolded(arrays.vertices, arrays.faces)
    if mended:
        say(f"{where}: cut polygons that are not convex into triangles anew: {mended}")
    flat = degenerate(arrays.vertices, faces)
    if flat.all():
        raise InputError(
            f"{where}: the mesh has no area: face 0 and all of its {len(flat)} triangles are degenerate; repair it"
        )
    if flat.any():
        first = int(np.argmax(flat))
        say(f"{where}: dropped {int(flat.sum())} of {len(flat)} triangles without area, the first is number {first}")
    faces = faces[~flat]
    again = repeated_faces(weld(arrays.vertices)[faces])
    if again.any():
        say(f"{where}: dropped {int(again.sum())} of {len(again)} triangles that stand twice")
    return MeshFile(arrays.vertices, np.ascontiguousarray(faces[~again]))


def _read(path: Path, role: str, say: Say) -> MeshArrays:
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return read_ply(path, role)
    if suffix != ".obj":
        raise InputError(f"{role}: {path}: cannot tell the format; expected a .ply or .obj file")
    read = read_obj(path, role)
    if read.against_normals.any():
        count = f"{int(read.against_normals.sum())} of {len(read.faces)} triangles"
        say(f"{role}: {path.name}: the normals of {count} point to their back; the winding decides what is the front")
    return MeshArrays(read.vertices, read.faces)


def degenerate(vertices: F64, faces: I32) -> Bool:
    """(F,) true where a triangle has no area beyond the rounding of its corners."""
    p = vertices[faces]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    longest = np.sqrt(np.max([(e * e).sum(axis=1) for e in (a, b, a - b)], axis=0))
    rounding = 4.0 * np.finfo(np.float64).eps * np.abs(p).max(axis=(1, 2))
    area = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(area <= longest * np.maximum(DEGENERATE * longest, rounding), dtype=np.bool_)


def pair_of_files(
    emitter: Path, receiver: Path, occluders: list[Path], rays: int, seed: int, say: Say
) -> PairFormFactor:
    """Form factor between two mesh files with occluders. Raises InputError."""
    if not LEAST_RAYS <= rays <= MOST_RAYS:
        raise InputError(f"--rays {rays}: out of range; expected {LEAST_RAYS} to {MOST_RAYS}")
    first = read_mesh(emitter, "FROM", say)
    same = emitter.resolve() == receiver.resolve()
    second = first if same else read_mesh(receiver, "TO", say)
    between = [read_mesh(path, "--occluder", say) for path in occluders]
    return mesh_form_factor(first, second, between, rays, seed)


def as_json(found: PairFormFactor) -> dict[str, Any]:
    """What `--json` prints."""
    return {"value": found.value, "se": found.se, "rays": found.rays, "method": found.method}


METHODS = {
    "contour": "closed form: provably nothing is in the way, or nothing is seen",
    "contour+rays": "closed form where it is proved that nothing is in the way, shadow rays for the rest",
    "rays": "cosine-distributed rays from the smaller mesh",
}


def as_text(found: PairFormFactor, emitter: str, receiver: str) -> str:
    """What is printed without `--json`; the meshes by name."""
    back = found.emitter_area / found.receiver_area
    lines = [
        f"F {emitter} -> {receiver}: {_with_error(found.value, found.se)}",
        f"F {receiver} -> {emitter}: {_with_error(found.reverse, found.se * back)}",
        f"method: {found.method} ({METHODS[found.method]}), {found.rays} rays",
        f"areas: {found.emitter_area:.9g}, {found.receiver_area:.9g} (squares of the files' unit)",
    ]
    return "\n".join(lines)


def _with_error(value: float, se: float) -> str:
    """As in 0.18593140 ± 0.0000033: the value to a hundredth of its standard error, ten digits where that is 0."""
    if se == 0.0:
        return f"{value:.10g} ± 0"
    digits = max(0, 2 - int(np.floor(np.log10(se))) - 1)
    return f"{value:.{digits + 1}f} ± {se:.2g}"
