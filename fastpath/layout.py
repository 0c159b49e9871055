"""The tile cache as a device holds it: storage formats, layouts, and host arrays in them.

    storage    float32   light and weight in single precision
               half      both in half precision
               half16    half light, 16-bit unorm weight
               half8     half light, 8-bit unorm weight: the talk's format, 25 bytes per texel
    layout     packed    texels of 16 numbers, tile after tile: 12 coefficients, weight, three unused (float32, half)
               split     three RGBA textures and one of weights, in cache order, as buffers
               images    the same as 3D images, read by the linear sampler (halves only)

A CPU wants packed, whose eight fetches are eight loads of one vector; a GPU wants images, whose texture units interpolate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32, I64
from ..reference.texture_types import Storage, VirtualTexture, pre_exposure, stored_weight, weight_ratio

Layout = Literal["packed", "split", "images"]
LAYOUTS: tuple[Layout, ...] = ("packed", "split", "images")
TEXELS, PACKED_SIZE, BAND2 = 27, 16, 15
WEIGHT_STEPS: dict[Storage, int] = {"float32": 1, "half": 1, "half16": 65535, "half8": 255}
LIGHT_TYPE: dict[Storage, type[np.floating]] = {
    "float32": np.float32, "half": np.float16, "half16": np.float16, "half8": np.float16,
}  # fmt: skip
WEIGHT_TYPE: dict[Storage, type[np.generic]] = {
    "float32": np.float32, "half": np.float16, "half16": np.uint16, "half8": np.uint8,
}  # fmt: skip
WEIGHT_C: dict[Storage, str] = {"float32": "float", "half": "half", "half16": "ushort", "half8": "uchar"}


def check_format(storage: Storage, layout: Layout) -> None:
    """Raises ValueError for a storage that the layout cannot hold."""
    if storage not in WEIGHT_C or layout not in LAYOUTS:
        raise ValueError(
            f"expected a storage of {', '.join(WEIGHT_C)} and a layout of {', '.join(LAYOUTS)}, got {storage}, {layout}"
        )
    if layout == "packed" and storage not in ("float32", "half"):
        raise ValueError(f"the packed layout holds float32 or half, got storage {storage!r}")
    if layout == "images" and storage == "float32":
        raise ValueError("images hold half, half16 or half8, got storage 'float32'")


def build_options(storage: Storage, layout: Layout) -> list[str]:
    """What common.clh is to be built with."""
    options = [f"-DWEIGHT={WEIGHT_C[storage]}", f"-DWEIGHT_SCALE={WEIGHT_STEPS[storage]}.0f"]
    options += ["-DHALF_LIGHT"] if LIGHT_TYPE[storage] is np.float16 else []
    options += ["-DHALF_WEIGHT"] if storage == "half" else []
    options += {"packed": ["-DPACKED"], "split": [], "images": ["-DIMAGES"]}[layout]
    return options


def texel_bytes(storage: Storage, layout: Layout) -> int:
    """Bytes of one texel, L1: 25 for the talk's format."""
    light = np.dtype(LIGHT_TYPE[storage]).itemsize
    if layout == "packed":
        return PACKED_SIZE * light
    return 12 * light + np.dtype(WEIGHT_TYPE[storage]).itemsize


@dataclass(frozen=True, eq=False)
class CacheTextures:
    """Host arrays of a cache. split: light (3, Z, Y, X, 4), red, green and blue SH, and weight (Z, Y, X); X = 3 × tiles along x, and so
    on, x fastest. packed: light (tiles · 27, 16) and no weight. more (tiles · 27, 16): order 2, packed too, None for L1."""

    light: npt.NDArray[np.floating]
    weight: npt.NDArray[np.generic] | None
    more: npt.NDArray[np.floating] | None = None

    @property
    def bytes(self) -> int:
        """Size of the cache."""
        return sum(a.nbytes for a in (self.light, self.weight, self.more) if a is not None)


def cache_textures(texture: VirtualTexture, storage: Storage, layout: Layout = "split") -> CacheTextures:
    """Put the tiles (T, 27, 13 or 28) of `texture` into cache order. Raises ValueError as `check_format` does, and for order 2 in
    another layout than packed."""
    check_format(storage, layout)
    texels = texture.texels
    if texels.shape[2] > 13 and layout != "packed":
        raise ValueError(f"order 2 is held in the packed layout only, got {layout}")
    divisor = np.float32(exposure(texture, storage))
    weight = stored_weight(texels[..., 12], storage)
    ratio = (weight_ratio(weight, texels[..., 12]) / divisor)[..., None]
    if layout == "packed":
        light, kind = np.zeros((*texels.shape[:2], PACKED_SIZE), np.float32), LIGHT_TYPE[storage]
        light[..., :12], light[..., 12] = texels[..., :12] * ratio, weight
        more = None
        if texels.shape[2] > 13:
            more = np.zeros((*texels.shape[:2], PACKED_SIZE), np.float32)
            more[..., :BAND2] = texels[..., 13:] * ratio
            more = more.reshape(-1, PACKED_SIZE).astype(kind)
        return CacheTextures(light.reshape(-1, PACKED_SIZE).astype(kind), None, more)
    light = _in_cache_order(texels[..., :12] * ratio, texture.indirection.cache)
    steps = WEIGHT_STEPS[storage]
    whole = _in_cache_order(np.round(weight * steps) if steps > 1 else weight, texture.indirection.cache)
    parts = np.stack([light[..., 4 * c : 4 * c + 4] for c in range(3)])
    return CacheTextures(parts.astype(LIGHT_TYPE[storage]), np.ascontiguousarray(whole.astype(WEIGHT_TYPE[storage])))


def _in_cache_order(values: F32, cache: I64) -> F32:
    """Texels (T, 27, …), x slowest, as a volume (Z, Y, X, …); slot = x + X (y + Y z) over tiles."""
    cx, cy, cz = (int(n) for n in cache)
    rest = values.shape[2:]
    slots = np.zeros((cx * cy * cz, TEXELS, *rest), dtype=np.float32)
    slots[: len(values)] = values
    axes = (0, 5, 1, 4, 2, 3, *range(6, 6 + len(rest)))
    return slots.reshape(cz, cy, cx, 3, 3, 3, *rest).transpose(axes).reshape(3 * cz, 3 * cy, 3 * cx, *rest)


def exposure(texture: VirtualTexture, storage: Storage) -> float:
    """What stored light is to be multiplied by: see `pre_exposure`; 1 for float32."""
    return 1.0 if storage == "float32" else pre_exposure(texture.texels)
