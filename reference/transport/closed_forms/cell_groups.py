"""Pairs of cells judged by groups of coplanar neighbours: what holds for two groups' outlines holds for all of their cells.

Groups of two sizes, one inside the other: the smaller are only asked where the larger give no answer.
"""

from __future__ import annotations

import numpy as np

from ...datatypes import F64, I64, U32, Bool
from .planar_cells import FLAT
from .polygon_clip import unit_normals
from .shaft import Blockers, classify
from .shaft_walk import BLOCKED, MIXED

GROUPS = (4.0, 2.0)  # cells of typical size to the edge of a group; halves, so that small groups lie within large ones
ROWS = 256  # of groups whose heights over the others' planes are in memory at once


def group_codes(blockers: Blockers, corners: F64, normals: F64, scale: float) -> tuple[I64, U32]:
    """Group (E,) of each of the cells (E, 4, 3) m with normals (E, 3), and code (G, G) of every pair of groups: CLEAR or
    BLOCKED where that is proved, BLOCKED too where one group lies in or behind the other's plane, else MIXED.

    scale: extent of the scene, m, against which planes are told apart.
    """
    group, outlines = _groups(corners, normals, scale, GROUPS[0])
    codes = _codes(blockers, outlines, np.full((len(outlines),) * 2, MIXED, dtype=np.uint32), BLOCKED)
    for size in GROUPS[1:]:
        finer, outlines = _groups(corners, normals, scale, size)
        if 2 * len(outlines) > len(finer):
            break  # hardly any group holds two cells: those are judged one by one anyway
        within = np.empty(len(outlines), dtype=np.int64)
        within[finer] = group
        # Few small groups are hidden whole where the large ones are not: their pairs are judged, and counted, one by one.
        codes = _codes(blockers, outlines, codes[within[:, None], within], MIXED)
        group = finer
    return group, codes


def _groups(corners: F64, normals: F64, scale: float, size: float) -> tuple[I64, F64]:
    """Group (E,) of each cell, coplanar and near together, and the groups' outlines (G, 4, 3), rectangles in their planes."""
    middle = corners.mean(axis=(0, 1))  # taken off: far from the origin planes would lose their digits
    corners = corners - middle
    centre = corners.mean(axis=1)
    height = np.einsum("ec,ec->e", normals, centre)
    edge = size * float(np.median(np.linalg.norm(np.ptp(corners, axis=1), axis=1)))
    plane = np.column_stack([np.round(normals * 1e9), np.round(height / scale * 1e9)])
    key = np.column_stack([plane, np.floor((centre - centre.min(axis=0)) / edge)])
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    first = np.unique(group, return_index=True)[1]
    along = corners[first, 1] - corners[first, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = normals[first]
    across = np.cross(normal, along)
    local = np.stack([np.einsum("ekc,ec->ek", corners, axis[group]) for axis in (along, across)], axis=2)
    n = len(first)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(low, group, local.min(axis=1))
    np.maximum.at(high, group, local.max(axis=1))
    base = middle + normal * height[first][:, None]
    ring = [(low, low), (high, low), (high, high), (low, high)]
    return group, np.stack([base + along * u[:, :1] + across * v[:, 1:] for u, v in ring], axis=1)


def _codes(blockers: Blockers, outlines: F64, before: U32, most: int) -> U32:
    """Codes (G, G) of groups. before: what is known of them, symmetric; only MIXED is asked again. most: no answer above this."""
    n = len(outlines)
    codes = np.where(_facing(outlines - blockers.centre, FLAT * blockers.diagonal), before, np.uint32(BLOCKED))
    i, j = np.nonzero(np.triu(codes == MIXED, 1))
    codes[np.arange(n), np.arange(n)] = BLOCKED
    found = classify(blockers, outlines, np.full(n, 4), np.stack([i, j], axis=1), stop_early=most == MIXED)
    codes[i, j] = codes[j, i] = np.minimum(found, np.uint32(most))
    return codes


def _facing(outlines: F64, tolerance: float) -> Bool:
    """(G, G) whether both groups have something in front of the other's plane."""
    normals = unit_normals(outlines)
    own = np.einsum("gc,gc->g", normals, outlines[:, 0]) + tolerance
    front = np.empty((len(outlines),) * 2, dtype=np.bool_)
    for begin in range(0, len(outlines), ROWS):
        rows = slice(begin, begin + ROWS)
        front[rows] = np.einsum("gc,hkc->ghk", normals[rows], outlines).max(axis=2) > own[rows, None]
    return np.asarray(front & front.T)
