"""Cutting triangles into k² equal elements, and finding the element under a point.

Row j of a triangle cut k times holds 2(k - j) - 1 elements, upright ones at even, upside-down ones at odd places; rows
before it hold j(2k - j). `first` (T + 1,) is the running total of k² over triangles.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I32, I64
from ..visibility import Geometry

MAX_CUTS = 512
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
TIE = 1e-9  # an edge of just so many sizes, to within rounding, is cut so often at any scale


def cuts_for(g: Geometry, size: F64) -> I32:
    """Cuts per edge (T,) that leave no edge of an element longer than `size` (T,) m, as far as MAX_CUTS allows."""
    corners = g.vertices[g.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return np.clip(np.ceil(longest / size * (1.0 - TIE)), 1, MAX_CUTS).astype(np.int32)


def element_of(
    cuts: I32, first: I64, triangle: npt.NDArray[np.integer], u: npt.NDArray[np.floating], v: npt.NDArray[np.floating]
) -> I64:
    """Element (N,) under the point with barycentric weights u, v (N,) of second and third vertex of `triangle` (N,)."""
    k = cuts[triangle].astype(np.int64)
    j = np.clip(np.floor(v * k).astype(np.int64), 0, k - 1)
    i = np.clip(np.floor(u * k).astype(np.int64), 0, k - 1 - j)
    upper = ((u * k - i) + (v * k - j) > 1.0) & (i + j < k - 1)
    return np.asarray(first[triangle] + j * (2 * k - j) + 2 * i + upper)


def _cell(k: F64, local: I64) -> tuple[F64, F64, F64]:
    """Column, row and upside-down flag (N,) of element number `local` within a triangle cut `k` times."""
    j = np.floor(k - np.sqrt(np.maximum(k * k - local, 0.0)))
    j = np.where(j * (2 * k - j) > local, j - 1, j)  # the root may be rounded either way
    j = np.where((j + 1) * (2 * k - j - 1) <= local, j + 1, j)
    rest = local - j * (2 * k - j)
    return np.floor(rest / 2), j, rest % 2


def points_in_elements(cuts: I32, first: I64, triangle: I32, element: I64, xy: npt.NDArray[np.floating]) -> F64:
    """Barycentric weights (N, 2) of the points `xy` (N, 2) in elements; uniform xy in the square gives uniform points."""
    fold = xy.sum(axis=1, keepdims=True) > 1.0
    inside = np.where(fold, 1.0 - xy, xy)
    k = cuts[triangle].astype(np.float64)
    i, j, upper = _cell(k, element - first[triangle])
    shift = np.where((upper == 1)[:, None], 1.0 - inside, inside)
    return np.asarray((np.stack([i, j], axis=1) + shift) / k[:, None])


def corners_of_elements(cuts: I32, first: I64, triangle: I32, element: I64) -> F64:
    """Barycentric weights (N, 3, 2) of the corners of elements (N,), as `points_in_elements` gives them one by one."""
    k = cuts[triangle].astype(np.float64)
    i, j, upper = _cell(k, element - first[triangle])
    corners = np.where((upper == 1)[:, None, None], 1.0 - CORNERS, CORNERS)
    return np.asarray((np.stack([i, j], axis=1)[:, None] + corners) / k[:, None, None])
