"""Blockers made large: coplanar cells joined to convex quadrilaterals while that is exact.

A wall modelled as a grid blocks like the one rectangle it makes, but no single piece of it covers a shaft. Joined, it proves
more pairs blocked, and the walk through what stands in the way is shorter.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...datatypes import F64, I64, Bool
from .planar_cells import FLAT, shared_edges, sound

# Corners count as one when they agree to this share of the extent: under FLAT, so a joined cell covers no gap that matters.
SAME = 1e-12
# Any direction that no modelled edge is likely to halve: it tells the two directions of a grid apart.
ASKEW = np.array([0.36, 0.48, 0.8])


def joined_cells(cells: F64) -> F64:
    """Cells (N, 4, 3) that cover what `cells` (E, 4, 3) cover, N ≤ E; triangles, whose last corner is doubled, stay.

    Rows of a grid are joined first, in twos until none is left, then what they make across, and so on while anything joins.
    """
    vertices, faces = _numbered(cells)
    triangle = faces[:, 2] == faces[:, 3]
    quads, idle, across = faces[~triangle], 0, False
    while idle < 2 and len(quads) > 1:
        before = len(quads)
        quads = _joined_once(vertices, quads, across)
        if len(quads) == before:
            idle, across = idle + 1, not across
        else:
            idle = 0
    return np.concatenate([vertices[quads], cells[triangle]])


def _numbered(cells: F64) -> tuple[F64, I64]:
    """Vertices (V, 3) and the cells' corners by number (E, 4)."""
    corners = cells.reshape(-1, 3)
    low = corners.min(axis=0)
    extent = float((corners.max(axis=0) - low).max()) or 1.0
    place = np.round((corners - low) / (SAME * extent)).astype(np.int64)
    order = np.lexsort(place.T)
    new = np.concatenate([[True], (np.diff(place[order], axis=0) != 0).any(axis=1)])
    number = np.empty(len(corners), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    vertices = corners[order[new]]
    near = cKDTree(vertices).query_pairs(SAME * extent, output_type="ndarray")  # the same, but rounded to either side
    if len(near):
        links = sparse.coo_array((np.ones(len(near)), near.T), shape=(len(vertices),) * 2)
        _, group = connected_components(links, directed=False)
        _, first = np.unique(group, return_index=True)
        vertices, number = vertices[first], group.astype(np.int64)[number]
    return vertices, number.reshape(-1, 4)


def _joined_once(vertices: F64, quads: I64, across: bool) -> I64:
    """Quads (N, 4) after every cell was joined to one neighbour at most, through edges of one direction."""
    cell, place = shared_edges(quads)
    own, other = (cell[:, k] for k in range(2))
    i, j = place[:, 0], place[:, 1]
    # The shared edge runs from own's corner i to i + 1, in the other cell from corner j + 1 to j.
    a, b = (np.stack([quads[c, (k + n) % 4] for n in range(4)], axis=1) for c, k in ((own, i), (other, j)))
    edges = np.stack([vertices[quads[:, k + 1]] - vertices[quads[:, k]] for k in range(2)], axis=1)
    steep = np.abs(edges @ ASKEW) / np.linalg.norm(edges, axis=2)
    odd = steep[:, 0] <= steep[:, 1]  # whether the steeper edges are those from odd corners
    if across:
        odd = ~odd
    wanted = ((i % 2 == 1) == odd[own]) & ((j % 2 == 1) == odd[other])
    straight = _straight(vertices[a[:, 3]], vertices[a[:, 0]], vertices[b[:, 2]])
    straight &= _straight(vertices[b[:, 3]], vertices[a[:, 1]], vertices[a[:, 2]])
    union = np.stack([a[:, 2], a[:, 3], b[:, 2], b[:, 3]], axis=1)
    good = np.flatnonzero(wanted & straight)
    good = good[sound(vertices[union[good]])]
    used, chosen = np.zeros(len(quads), dtype=np.bool_), []
    for k, f, g in zip(good.tolist(), own[good].tolist(), other[good].tolist(), strict=True):
        if not (used[f] or used[g]):
            used[f] = used[g] = True
            chosen.append(k)
    return np.concatenate([quads[~used], union[np.array(chosen, dtype=np.int64)]])


def _straight(before: F64, corner: F64, after: F64) -> Bool:
    """(K,) whether the way from `before` over `corner` to `after`, each (K, 3), goes straight on."""
    to, on = corner - before, after - corner
    bend = np.linalg.norm(np.cross(to, on), axis=1)
    return np.asarray(
        (bend <= FLAT * np.einsum("kc,kc->k", after - before, after - before)) & (np.einsum("kc,kc->k", to, on) > 0.0)
    )
