"""A turned scene: the matrix of `scene.rotation`, and boxes of the scene file, which are oriented boxes once it turns.

    M = Rz Ry Rx,   p' = M p

about the world's origin, angles counter-clockwise seen from the tip of the axis. Meshes, lights and cameras are turned
where the scene is loaded; boxes (volumes, limits, dark boxes) cannot be, since their settings are axis-aligned, so who
uses one asks here for the box in the world. The probe lattice is not turned.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .config_base import Vec3
from .config_placement import BoxSettings
from .datatypes import F64, Bool

HAIR = 1e-9  # of the cube's half edge: boxes that only touch count as overlapping
SIGNS = np.array(list(itertools.product((0, 1), repeat=3)), dtype=np.float64)


def _cos_sin(degrees: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of a right angle: 360 degrees change no bit."""
    rest = math.fmod(degrees, 360.0)
    exact = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}
    found = exact.get(rest % 360.0)
    return found or (math.cos(math.radians(rest)), math.sin(math.radians(rest)))


def rotation_matrix(rotation: float | Vec3) -> F64:
    """(3, 3) matrix of degrees about y, or about x, then y, then z."""
    x, y, z = (0.0, rotation, 0.0) if isinstance(rotation, int | float) else rotation
    (cx, sx), (cy, sy), (cz, sz) = _cos_sin(x), _cos_sin(y), _cos_sin(z)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def turns(matrix: F64) -> bool:
    """Whether the (3, 3) matrix changes anything."""
    return not np.array_equal(matrix, np.eye(3))


def turned(points: npt.NDArray[np.floating], matrix: F64) -> F64:
    """Points or directions (..., 3) turned by `matrix` (3, 3).

    Column by column instead of as a matrix product: equal points stay equal to the bit whatever their place in the array, and
    meshes that share corners go on sharing them.
    """
    p = np.asarray(points, dtype=np.float64)
    if not turns(matrix):
        return p
    return np.stack([row[0] * p[..., 0] + row[1] * p[..., 1] + row[2] * p[..., 2] for row in matrix], axis=-1)


@dataclass(frozen=True, eq=False)
class TurnedBox:
    """A box of the scene file in the world. lower, upper: (3,) m, before turning; matrix: (3, 3), turns it."""

    lower: F64
    upper: F64
    matrix: F64

    @property
    def turns(self) -> bool:
        """Whether its sides are not those of the settings."""
        return turns(self.matrix)

    @property
    def corners(self) -> F64:
        """Its eight corners in the world, (8, 3) m."""
        return turned(self.lower + SIGNS * (self.upper - self.lower), self.matrix)

    @property
    def bounds(self) -> tuple[F64, F64]:
        """Smallest and largest corner (3,), (3,) m of the axis-aligned box around it; itself if it is not turned."""
        corners = self.corners if self.turns else np.stack([self.lower, self.upper])
        return corners.min(axis=0), corners.max(axis=0)

    def inside(self, points: npt.NDArray[np.floating]) -> Bool:
        """Whether points (N, 3) m of the world lie in the (closed) box: (N,)."""
        p = turned(points, self.matrix.T)
        return np.asarray(((p >= self.lower) & (p <= self.upper)).all(axis=1))

    def world(self, share: npt.NDArray[np.floating]) -> F64:
        """World positions (N, 3) m of places `share` (N, 3) in 0..1 along its sides."""
        return turned(self.lower + (self.upper - self.lower) * share, self.matrix)

    def touches_cubes(self, centres: npt.NDArray[np.floating], half: float) -> Bool:
        """Whether axis-aligned cubes around `centres` (N, 3) m, of half edge `half`, m, overlap or touch it: (N,), exact.

        Separating axes of two boxes: 3 + 3 normals and 9 cross products of edges (Gottschalk, Lin and Manocha 1996).
        """
        axes = self.matrix.T  # rows: the box's own axes in the world
        own_half = 0.5 * (self.upper - self.lower)
        middle = turned(0.5 * (self.lower + self.upper), self.matrix)
        offset = np.asarray(centres, dtype=np.float64) - middle
        crossed = [np.cross(a, b) for a in np.eye(3) for b in axes]
        touch = np.ones(len(offset), dtype=np.bool_)
        for axis in (*np.eye(3), *axes, *crossed):
            reach = own_half @ np.abs(axes @ axis) + half * np.abs(axis).sum()
            touch &= np.abs(offset @ axis) <= reach + HAIR * half
        return touch


def turned_boxes(boxes: Iterable[BoxSettings], rotation: float | Vec3) -> list[TurnedBox]:
    """Boxes of the settings where `scene.rotation` puts them."""
    matrix = rotation_matrix(rotation)
    return [TurnedBox(np.asarray(b.min, np.float64), np.asarray(b.max, np.float64), matrix) for b in boxes]
