"""Geometry checks: what is wrong is refused, what is harmless is dropped and said."""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I32, I64, Bool
from ..errors import InputError
from .document import MeshArrays

MAX_COORDINATE_M = 1e9
# Twice the area over the squared longest edge under which a triangle counts as degenerate: a sliver of 1 : 10^7 has no
# stable normal in the single precision that ray tracing works in.
FLATNESS = 1e-7


def refuse_broken(mesh: MeshArrays, where: str) -> None:
    """Raises InputError for empty meshes, vertices that are not finite or too far away, and faces out of range."""
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise InputError(f"{where}: the mesh is empty; give it triangles or remove it")
    bad = ~np.isfinite(mesh.vertices).all(axis=1)
    if np.any(bad):
        k = int(np.argmax(bad))
        raise InputError(f"{where}: vertex {k} is not finite: {mesh.vertices[k].tolist()}; repair the mesh")
    far = np.abs(mesh.vertices).max(axis=1)
    if far.max() > MAX_COORDINATE_M:
        k = int(np.argmax(far))
        raise InputError(
            f"{where}: vertex {k} is {far[k]:.3g} m away, the limit is {MAX_COORDINATE_M:.0e}; check unit_m"
        )
    wrong = (mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))
    if np.any(wrong):
        k = int(np.argmax(wrong.any(axis=1)))
        raise InputError(
            f"{where}: face {k} has a vertex index out of range: {mesh.faces[k].tolist()}, "
            f"the mesh has {len(mesh.vertices)} vertices; repair the mesh"
        )
    if mesh.uvs is not None and not np.isfinite(mesh.uvs).all():
        k = int(np.argmax(~np.isfinite(mesh.uvs).all(axis=1)))
        raise InputError(f"{where}: texture coordinate {k} is not finite; repair the mesh")


def weld(vertices: F64) -> I64:
    """(V,) for each vertex the number of its place: vertices at exactly the same position share one."""
    points = np.ascontiguousarray(vertices + 0.0)  # −0 and 0 are the same place
    order = np.lexsort(points.T)
    changes = np.any(np.diff(points[order], axis=0) != 0.0, axis=1)
    places = np.empty(len(points), np.int64)
    places[order] = np.concatenate([[0], np.cumsum(changes)])
    return places


def flat_faces(vertices: F64, faces: I32) -> Bool:
    """(F,) true where the triangle has no area in single precision."""
    p = vertices.astype(np.float32).astype(np.float64)[faces]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    double_area = np.linalg.norm(np.cross(a, b), axis=1)
    longest = np.maximum(np.maximum((a * a).sum(1), (b * b).sum(1)), ((a - b) ** 2).sum(1))
    return np.asarray(double_area <= FLATNESS * longest, bool)


def repeated_faces(corners: I64) -> Bool:
    """(F,) true for all but the first of triangles with the same corners in the same winding."""
    first = corners.argmin(axis=1)
    rolled = corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3]
    order = np.lexsort(rolled.T)
    same = np.concatenate([[False], np.all(np.diff(rolled[order], axis=0) == 0, axis=1)])
    out = np.zeros(len(corners), bool)
    out[order] = same  # lexsort is stable: the first of a run has the lowest number
    return out


def is_closed(corners: I64) -> bool:
    """Watertight with consistent winding: each directed edge once, and its reverse once.

    The sign of the volume does not matter: the inside of a room is its front.
    """
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    n = int(corners.max()) + 1 if corners.size else 1
    forward, backward = np.sort(start * n + end), np.sort(end * n + start)
    unique = bool(np.all(np.diff(forward) > 0))
    return unique and bool(np.array_equal(forward, backward))


def tidy(mesh: MeshArrays, where: str) -> tuple[MeshArrays, bool, list[str]]:
    """Drop degenerate and repeated triangles. Returns the mesh, whether it is closed, and notes.

    Vertices without a face are dropped too, so that bounds mean the surface. Raises InputError if no area is left.
    """
    refuse_broken(mesh, where)
    flat = flat_faces(mesh.vertices, mesh.faces)
    if flat.all():
        raise InputError(
            f"{where}: the mesh has no area: all {len(flat)} triangles are degenerate; repair or remove it"
        )
    faces = mesh.faces[~flat]
    corners = weld(mesh.vertices)[faces]
    repeated = repeated_faces(corners)
    faces, corners = faces[~repeated], corners[~repeated]
    counts = ((int(flat.sum()), "degenerate"), (int(repeated.sum()), "repeated"))
    notes = [f"{where}: dropped {n} {kind} of {len(flat)} triangles" for n, kind in counts if n]
    used, inverse = np.unique(faces, return_inverse=True)
    uvs = None if mesh.uvs is None else mesh.uvs[used]
    kept = MeshArrays(mesh.vertices[used], inverse.reshape(-1, 3).astype(np.int32), uvs)
    return kept, is_closed(corners), notes
