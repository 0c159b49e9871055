"""The sky in a given direction, and the sky cut into bins that act as distant patches.

Bins: the six faces of a cube, `BINS_PER_EDGE`² cells each, 11° wide or less. They are fixed in the world, so form
factors to them do not depend on the lighting.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .datatypes import F64, I32, Sky

PEAK = 4.0  # times the sky's mean luminance
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
    return _bilinear(sky.image, u, v)


def _bilinear(table: npt.NDArray[np.floating], u: F64, v: F64) -> F64:
    """table (H, W, C) at columns u, which repeat, and rows v: (N, C)."""
    height, width = table.shape[:2]
    u0, v0 = np.floor(u), np.floor(v)
    fu, fv = (u - u0)[:, None], (v - v0)[:, None]
    c0, c1 = (u0.astype(int) % width), ((u0.astype(int) + 1) % width)
    r0, r1 = np.clip(v0.astype(int), 0, height - 1), np.clip(v0.astype(int) + 1, 0, height - 1)
    top = table[r0, c0] * (1 - fu) + table[r0, c1] * fu
    bottom = table[r1, c0] * (1 - fu) + table[r1, c1] * fu
    return np.asarray(top * (1 - fv) + bottom * fv, dtype=np.float64)


def split_peaks(sky: Sky) -> tuple[Sky, Sky | None]:
    """The sky without what exceeds PEAK × its mean, and that excess by itself (None if there is none): a sun of few texels is
    too small for the bins' shadows, and is sampled by importance instead."""
    weight = _row_weights(sky)[:, None] / sky.image.shape[1]
    luminance = sky.image.mean(axis=2)
    limit = PEAK * float((weight * luminance).sum())
    above = luminance > limit  # nowhere in a black sky
    if not above.any():
        return sky, None
    share = np.where(above, limit / np.where(above, luminance, 1.0), 1.0)[..., None].astype(np.float32)
    smooth = sky.image * share
    return dataclasses.replace(sky, image=smooth), dataclasses.replace(sky, image=sky.image - smooth)


def _row_weights(sky: Sky) -> F64:
    """Share of the sphere that each row of texels stands for, (H,), sum 1. First and last row lie at the poles."""
    height = sky.image.shape[0]
    if height == 1:
        return np.ones(1)
    edges = np.clip((np.arange(height + 1) - 0.5) / (height - 1), 0.0, 1.0) * math.pi
    return np.asarray(np.diff(-np.cos(edges)) / 2.0)


def sample_sky(sky: Sky, xi: npt.NDArray[np.floating]) -> tuple[F64, F64]:
    """Directions (N, 3) towards the sky from uniform `xi` (N, 2), and their density (N,), sr⁻¹.

    Bilinear reading is a sum of one hat a texel. A texel is chosen by its power, then a point by its hat: the density follows
    the luminance itself, but for the sine within a row, so a sun is sampled almost without spread.
    """
    height, width = sky.image.shape[:2]
    mass = sky.image.mean(axis=2).astype(np.float64) * _row_weights(sky)[:, None]
    upto = np.cumsum(mass.ravel())
    target = xi[:, 0].astype(np.float64) * upto[-1]
    pick = np.minimum(np.searchsorted(upto, target, side="right"), len(upto) - 1)
    within = np.clip((target - (upto[pick] - mass.ravel()[pick])) / mass.ravel()[pick], 0.0, 1.0)
    u = pick % width + _hat(within)
    if height == 1:
        v, y = np.zeros(len(pick)), 1.0 - 2.0 * xi[:, 1].astype(np.float64)
        texel = np.full(len(pick), 2.0 * 2.0 * math.pi / width)
    else:
        v = np.abs(pick // width + _hat(xi[:, 1].astype(np.float64)))  # hats at the poles are folded
        v = np.minimum(v, 2.0 * (height - 1) - v)
        mass[[0, -1]] *= 2.0
        theta = v / (height - 1) * math.pi
        y = np.cos(theta)
        texel = np.maximum(np.sin(theta), np.finfo(np.float32).tiny) * math.pi / (height - 1) * 2.0 * math.pi / width
    density = _bilinear(mass[..., None], u, v)[:, 0] / upto[-1] / texel
    phi, r = (u + 0.5) / width * 2.0 * math.pi, np.sqrt(np.maximum(0.0, 1.0 - y * y))
    x, z = r * np.sin(phi), -r * np.cos(phi)
    a = math.radians(sky.rotation_deg)
    return np.stack([math.cos(a) * x + math.sin(a) * z, y, -math.sin(a) * x + math.cos(a) * z], axis=1), density


def _hat(xi: F64) -> F64:
    """Numbers within -1 … 1 with density 1 - |x| from uniform ones (N,). The ends are kept out: there a lone texel's light and
    density are both 0."""
    return (1.0 - 1e-6) * np.where(xi < 0.5, np.sqrt(2.0 * xi) - 1.0, 1.0 - np.sqrt(2.0 * np.maximum(1.0 - xi, 0.0)))


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


def device_bin(direction: Any) -> Any:
    """Bin number (mi.UInt32) of mi.Vector3f directions: `bin_of` inside a kernel."""
    import drjit as dr
    import mitsuba as mi

    size = dr.abs(direction)
    on_x = (size.x >= size.y) & (size.x >= size.z)
    on_y = ~on_x & (size.y >= size.z)
    axis = dr.select(on_x, mi.UInt32(0), dr.select(on_y, mi.UInt32(1), mi.UInt32(2)))
    major = dr.select(on_x, direction.x, dr.select(on_y, direction.y, direction.z))
    u = dr.select(on_x, direction.y, dr.select(on_y, direction.z, direction.x))
    v = dr.select(on_x, direction.z, dr.select(on_y, direction.x, direction.y))

    def cell(w: Any) -> Any:
        return mi.UInt32(dr.clip((w / dr.abs(major) * 0.5 + 0.5) * BINS_PER_EDGE, 0, BINS_PER_EDGE - 1))

    face = 2 * axis + dr.select(major < 0, mi.UInt32(1), mi.UInt32(0))
    return (face * BINS_PER_EDGE + cell(u)) * BINS_PER_EDGE + cell(v)


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
