"""Small triangle shapes for the bundled scenes, and the PLY bytes they are stored as.

Everything is deterministic: plain arithmetic, `math` functions rounded to a micrometre before they are written, and
`random.Random`, whose stream Python guarantees. Faces are counter-clockwise seen from the front. Metres, y up.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Point = tuple[float, float, float]
_HEADER = """ply
format binary_little_endian 1.0
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles. vertices: (V, 3) f64 m; faces: (F, 3) i64."""

    vertices: Array
    faces: Ints

    def flipped(self) -> Shape:
        """The same surface seen from the other side."""
        return Shape(self.vertices, self.faces[:, ::-1])

    def moved(self, offset: Point, yaw: float = 0.0) -> Shape:
        """Turned by `yaw` radians about +y, then shifted."""
        c, s = math.cos(yaw), math.sin(yaw)
        x, y, z = self.vertices.T
        return Shape(np.stack([c * x + s * z, y, c * z - s * x], axis=1) + np.array(offset), self.faces)

    def only(self, keep: npt.NDArray[np.bool_]) -> Shape:
        """The faces for which `keep` (F,) is true, with the vertices they use."""
        used, faces = np.unique(self.faces[keep], return_inverse=True)
        return Shape(self.vertices[used], faces.reshape(-1, 3))


def join(shapes: Iterable[Shape]) -> Shape:
    """All shapes in one; vertices of one place become one vertex."""
    parts = list(shapes)
    starts = np.cumsum([0] + [len(p.vertices) for p in parts])
    vertices = np.round(np.concatenate([p.vertices for p in parts]), 6) + 0.0
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=False)])
    places, first, index = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")  # keep the order in which vertices first appear: the files stay readable
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Shape(places[order], rank[index.reshape(-1)][faces])


def ply(shape: Shape) -> bytes:
    """Binary little-endian PLY: float32 vertices, uint8 count and int32 indices per face."""
    rows = np.empty(len(shape.faces), dtype=[("n", "u1"), ("i", "<i4", (3,))])
    rows["n"], rows["i"] = 3, shape.faces
    header = _HEADER.format(vertices=len(shape.vertices), faces=len(shape.faces))
    return header.encode("ascii") + (np.round(shape.vertices, 6) + 0.0).astype("<f4").tobytes() + rows.tobytes()


def polygons(points: Sequence[Point], *loops: Sequence[int]) -> Shape:
    """Convex polygons, each a loop of indices into `points`, cut into fans."""
    fans = [(loop[0], loop[k], loop[k + 1]) for loop in loops for k in range(1, len(loop) - 1)]
    return Shape(np.array(points, dtype=np.float64), np.array(fans, dtype=np.int64))


def quad(a: Point, b: Point, c: Point, d: Point) -> Shape:
    """Two triangles a-b-c and a-c-d."""
    return polygons((a, b, c, d), (0, 1, 2, 3))


def lathe(profile: Sequence[tuple[float, float]], sides: int, phase: float = 0.0) -> Shape:
    """Surface of revolution about +y through (radius, y) pairs from bottom to top; radius 0 closes an end.

    >>> lathe([(0, 0), (1, 0), (0, 2)], 5).faces.shape  # a closed five-sided cone
    (10, 3)
    """
    angles = [phase + 2.0 * math.pi * k / sides for k in range(sides)]
    rings = [[(r * math.sin(a), y, r * math.cos(a)) for a in angles] for r, y in profile]
    faces: list[Shape] = []
    for (r0, _), (r1, _), low, high in zip(profile, profile[1:], rings, rings[1:], strict=False):
        for k in range(sides):
            a, b, c, d = low[k], low[(k + 1) % sides], high[(k + 1) % sides], high[k]
            if r0 == 0:
                faces.append(polygons((a, c, d), (0, 1, 2)))
            else:
                faces.append(quad(a, b, c, d) if r1 else polygons((a, b, c), (0, 1, 2)))
    return join(faces)


def icosphere(levels: int) -> Shape:
    """Unit icosphere with a vertex at +y: 20 · 4^levels faces; for levels ≥ 1 no face crosses the plane y = 0."""
    t = 2.0 * math.pi / 5.0
    y, r = 1.0 / math.sqrt(5.0), 2.0 / math.sqrt(5.0)
    ring = [(r * math.sin(k * t), y, r * math.cos(k * t)) for k in range(5)]
    low = [(-x, -h, -z) for x, h, z in ring]  # the antipodes, so that the halves are congruent to the last bit
    points: list[Point] = [(0.0, 1.0, 0.0), *ring, *low, (0.0, -1.0, 0.0)]
    faces: list[tuple[int, int, int]] = []
    for k in range(5):
        n, below, beside = (k + 1) % 5, 6 + (k + 3) % 5, 6 + (k + 2) % 5
        faces += [(0, 1 + k, 1 + n), (1 + k, below, 1 + n), (1 + k, beside, below), (11, below, beside)]
    for _ in range(levels):
        points, faces = _subdivide(points, faces)
    return Shape(np.array(points), np.array(faces, dtype=np.int64))


def _subdivide(
    points: list[Point], faces: list[tuple[int, int, int]]
) -> tuple[list[Point], list[tuple[int, int, int]]]:
    """Each face into four; new vertices go onto the unit sphere."""
    points, made, out = list(points), {}, []

    def middle(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in made:
            x, y, z = (p + q for p, q in zip(points[a], points[b], strict=True))
            length = math.sqrt(x * x + y * y + z * z)
            points.append((x / length, y / length, z / length))
            made[key] = len(points) - 1
        return made[key]

    for a, b, c in faces:
        ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
        out += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return points, out


def lump(rng: random.Random, radius: float, levels: int = 0, rough: float = 0.25) -> Shape:
    """A closed lump inside a sphere of `radius`: an icosphere whose vertices are pulled in by up to `rough`."""
    ball = icosphere(levels).moved((0.0, 0.0, 0.0), yaw=rng.random() * 6.0)
    pull = np.array([1.0 - rough * rng.random() for _ in ball.vertices])
    return Shape(ball.vertices * pull[:, None] * radius, ball.faces)


def heightfield(xs: Sequence[float], zs: Sequence[float], height: Callable[[float, float], float]) -> Shape:
    """One-sided sheet facing up over the grid lines `xs` × `zs`."""
    points = np.array([(x, height(x, z), z) for x in xs for z in zs])
    i, k = (a.reshape(-1) for a in np.meshgrid(np.arange(len(xs) - 1), np.arange(len(zs) - 1), indexing="ij"))
    a = i * len(zs) + k
    b = a + len(zs)
    flip = (i + k) % 2 == 1  # alternate the diagonal, so that hills have no grain
    first = np.where(flip[:, None], np.stack([a, a + 1, b], 1), np.stack([a, a + 1, b + 1], 1))
    second = np.where(flip[:, None], np.stack([a + 1, b + 1, b], 1), np.stack([a, b + 1, b], 1))
    return Shape(points, np.stack([first, second], axis=1).reshape(-1, 3))


def smoothstep(low: float, high: float, x: float) -> float:
    """0 below `low`, 1 above `high`, smooth between."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
