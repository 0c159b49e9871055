"""The sky in a given direction, and the sky cut into bins that act as distant patches.

Bins: the six faces of a cube, `BINS_PER_EDGE`² cells each, 11° wide or less. They are fixed in the world, so form
factors to them do not depend on the lighting.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .datatypes import F64, I32, Sky

BINS_PER_EDGE = 8
SKY_BINS = 6 * BINS_PER_EDGE**2
MIN_COLUMNS = 512  # of the grid that integrates a bin


def sky_radiance(sky: Sky, directions: npt.NDArray[np.floating]) -> F64:
    """Bilinear radiance (N, 3), W·m⁻²·sr⁻¹, seen looking along unit `directions` (N, 3).

    Same orientation as Mitsuba's `envmap`: u = atan2(x, -z)/2π, v = acos(y)/π, after undoing `rotation_deg` about y.
    """
    d = np.asarray(directions, dtype=np.float64)
    a = math.radians(sky.rotation_deg)
    x = math.cos(a) * d[:, 0] - math.sin(a) * d[:, 2]
    z = math.sin(a) * d[:, 0] + math.cos(a) * d[:, 2]
    height, width = sky.image.shape[:2]
    u = np.arctan2(x, -z) / (2.0 * math.pi) * width - 0.5
    v = np.arccos(np.clip(d[:, 1], -1.0, 1.0)) / math.pi * (height - 1)  # first and last row lie at the poles
    u0, v0 = np.floor(u), np.floor(v)
    fu, fv = (u - u0)[:, None], (v - v0)[:, None]
    c0, c1 = (u0.astype(int) % width), ((u0.astype(int) + 1) % width)
    r0, r1 = np.clip(v0.astype(int), 0, height - 1), np.clip(v0.astype(int) + 1, 0, height - 1)
    i = sky.image
    top = i[r0, c0] * (1 - fu) + i[r0, c1] * fu
    bottom = i[r1, c0] * (1 - fu) + i[r1, c1] * fu
    return np.asarray(top * (1 - fv) + bottom * fv, dtype=np.float64)


def bin_of(directions: npt.NDArray[np.floating]) -> I32:
    """Bin number (N,) i32 of `directions` (N, 3), any length but zero."""
    d = np.asarray(directions, dtype=np.float32)
    axis = np.argmax(np.abs(d), axis=1)
    rows = np.arange(len(d))
    major = d[rows, axis]
    uv = np.stack([d[rows, (axis + 1) % 3], d[rows, (axis + 2) % 3]], axis=1) / np.abs(major)[:, None]
    cell = np.clip(((uv * 0.5 + 0.5) * BINS_PER_EDGE).astype(np.int32), 0, BINS_PER_EDGE - 1)
    face = 2 * axis + (major < 0)
    return np.asarray((face * BINS_PER_EDGE + cell[:, 0]) * BINS_PER_EDGE + cell[:, 1], dtype=np.int32)


def bin_radiance(sky: Sky | None) -> F64:
    """Mean radiance (SKY_BINS, 3) of each bin, zero without a sky.

    Midpoint rule on a grid of two or more points per texel and axis, weighted with the solid angle: so even a sun of one
    texel keeps its power, wherever the bins' borders fall.
    """
    if sky is None:
        return np.zeros((SKY_BINS, 3))
    height, width = sky.image.shape[:2]
    fine = max(2, -(-MIN_COLUMNS // width))
    phi = (np.arange(width * fine) + 0.5) / (width * fine) * 2.0 * math.pi
    rows = max(height - 1, 1) * max(2, -(-MIN_COLUMNS // (2 * height)))
    theta = (np.arange(rows) + 0.5) / rows * math.pi
    total, weight = np.zeros((SKY_BINS, 3)), np.zeros(SKY_BINS)
    for part in np.array_split(theta, max(1, rows * len(phi) >> 20)):
        sine = np.repeat(np.sin(part), len(phi))
        p = np.tile(phi, len(part))
        d = np.stack([sine * np.sin(p), np.repeat(np.cos(part), len(phi)), -sine * np.cos(p)], axis=1)
        bins, radiance = bin_of(d), sky_radiance(sky, d)
        weight += np.bincount(bins, sine, SKY_BINS)
        total += np.stack([np.bincount(bins, sine * radiance[:, c], SKY_BINS) for c in range(3)], axis=1)
    return total / weight[:, None]
