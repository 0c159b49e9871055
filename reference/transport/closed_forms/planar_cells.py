"""Planar convex cells: triangles of a mesh joined in twos to quadrilaterals where that is exact, and cut in fours.

Fewer and rounder cells make closed forms cheaper and shafts thinner. A triangle is a cell whose last corner is doubled,
so every cell has four places.
"""

from __future__ import annotations

import numpy as np

from ...datatypes import F64, I32, I64, Bool
from .polygon_clip import unit_normals, vector_areas

# Triangles count as coplanar when no corner leaves the other's plane by more than this share of the shared edge.
FLAT = 1e-11


def cells_of(vertices: F64, faces: I32) -> F64:
    """Cells (E, 4, 3) of a mesh (V, 3), (F, 3), counter-clockwise; together they cover it once.

    Vertices at the same place count as one, whatever their numbers.
    """
    vertices, places = np.unique(np.asarray(vertices, dtype=np.float64) + 0.0, axis=0, return_inverse=True)
    return cells_and_faces(vertices, places.reshape(-1)[faces].astype(np.int32))[0]


def cells_and_faces(vertices: F64, faces: I32) -> tuple[F64, I64]:
    """Cells (E, 4, 3) of a mesh whose faces share vertices by number, and a face (E,) that each cell holds."""
    edge_face, edge_place = shared_edges(faces)
    quads = _quads(vertices, faces, edge_face, edge_place)
    good = np.flatnonzero(sound(quads))
    diagonal = np.linalg.norm(quads[:, 0] - quads[:, 2], axis=1)
    used = np.zeros(len(faces), dtype=np.bool_)
    chosen: list[int] = []
    longest = float(diagonal[good].max(initial=0.0)) or 1.0
    # Rounded, so that equal diagonals stay in the order of their edges at any scale.
    for k in good[np.argsort(-np.round(diagonal[good] / longest, 9), kind="stable")]:
        f, g = edge_face[k]
        if not (used[f] or used[g]):
            used[f] = used[g] = True
            chosen.append(int(k))
    single = np.flatnonzero(~used)
    triangles = vertices[faces[single][:, [0, 1, 2, 2]]]
    joined = np.array(chosen, dtype=np.int64)
    return np.concatenate([quads[joined], triangles]), np.concatenate([edge_face[joined, 0], single])


def shared_edges(faces: I32 | I64) -> tuple[I64, I64]:
    """Faces (K, 2) of (F, C) on both sides of edges that two faces run through in opposite directions, and the edge's place
    (K, 2) in each."""
    count = faces.shape[1]
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((start, high, low))
    low, high = low[order], high[order]
    new = np.concatenate([[True], (np.diff(low) != 0) | (np.diff(high) != 0)])
    first = np.flatnonzero(new)
    length = np.diff(np.concatenate([first, [len(order)]]))
    two = first[length == 2]
    a, b = order[two], order[two + 1]
    opposite = start[a] != start[b]
    both = np.stack([a[opposite], b[opposite]], axis=1)
    return both // count, both % count


def _quads(vertices: F64, faces: I32, edge_face: I64, edge_place: I64) -> F64:
    """The two triangles at each edge as one quadrilateral (K, 4, 3) with the edge as diagonal from corner 0 to 2."""
    f, g, place_f, place_g = edge_face[:, 0], edge_face[:, 1], edge_place[:, 0], edge_place[:, 1]
    corners = [faces[f, (place_f + 1) % 3], faces[f, (place_f + 2) % 3], faces[f, place_f], faces[g, (place_g + 2) % 3]]
    return np.asarray(vertices[np.stack(corners, axis=1)])


def sound(quads: F64) -> Bool:
    """(K,) whether quads (K, 4, 3) are planar, and convex with room to spare for rounding."""
    edges = np.roll(quads, -1, axis=1) - quads
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    normals = unit_normals(quads)
    size = np.linalg.norm(edges, axis=2).max(axis=1)
    heights = np.abs(np.einsum("kcx,kx->kc", quads - quads[:, :1], normals)).max(axis=1)
    turn = np.einsum("kcx,kx->kc", turns, normals)
    lengths = np.linalg.norm(edges, axis=2)
    corner = lengths * np.roll(lengths, 1, axis=1)
    return np.asarray((heights <= FLAT * size) & (turn > 1e-9 * corner).all(axis=1))


def quarters(cells: F64) -> F64:
    """Each cell (E, 4, 3) cut into four (E, 4, 4, 3): quadrilaterals at the middles of their edges, triangles likewise."""
    middle = 0.5 * (cells + np.roll(cells, -1, axis=1))
    a, b, c, d = (cells[:, k] for k in range(4))
    ab, bc, cd, da = (middle[:, k] for k in range(4))
    centre = 0.5 * (ab + cd)
    quads = [(a, ab, centre, da), (ab, b, bc, centre), (centre, bc, c, cd), (da, centre, cd, d)]
    triangle = np.all(c == d, axis=1)
    ca = da
    thirds = [(a, ab, ca, ca), (ab, b, bc, bc), (ca, bc, c, c), (ab, bc, ca, ca)]
    out = np.stack([np.stack(q, axis=1) for q in quads], axis=1)
    parts = np.stack([np.stack(q, axis=1) for q in thirds], axis=1)
    return np.where(triangle[:, None, None, None], parts, out)


def cell_areas(cells: F64) -> F64:
    """Areas (E,) m²."""
    return np.asarray(np.linalg.norm(vector_areas(cells), axis=1))
