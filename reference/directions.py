"""Point sets: scrambled Sobol tables shared by all receivers, each receiver rotated by its own offset, and Fibonacci
directions on the sphere. Everything is a function of (count, dimension, seed)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from .datatypes import F32, F64


def sobol(count: int, dimension: int, seed: int) -> F32:
    """First `count` points of a scrambled Sobol sequence, (count, dimension) f32 in [0, 1)."""
    table = qmc.Sobol(dimension, scramble=True, rng=seed).random_base2(max(0, math.ceil(math.log2(count))))[:count]
    return np.minimum(table, np.float64(1.0 - 2.0**-24)).astype(np.float32)


def rotations(receivers: int, dimension: int, seed: int) -> F32:
    """Offsets for Cranley-Patterson rotation, (receivers, dimension) f32 in [0, 1)."""
    return np.random.default_rng([seed, 7]).random((receivers, dimension), dtype=np.float32)


def rotate(table: F32, offset: F32) -> F32:
    """(table + offset) mod 1, kept below 1 in float32; shapes broadcast."""
    moved = table + offset
    return np.minimum(moved - np.floor(moved), np.float32(1.0 - 2.0**-24))


def cosine_hemisphere(uv: npt.NDArray[np.floating]) -> F64:
    """Directions (..., 3) about +z with density cosθ/π from uniform `uv` (..., 2) (Malley's method)."""
    r = np.sqrt(uv[..., 0], dtype=np.float64)
    phi = 2.0 * math.pi * uv[..., 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(np.maximum(0.0, 1.0 - r * r))], axis=-1)


def sphere(uv: npt.NDArray[np.floating]) -> F64:
    """Directions (..., 3) uniform on the sphere from uniform `uv` (..., 2)."""
    z = 1.0 - 2.0 * uv[..., 0].astype(np.float64)
    r = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    phi = 2.0 * math.pi * uv[..., 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def fibonacci_sphere(count: int) -> F64:
    """`count` nearly uniform directions (count, 3): spherical Fibonacci lattice (Keinert et al. 2015, eq. 1)."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    phi = math.pi * (3.0 - math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def random_rotations(count: int, seed: int) -> F64:
    """`count` uniform rotation matrices (count, 3, 3) from random unit quaternions."""
    q = np.random.default_rng([seed, 11]).normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def frames(normals: npt.NDArray[np.floating]) -> tuple[F64, F64]:
    """Tangent and bitangent (N, 3) of unit `normals` (N, 3) (Duff et al. 2017, "Building an orthonormal basis")."""
    n = np.asarray(normals, dtype=np.float64)
    sign = np.where(n[:, 2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + n[:, 2])
    b = n[:, 0] * n[:, 1] * a
    tangent = np.stack([1.0 + sign * n[:, 0] ** 2 * a, sign * b, -sign * n[:, 0]], axis=1)
    bitangent = np.stack([b, sign + n[:, 1] ** 2 * a, -n[:, 1]], axis=1)
    return tangent, bitangent
