"""What lies inside closed meshes: the oracle that validity is judged by (failure-catalogue C4).

    w(p) = 1/4π Σ_t Ω_t(p),   tan(Ω/2) = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|)

the winding number as a sum of signed solid angles (Jacobson et al. 2013, "Robust inside-outside segmentation using generalized
winding numbers"; Van Oosterom and Strackee 1983). Of a closed mesh it is a whole number: 1 within one that faces outwards, -1
within one that faces inwards (the shell of a room), 0 outside of its bounds. A room's shell stands for everything around it:
where one lies in no solid, the world outside is solid, and all winding numbers count from -1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..datatypes import F64, I32, I64, Bool
from ..visibility import Geometry

PAIRS_PER_BATCH = 1 << 16  # points × triangles


@dataclass(frozen=True, eq=False)
class Solids:
    """Closed pieces of the geometry, however many meshes they are made of.

    vertices (V, 3) f64 m. faces: per piece (T, 3) i32. base: 1 where the world outside is solid, else 0. open_triangles: how many
    one-sided triangles belong to no closed piece: the oracle knows nothing of them.
    """

    vertices: F64
    faces: tuple[I32, ...]
    base: int
    open_triangles: int

    @property
    def triangles(self) -> int:
        """Triangles of the closed pieces."""
        return sum(len(f) for f in self.faces)


def closed_solids(g: Geometry) -> Solids:
    """The closed pieces: triangles joined by edges (vertices at one place are one), each edge run through as often one way as
    the other. Sheets that have no inside (two-sided and not closed) are left out."""
    _, place = np.unique(g.vertices, axis=0, return_inverse=True)
    chosen = np.flatnonzero(g.counts_as_back)
    faces = place.reshape(-1)[g.faces[chosen]]
    piece = _pieces(faces)
    broken = np.unique(piece[_unbalanced(faces)])
    whole = [n for n in range(int(piece.max(initial=-1)) + 1) if n not in set(broken.tolist())]
    order = np.argsort(piece, kind="stable")
    start = np.searchsorted(piece[order], np.arange(int(piece.max(initial=-1)) + 2))
    pieces = tuple(g.faces[chosen[order[start[n] : start[n + 1]]]] for n in whole)
    solids = Solids(g.vertices, pieces, 0, int(np.isin(piece, broken).sum()))
    return Solids(g.vertices, pieces, _base(g, solids), solids.open_triangles)


def _edges(faces: I64) -> I64:
    """Directed edges (3 T, 2) of faces (T, 3), triangle by triangle."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def _pieces(faces: I64) -> I64:
    """Number of the piece that each triangle belongs to, (T,): triangles that share an edge are in one."""
    _, edge = np.unique(np.sort(_edges(faces), axis=1), axis=0, return_inverse=True)
    edge, owner = edge.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    n = len(faces) + int(edge.max(initial=-1)) + 1
    graph = sparse.coo_array((np.ones(len(edge)), (owner, len(faces) + edge)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1][: len(faces)], dtype=np.int64)


def _unbalanced(faces: I64) -> I64:
    """Triangles with an edge that is not run through as often one way as the other."""
    edges = _edges(faces)
    _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    balance = np.bincount(edge, np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    return np.flatnonzero((balance[edge] != 0).reshape(-1, 3).any(axis=1))


def _base(g: Geometry, solids: Solids) -> int:
    """How far winding numbers go below 0: the least one just in front of each piece that faces inwards."""
    fronts = []
    for faces in solids.faces:
        a, b, c = (g.vertices[faces[:, i]] - g.vertices[faces[0, 0]] for i in range(3))
        cross = np.cross(b, c)
        if np.einsum("ni,ni->", a, cross) < 0.0:
            largest = int(np.argmax(np.linalg.norm(np.cross(b - a, c - a), axis=1)))
            corners = g.vertices[faces[largest]]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            fronts.append(corners.mean(axis=0) + 1e-6 * g.scale * normal / np.linalg.norm(normal))
    if not fronts:
        return 0
    return max(0, -int(np.round(winding_number(solids, np.array(fronts)).min())))


def winding_number(solids: Solids, points: F64) -> F64:
    """Sum of the pieces' winding numbers at `points` (N, 3) m, (N,); each piece counts only within its own bounds, outside of
    which it is exactly 0."""
    total = np.zeros(len(points))
    for faces in solids.faces:
        corners = solids.vertices[faces]
        lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        within = np.flatnonzero(((points >= lower) & (points <= upper)).all(axis=1))
        step = max(1, PAIRS_PER_BATCH // len(faces))
        for begin in range(0, len(within), step):
            part = within[begin : begin + step]
            total[part] += solid_angles(corners, points[part]).sum(axis=1) / (4.0 * math.pi)
    return total


def solid_angles(corners: F64, points: F64) -> F64:
    """Signed solid angles (N, T) of triangles (T, 3, 3) from `points` (N, 3); positive where a point is behind the front.

    The products of differences are expanded, so that they are matrix products; the triangles' middle is the origin for that.
    """
    middle = corners.mean(axis=(0, 1))
    a, b, c = ((corners - middle)[:, i] for i in range(3))
    p = points - middle
    square = (p**2).sum(axis=1)[:, None]
    ab, bc, ca = ((v * w).sum(axis=1) - p @ (v + w).T + square for v, w in ((a, b), (b, c), (c, a)))
    la, lb, lc = (np.sqrt(np.maximum((v**2).sum(axis=1) - 2.0 * p @ v.T + square, 0.0)) for v in (a, b, c))
    b_c = np.cross(b, c)
    triple = (a * b_c).sum(axis=1) - p @ (np.cross(a, b) + b_c + np.cross(c, a)).T
    return np.asarray(2.0 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb))


def inside(solids: Solids, points: F64) -> Bool:
    """Whether each of `points` (N, 3) m lies in something solid, (N,)."""
    return np.asarray(winding_number(solids, points) + solids.base > 0.5)
