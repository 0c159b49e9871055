"""Edges and winding of a mesh: what is wrong, counted and numbered without changing anything (failure-catalogue A10).

Faces are given by places: vertices at one position share a number (`checks.weld`), so texture seams are no faults.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..datatypes import F64, I64, Bool

SAME_AREA = 1e-6  # relative: two halves of a piece that differ by less weigh the same


@dataclass(frozen=True, eq=False)
class Edges:
    """Undirected edges of F triangles. A half-edge 3 f + k runs from corner k of face f to the next.

    ends (E, 2) i64 places. count (E,) i64 faces at the edge. half (3 F,) i64: half-edges sorted by edge, those of edge
    e from first[e] (E + 1,) i64. pairs (M, 2) i64: the half-edges of edges with exactly two faces; against (M,) bool:
    both run the same way, so one of the two faces is flipped.
    """

    ends: I64
    count: I64
    half: I64
    first: I64
    pairs: I64
    against: Bool

    @property
    def closed(self) -> bool:
        """Watertight with consistent winding. The sign of the volume does not matter: a room faces inwards.

        Watertight alone is not enough: with one flipped face every edge still has two faces.
        """
        return bool(np.all(self.count == 2)) and not self.against.any()

    @property
    def edge(self) -> I64:
        """(3 F,) the edge of each half-edge in `half`, ascending."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def faces_at(self, edges: Bool) -> I64:
        """Numbers of the faces at the edges for which `edges` (E,) is true, ascending."""
        return np.unique(self.half[np.repeat(edges, self.count)] // 3)


@dataclass(frozen=True, eq=False)
class Winding:
    """Faces that disagree with their neighbours, over pieces connected by edges of two faces.

    flipped (F,) bool: the fewer of their piece. undecided (F,): in a piece whose two halves weigh the same. twisted
    (F,): in a piece that no turning makes agree, like a Möbius strip. piece (F,) i64: the number of its piece.
    """

    flipped: Bool
    undecided: Bool
    twisted: Bool
    piece: I64


def edges_of(corners: I64) -> Edges:
    """Edges of faces (F, 3), F > 0, whose three places differ."""
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(high.max()) + 1) + high
    half = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], np.diff(key[half]) != 0]))
    count = np.diff(np.append(first, key.size))
    pairs = np.stack([half[first[count == 2]], half[first[count == 2] + 1]], axis=1)
    return Edges(
        ends=np.stack([low[half[first]], high[half[first]]], axis=1),
        count=count,
        half=half,
        first=np.append(first, key.size),
        pairs=pairs,
        against=np.asarray(start[pairs[:, 0]] == start[pairs[:, 1]], bool),
    )


def connected(pairs: I64, count: int) -> I64:
    """(count,) number of the connected piece of each node of a graph. pairs: (M, 2) nodes that are joined."""
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def winding_of(edges: Edges, areas: F64) -> Winding:
    """Which faces are flipped. areas: (F,) of the faces, m²; they decide where both sides have as many faces.

    Two neighbours agree if they run along their edge in opposite directions. Over a piece this is a two-colouring,
    found as connected pieces of two copies of every face: neighbours that disagree join unlike copies.
    """
    n = len(areas)
    if not edges.against.any():
        none = np.zeros(n, bool)
        return Winding(none, none, none, np.zeros(n, np.int64))
    a, b = edges.pairs.T // 3
    piece = connected(np.stack([a, b], axis=1), n)
    other = np.where(edges.against, n, 0)
    label = connected(np.stack([np.concatenate([a, a + n]), np.concatenate([b + other, b + n - other])], axis=1), 2 * n)
    seed = np.unique(piece, return_index=True)[1]
    colour = label[:n] != label[seed][piece]
    twisted = _any_of(piece, label[:n] == label[n:])
    quarrel = _any_of(piece, np.isin(np.arange(n), a[edges.against]))
    fewer, level = _lighter(piece, colour, areas)
    return Winding(
        flipped=(colour == fewer[piece]) & (quarrel & ~twisted & ~level)[piece],
        undecided=(quarrel & ~twisted & level)[piece],
        twisted=(quarrel & twisted)[piece],
        piece=piece,
    )


def _any_of(piece: I64, faces: Bool) -> Bool:
    """(pieces,) true where one of the piece's faces is."""
    return np.bincount(piece, faces) > 0


def _lighter(piece: I64, colour: Bool, areas: F64) -> tuple[Bool, Bool]:
    """(pieces,) the colour of fewer faces, of less area where they are as many; and whether that too is the same."""
    faces, ones = np.bincount(piece), np.bincount(piece, colour)
    area, of_ones = np.bincount(piece, areas), np.bincount(piece, areas * colour)
    tie = 2 * ones == faces
    fewer = np.where(tie, 2.0 * of_ones < area, 2 * ones < faces)
    return np.asarray(fewer, bool), np.asarray(tie & (np.abs(2.0 * of_ones - area) <= SAME_AREA * area), bool)


def sheet_of(corners: I64, points: F64, edges: Edges, chosen: I64) -> tuple[F64, I64, I64]:
    """Some of the faces as a mesh in which no edge has more than two faces, for programs that need that.

    A face at an edge of three or more is cut from its centre, with a vertex of its own in the middle of such an edge.
    chosen: (N,) numbers of the faces. Returns vertices (V, 3) m, triangles (T, 3), and the face (T,) of each.
    """
    crowded = np.zeros(corners.size, bool)  # by half-edge
    crowded[edges.half] = np.repeat(edges.count > 2, edges.count)
    cut = crowded.reshape(-1, 3)[chosen].any(axis=1)
    whole, parted = chosen[~cut], chosen[cut]
    half = (3 * parted[:, None] + np.arange(3)).ravel()
    centre = np.repeat(len(points) + np.arange(len(parted)), 3)
    start, end = corners.ravel()[half], np.roll(corners, -1, axis=1).ravel()[half]
    split = crowded[half]
    middle = len(points) + len(parted) + np.arange(int(split.sum()))
    vertices = np.concatenate(
        [points, points[corners[parted]].mean(axis=1), 0.5 * (points[start] + points[end])[split]]
    )
    triangles = [
        corners[whole],
        np.stack([centre, start, end], axis=1)[~split],
        np.stack([centre[split], start[split], middle], axis=1),
        np.stack([centre[split], middle, end[split]], axis=1),
    ]
    owner = np.concatenate([whole, half[~split] // 3, half[split] // 3, half[split] // 3])
    used, renumbered = np.unique(np.concatenate(triangles), return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3), owner
