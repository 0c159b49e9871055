"""The octahedral map of the sphere: directions as points of a square, and square maps that are read between their texels.

    p = d / (|x| + |y| + |z|);  (u, v) = (p_x, p_y) where z ≥ 0, else ((1 - |p_y|) sgn p_x, (1 - |p_x|) sgn p_y)

Cigolle et al. 2014, "A survey of efficient representations for independent unit vectors", section 3. Along each side of the square
the map is folded: texels beyond it are those of the same side, mirrored. A border one texel wide holds them, so that a map can be
read between texels without asking where it ends.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .datatypes import F32, F64, I64


def to_square(directions: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Points (N, 2) of -1 … 1 for directions (N, 3) of any length but 0, in the precision of these."""
    p = directions / ((np.abs(directions[:, 0]) + np.abs(directions[:, 1])) + np.abs(directions[:, 2]))[:, None]
    flat = p[:, :2]
    folded = (1 - np.abs(flat[:, ::-1])) * np.where(flat >= 0, flat.dtype.type(1), flat.dtype.type(-1))
    return np.asarray(np.where(p[:, 2:] >= 0, flat, folded))


def to_direction(points: npt.NDArray[np.floating]) -> F64:
    """Unit directions (N, 3) of points (N, 2) of -1 … 1."""
    p = np.asarray(points, dtype=np.float64)
    z = 1.0 - np.abs(p).sum(axis=1, keepdims=True)
    xy = np.where(z >= 0.0, p, (1.0 - np.abs(p[:, ::-1])) * np.where(p >= 0.0, 1.0, -1.0))
    d = np.concatenate([xy, z], axis=1)
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def texel_directions(texels: int) -> F64:
    """Unit directions (texels², 3) of the middles of a map's texels, u slowest."""
    middle = (np.arange(texels) + 0.5) * (2.0 / texels) - 1.0
    return to_direction(np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2))


def bordered_index(texels: int) -> I64:
    """Which texel (row by row in a map without border) each texel of a map with one holds: (texels + 2, texels + 2)."""
    along = np.arange(-1, texels + 1)
    u, v = np.meshgrid(along, along, indexing="ij")
    for _ in range(2):  # corners are folded twice
        out_u, out_v = (u < 0) | (u >= texels), (v < 0) | (v >= texels)
        u, v = (
            np.where(out_u, np.clip(u, 0, texels - 1), np.where(out_v, texels - 1 - u, u)),
            np.where(out_u, texels - 1 - v, np.where(out_v, np.clip(v, 0, texels - 1), v)),
        )
    return np.asarray(np.clip(u, 0, texels - 1) * texels + np.clip(v, 0, texels - 1), dtype=np.int64)


def read(maps: npt.NDArray[np.floating], number: I64, directions: F32) -> F32:
    """Values (N, C) f32 between the texels of bordered maps (M, S, S, C): of map `number` (N,) towards `directions` (N, 3) f32."""
    half = np.float32(0.5)
    inside = np.float32(maps.shape[1] - 2)
    at = (
        to_square(directions) * half + half
    ) * inside + half  # in texels of the bordered map, from the middle of its first
    first = at.astype(np.int32)
    f = (at - first.astype(np.float32)).astype(np.float32)
    i, j = first[:, 0], first[:, 1]
    g = np.float32(1.0) - f

    def texel(a: int, b: int) -> F32:
        return maps[number, i + a, j + b].astype(np.float32)

    low = texel(0, 0) * g[:, 1:] + texel(0, 1) * f[:, 1:]
    high = texel(1, 0) * g[:, 1:] + texel(1, 1) * f[:, 1:]
    return np.asarray(low * g[:, :1] + high * f[:, :1])
