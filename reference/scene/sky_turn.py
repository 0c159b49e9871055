"""Rotation of latitude-longitude skies.

Mitsuba's default orientation: direction (sin φ sin θ, cos θ, −cos φ sin θ) with φ = 2π u, θ = π v.
"""

from __future__ import annotations

import math

import numpy as np

from ..datatypes import F32, F64


def rotation_about_y(matrix: F64) -> float | None:
    """Degrees by which the (3, 3) matrix turns about +y, or None if it does anything else."""
    angle = math.atan2(matrix[0, 2], matrix[0, 0])
    c, s = math.cos(angle), math.sin(angle)
    pure = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return math.degrees(angle) if np.allclose(matrix, pure, atol=1e-4) else None


def directions(height: int, width: int) -> F64:
    """(H, W, 3) unit vectors of the texel centres."""
    theta = np.pi * (np.arange(height)[:, None] + 0.5) / height
    phi = 2 * np.pi * (np.arange(width)[None, :] + 0.5) / width
    y = np.broadcast_to(np.cos(theta), (height, width))
    return np.stack([np.sin(phi) * np.sin(theta), y, -np.cos(phi) * np.sin(theta)], axis=2)


def turned(image: F32, rotation: F64) -> F32:
    """The sky (H, W, 3) rotated by the (3, 3) matrix, sampled bilinearly at texel centres."""
    height, width = image.shape[:2]
    source = directions(height, width) @ rotation  # R⁻¹ d, row vectors
    u = np.arctan2(source[..., 0], -source[..., 2]) / (2 * np.pi) % 1.0
    v = np.arccos(np.clip(source[..., 1], -1.0, 1.0)) / np.pi
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    x1, y1 = (x0 + 1) % width, np.minimum(y0 + 1, height - 1)
    x0 = x0 % width
    upper = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    lower = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return (upper * (1 - fy) + lower * fy).astype(np.float32)
