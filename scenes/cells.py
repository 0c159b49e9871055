"""Buildings as the boundary of solid cells on an uneven grid.

Each face between a solid cell and an empty one becomes one quadrilateral over shared grid vertices. So the surface is
closed, its winding consistent, and it has no T-junction, no face inside a wall and no two faces in one place, whatever
the floor plan. `bend` moves grid vertices (a roof slope) without breaking any of that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from shapes import Point, Shape, join, polygons

Labels = npt.NDArray[np.int64]
Box = tuple[Point, Point]
# Outward quadrilateral of a unit cell towards each neighbour: step, then four corners counter-clockwise from outside.
_SIDES = (
    ((1, 0, 0), ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1))),
    ((-1, 0, 0), ((0, 0, 1), (0, 1, 1), (0, 1, 0), (0, 0, 0))),
    ((0, 1, 0), ((0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0))),
    ((0, -1, 0), ((0, 0, 1), (0, 0, 0), (1, 0, 0), (1, 0, 1))),
    ((0, 0, 1), ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))),
    ((0, 0, -1), ((0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0))),
)


class Cells:
    """Grid of labelled cells: 0 is empty, anything else solid and the name of a material.

    xs, ys, zs: grid lines, m, ascending. labels: (nx, ny, nz) i64.
    """

    def __init__(self, xs: Sequence[float], ys: Sequence[float], zs: Sequence[float]) -> None:
        self.lines = (sorted(set(xs)), sorted(set(ys)), sorted(set(zs)))
        self.labels: Labels = np.zeros([len(a) - 1 for a in self.lines], dtype=np.int64)

    def fill(self, label: int, box: Box) -> None:
        """Give the cells of `box` (two corners on grid lines) this label."""
        low, high = box
        spans = [slice(a.index(p), a.index(q)) for a, p, q in zip(self.lines, low, high, strict=True)]
        self.labels[tuple(spans)] = label

    def surface(
        self,
        name: Callable[[int, int, Point], str | None],
        bend: Callable[[Point], Point] = lambda p: p,
    ) -> dict[str, Shape]:
        """The boundary, as one shape per name.

        name: of a face, from the label of its solid cell, the side it faces as an index into (+x, -x, +y, -y, +z, -z),
          and its middle before it is bent; None leaves the face out.
        bend: moves grid vertices; must keep each quadrilateral flat.
        """
        padded = np.pad(self.labels, 1)
        faces: dict[str, list[Shape]] = {}
        for cell in np.argwhere(self.labels > 0):
            for side, (step, corners) in enumerate(_SIDES):
                if padded[tuple(cell + 1 + np.array(step))]:
                    continue
                points = [self._point(cell + np.array(c)) for c in corners]
                centre = np.mean(points, axis=0)
                which = name(int(self.labels[tuple(cell)]), side, (centre[0], centre[1], centre[2]))
                if which is not None:
                    faces.setdefault(which, []).append(polygons([bend(p) for p in points], (0, 1, 2, 3)))
        return {key: join(parts) for key, parts in faces.items()}

    def _point(self, index: Labels) -> Point:
        """Grid vertex at `index` (3,)."""
        x, y, z = (a[int(i)] for a, i in zip(self.lines, index, strict=True))
        return (x, y, z)
