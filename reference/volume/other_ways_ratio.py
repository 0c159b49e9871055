"""Light stored as L0 and the ratios of L1 to it, filtered as it is stored and decoded afterwards: the plain specification.

    stored     w L0 as half floats, r_k = (128 + round(127 w L_k / (√3 L0))) / 255 for k = 1 … 3 and w as 8-bit unorms
    sampled    W = Σ t_i w_i;  L0 = Σ t_i w_i L0_i / W;  L_k = √3 Σ t_i (255 r_ki - 128) / (127 W) · L0;  E(n) = Σ_k w_k(n) L_k

|L_k| ≤ √3 L0 wherever radiance is not negative, so 8 bits hold any ratio. 3 halves and 9 + 1 bytes are 16 a texel, as in Unity's
Adaptive Probe Volumes, which keep L1 so (one of the nine as a fourth half there, and no weight: invalid probes are filled from valid
ones; here ratios are premultiplied as light is). A product of filtered factors is not the filtered product: where L0 differs between
the corners, the direction of the darker one counts as much as that of the brighter.
"""

from __future__ import annotations

import math

import numpy as np

from ..datatypes import F32, F64
from ..texture_types import RatioTexels, Samples, VirtualTexture, pre_exposure, weight_ratio
from .other_ways import Voxels, answering, lit

RANGE = np.float32(math.sqrt(3.0))
STEPS, ZERO, SIDE = np.float32(255.0), np.float32(128.0), np.float32(127.0)


def encode(texture: VirtualTexture) -> RatioTexels:
    """The texels of a texture as ratios."""
    light, exact = texture.texels[..., :12].reshape(-1, 3, 4), texture.texels[..., 12].reshape(-1)
    exposure, steps = pre_exposure(texture.texels), np.round(exact * STEPS)
    weight = (steps / STEPS).astype(np.float32)
    base = light[..., 0] * weight_ratio(weight, exact)[:, None] / np.float32(exposure)
    ratio = ZERO + np.round(SIDE * np.clip(exact_ratio(light), -1.0, 1.0) * weight[:, None, None])
    return RatioTexels(base.astype(np.float16), ratio.astype(np.uint8), steps.astype(np.uint8), exposure)


def exact_ratio(light: F32) -> F32:
    """L1 / (√3 L0), (N, 3, 3), of light (N, 3, 4); 0 where there is none."""
    base = light[..., :1]
    return np.asarray(
        np.where(base != 0.0, light[..., 1:] / (RANGE * np.where(base != 0.0, base, np.float32(1.0))), 0.0), np.float32
    )


def ratio_l1(texture: VirtualTexture, texels: RatioTexels, positions: F32 | F64, normals: F32 | F64) -> Samples:
    """Irradiance at `positions` (N, 3) m for unit `normals` (N, 3) of light kept as ratios; texture: the one that was encoded."""
    at = answering(texture, positions)
    base = texels.base.astype(np.float32) * np.float32(texels.exposure)
    ratio = (texels.ratio.astype(np.float32) - ZERO) * (np.float32(1.0) / SIDE)
    weight = texels.weight.astype(np.float32) * (np.float32(1.0) / STEPS)
    return decoded(at, base, ratio, weight, normals)


def unrounded(texture: VirtualTexture, positions: F32 | F64, normals: F32 | F64) -> Samples:
    """The same with nothing rounded: what filtering before decoding does alone."""
    light = texture.texels[..., :12].reshape(-1, 3, 4)
    weight = texture.texels[..., 12].reshape(-1)
    ratio = weight[:, None, None] * exact_ratio(light)
    return decoded(answering(texture, positions), light[..., 0], ratio, weight, normals)


def decoded(at: Voxels, base: F32, ratio: F32, weight: F32, normals: F32 | F64) -> Samples:
    """Irradiance of L0 (T·27, 3) times weight, ratios (T·27, 3, 3) in -1 … 1 times weight, and weights (T·27,), each filtered."""

    def filtered(values: F32) -> F32:
        parts = values.reshape(len(values), -1)
        return np.asarray(sum(parts[at.corners[:, i]] * at.share[:, i, None] for i in range(8)), dtype=np.float32)

    first, r, w = filtered(base), filtered(ratio).reshape(-1, 3, 3), filtered(weight)[:, 0]
    whole = np.where(at.level > 0, w, np.float32(1.0))[:, None, None]
    rest = r * (RANGE / whole) * first[..., None]
    light = np.concatenate([first[..., None], rest], axis=2).reshape(-1, 12)
    return lit(at, light, w, normals)
