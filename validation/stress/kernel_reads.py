"""The OpenCL kernel beside the plain sampler, for cases whose failure both would have (D1 … D5, C1, C7).

A case reads the plain sampler, which is the kernel's specification; the curve `kernel` says how far the kernel is off it at the same
places of the same texture, so that what holds for the one holds for the other. Places lie a hair to both sides of borders, where the
wrong tile, level or weight would show. Without an OpenCL device the curve is absent and the case is judged by the plain sampler alone.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...fastpath.device import OpenDevice
from ...fastpath.layout import Layout
from ...fastpath.sampler import Sampler
from ...reference.config_base import Reconstruction
from ...reference.datatypes import F32, F64
from ...reference.errors import EnvironmentLacks
from ...reference.sh import COSINE_A0, Y0
from ...reference.texture_types import Samples, Storage, VirtualTexture
from ...reference.volume.sampler import sample
from .case import Reading
from .kernel_curve import KERNEL
from .texture_worlds import device, units

HAIR = 1e-3  # of a finest voxel


@cache
def _device() -> OpenDevice | None:
    try:
        return device()
    except EnvironmentLacks:
        return None


def kernel_samples(
    texture: VirtualTexture, positions: F64, normals: F32, storage: Storage = "float32",
    reconstruction: Reconstruction = "linear",
) -> Samples | None:  # fmt: skip
    """What the kernel reads at positions (N, 3) m for unit normals (N, 3); None without an OpenCL device. texture: its texels already
    as `storage` keeps them."""
    found = _device()
    if found is None:
        return None
    layout: Layout = "packed" if storage in ("float32", "half") else "split"
    got = Sampler(found, texture, storage, layout, reconstruction)(positions, normals)
    assert isinstance(got, Samples)
    return got


def kernel_off(
    texture: VirtualTexture, positions: F64, seed: int, storage: Storage = "float32"
) -> dict[str, Reading]:  # fmt: skip
    """Largest difference between the kernel and its twin at positions (N, 3) m, normals at random: over the twin's light averaged over
    normals at the place, with a hundredth of the mean of all places (as seams are read, metrics/seams.py). {} without a device."""
    normals = units(len(positions), seed)
    got = kernel_samples(texture, positions, normals, storage)
    if got is None:
        return {}
    exact = sample(texture, positions, normals)
    back = sample(texture, positions, -normals)  # the order 1 part cancels: the mean over normals is left
    mean = 0.5 * np.abs(exact.irradiance.astype(np.float64) + back.irradiance).mean(axis=1)
    scale = mean + 0.01 * float(mean.mean()) + 1e-30
    off = np.abs(got.irradiance.astype(np.float64) - exact.irradiance).max(axis=1) / scale
    off = np.where(np.isfinite(off), off, np.inf)  # NaN would be no largest
    return {KERNEL: Reading(float(off.max()), 0.0, len(positions))}


def both_sides(texture: VirtualTexture, q: F64, seed: int) -> F64:
    """Positions (2 N, 3) m a HAIR to a random side of places q (N, 3), in finest voxels, and to the opposite one."""
    rng = np.random.default_rng([seed, 12])
    away = HAIR * rng.choice((-1.0, 1.0), q.shape)
    inside = np.clip(np.concatenate([q + away, q - away]), 0.0, texture.extent)
    return np.asarray(texture.origin + inside * texture.finest, dtype=np.float64)


def mean_light(irradiance: F32 | F64) -> F64:
    """Irradiance (..., 3) of light that comes from everywhere alike, as its radiance coefficient L00."""
    return np.asarray(irradiance, dtype=np.float64) / (COSINE_A0 * Y0)
