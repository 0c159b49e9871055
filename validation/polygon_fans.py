"""Polygons that are not convex, back from the fans of triangles that readers make of them.

A fan about a corner that does not see the whole polygon folds over: some of its triangles lie outside, turned the other
way. Contour integrals forgive that, rays do not. Such fans are found and cut into ears instead (Meisters 1975,
"Polygons have ears").
"""

from __future__ import annotations

import numpy as np

from ..reference.datatypes import F64, I32

FLAT = 1e-7  # share of its extent by which a polygon may leave its plane
FOLDED = -1e-9  # share of the fan's area that a turned triangle must have


def unfolded(vertices: F64, faces: I32) -> tuple[I32, int]:
    """Faces (F, 3) with folded fans cut anew, and how many polygons that were."""
    run = np.concatenate([[0], np.cumsum((faces[1:, 0] != faces[:-1, 0]) | (faces[1:, 1] != faces[:-1, 2]))])
    p = vertices[faces]
    areas = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    total = np.zeros((int(run[-1]) + 1, 3))
    np.add.at(total, run, areas)
    squares = np.einsum("fk,fk->f", total, total)[run]
    suspects = np.unique(run[np.einsum("fk,fk->f", areas, total[run]) < FOLDED * squares])
    out, mended = faces.copy(), 0
    for number in suspects:
        own = np.flatnonzero(run == number)
        ring = np.concatenate([faces[own[0]], faces[own[1:], 2]])
        cut = _ears(vertices, ring, total[number])
        if cut is not None:
            out[own], mended = cut, mended + 1
    return out, mended


def _ears(vertices: F64, ring: I32, area: F64) -> I32 | None:
    """Triangles of the simple polygon `ring`, or None if it is no such polygon."""
    if len(np.unique(ring)) < len(ring):
        return None
    points = vertices[ring] - vertices[ring[0]]
    normal = area / np.linalg.norm(area)
    if np.abs(points @ normal).max() > FLAT * np.abs(points).max():
        return None
    along = points[1] / np.linalg.norm(points[1])
    xy = np.stack([points @ along, points @ np.cross(normal, along)], axis=1)
    left, triangles = list(range(len(ring))), []
    while len(left) > 3:
        ear = next((k for k in range(len(left)) if _is_ear(xy, left, k)), None)
        if ear is None:
            return None
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return ring[np.array([*triangles, left], dtype=np.int64)]


def _is_ear(xy: F64, left: list[int], k: int) -> bool:
    """Whether the corner is convex and its triangle holds none of the other corners."""
    a, b, c = (xy[left[m % len(left)]] for m in (k - 1, k, k + 1))
    if _turn(a, b, c[None])[0] <= 0.0:
        return False
    others = xy[np.array([n for m, n in enumerate(left) if m not in ((k - 1) % len(left), k, (k + 1) % len(left))])]
    inside = (_turn(a, b, others) >= 0.0) & (_turn(b, c, others) >= 0.0) & (_turn(c, a, others) >= 0.0)
    return not bool(inside.any())


def _turn(a: F64, b: F64, points: F64) -> F64:
    """Twice the signed area (N,) of a, b and each point."""
    return np.asarray((b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0]))
