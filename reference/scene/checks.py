"""What a mesh must be to be read at all, and what of it has no area or stands twice."""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I32, I64, Bool
from ..errors import InputError
from .document import MeshArrays

MAX_COORDINATE_M = 1e9


def refuse_broken(mesh: MeshArrays, where: str) -> None:
    """Raises InputError for empty meshes, vertices that are not finite or too far away, and faces out of range."""
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise InputError(f"{where}: the mesh is empty; give it triangles or remove it")
    refuse_vertices(mesh.vertices, where)
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


def refuse_vertices(vertices: F64, where: str) -> None:
    """Raises InputError for vertices (V, 3) m that are not finite or too far away."""
    bad = ~np.isfinite(vertices).all(axis=1)
    if np.any(bad):
        k = int(np.argmax(bad))
        raise InputError(f"{where}: vertex {k} is not finite: {vertices[k].tolist()}; repair the mesh")
    far = np.abs(vertices).max(axis=1)
    if far.max() > MAX_COORDINATE_M:
        k = int(np.argmax(far))
        raise InputError(
            f"{where}: vertex {k} is {far[k]:.3g} m away, the limit is {MAX_COORDINATE_M:.0e}; check unit_m"
        )


def weld(vertices: F64) -> I64:
    """(V,) for each vertex the number of its place: vertices at exactly the same position share one."""
    points = np.ascontiguousarray(vertices + 0.0)  # −0 and 0 are the same place
    order = np.lexsort(points.T)
    changes = np.any(np.diff(points[order], axis=0) != 0.0, axis=1)
    places = np.empty(len(points), np.int64)
    places[order] = np.concatenate([[0], np.cumsum(changes)])
    return places


def proportions(vertices: F64, faces: I32) -> tuple[F64, F64]:
    """(F,) twice the area and (F,) the squared longest edge of each triangle, m², in single precision coordinates."""
    p = vertices.astype(np.float32).astype(np.float64)[faces]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    double_area = np.linalg.norm(np.cross(a, b), axis=1)
    longest = np.maximum(np.maximum((a * a).sum(1), (b * b).sum(1)), ((a - b) ** 2).sum(1))
    return double_area, longest


def backed_faces(corners: I64) -> Bool:
    """(F,) true for triangles that repeat another one from behind and fit worse to their neighbours: more of their edges
    are run through the same way by other triangles. Rays could not tell which of the two they meet."""
    key = np.sort(corners, axis=1)
    _, group, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    _, edge, times = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    conflict = times[edge.reshape(-1)].reshape(-1, 3).sum(axis=1)
    best = np.full(len(count), np.iinfo(np.int64).max)
    np.minimum.at(best, group, conflict)
    return np.asarray((count[group] > 1) & (conflict > best[group]))


def repeated_faces(corners: I64) -> Bool:
    """(F,) true for all but the first of triangles with the same corners in the same winding."""
    first = corners.argmin(axis=1)
    rolled = corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3]
    order = np.lexsort(rolled.T)
    same = np.concatenate([[False], np.all(np.diff(rolled[order], axis=0) == 0, axis=1)])
    out = np.zeros(len(corners), bool)
    out[order] = same  # lexsort is stable: the first of a run has the lowest number
    return out
