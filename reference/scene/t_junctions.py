"""T-junctions: an open edge in whose inside the end of another open edge lies. Rays do not mind; the mesh is not closed.

From such an edge's end two open edges leave in the same direction: the long one, and the first of the short ones.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I64, Bool
from .mesh_faults import Edges

# How far v may lie from the edge, in lengths of the edge.
ON_EDGE = 1e-6
# Rounding of coordinates, which are single precision in most files, in units of the largest coordinate.
ROUNDING = 4.0 * float(np.finfo(np.float32).eps)
# Open edges that are compared at one vertex; two are usual.
MAX_FAN = 16


def t_junctions(points: F64, edges: Edges) -> I64:
    """Faces, ascending, whose open edge has a T-junction next to one of its ends. points: (P, 3) m of the places."""
    open_edges = np.flatnonzero(edges.count == 1)
    ends = edges.ends[open_edges]
    place = ends.ravel(order="F")
    order = np.argsort(place, kind="stable")
    place, edge = place[order], order % max(len(ends), 1)
    away = points[ends[edge].sum(axis=1) - place] - points[place]
    slack = ROUNDING * float(np.abs(points).max(initial=0.0))
    found = np.zeros(len(ends), bool)
    for step in range(1, MAX_FAN):
        first = np.flatnonzero(place[step:] == place[: len(place) - step])
        if len(first) == 0:
            break
        longer, on = _longer_on(away[first], away[first + step], slack)
        found[edge[np.where(longer, first, first + step)[on]]] = True
    return np.unique(edges.half[edges.first[open_edges[found]]] // 3)


def _longer_on(a: F64, b: F64, slack: float) -> tuple[Bool, Bool]:
    """For pairs of vectors (N, 3): whether a is the longer, and whether the shorter one's end lies inside the longer."""
    aa, bb, ab = (np.einsum("nc,nc->n", x, y) for x, y in ((a, a), (b, b), (a, b)))
    a_longer = aa > bb
    length = np.sqrt(np.where(a_longer, aa, bb))  # of the longer one
    along = ab / length
    reach = ON_EDGE * length + slack
    between = (along > reach) & (length - along > reach)
    off = np.full(len(a), np.inf)
    off[between] = np.linalg.norm(np.cross(a[between], b[between]), axis=1) / length[between]
    return a_longer, off <= reach
