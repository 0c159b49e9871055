"""Other ways to read the same probes on an OpenCL device, to hold beside `Sampler`: the host side of other_ways.cl.

    FixedPoint   the plain sampler with fractions of 8 bits, as texture units interpolate
    Chebyshev    eight explicit loads, each weighted by what its probe sees of the sample
    RatioL1      16 bytes a texel: L0 as halves, L1 / L0 as bytes, filtered before they are decoded
    PerMesh      the texture sampled once a mesh; pixels take their mesh's light by their own normal

Each has `bytes`, what it holds on the device, and `seconds`, the device time of its last call. Specifications:
reference/volume/other_ways*.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..reference.datatypes import F32, I32
from ..reference.texture_types import DistanceMaps, RatioTexels, Samples, Storage, VirtualTexture
from .arrays import check_triples, empty, uploaded
from .device import OpenDevice, pyopencl_module
from .grid import Lattice, grid_words
from .launch import grouped
from .layout import build_options, cache_textures, check_format, exposure
from .programs import program
from .sampler import lod_table

FRACTION_BITS = 8
LEAST_VARIANCE = 2.0**-10  # of the squared mean distance: what halves cannot tell from none
_FIXED, _CHEBYSHEV, _RATIO, _LIGHT = range(4)


class _Way:
    """The kernel of one way over one texture; `textures`: its first arguments."""

    def __init__(
        self,
        device: OpenDevice,
        texture: VirtualTexture,
        options: list[str],
        textures: list[Any],
        scale: float,
        size: int,
    ) -> None:
        i = texture.indirection
        self._device, self._kernel = (
            device,
            pyopencl_module().Kernel(program(device, "other_ways.cl", options), "sample"),
        )
        # Kept as attributes: a kernel does not own its arguments.
        self._textures = [*textures, uploaded(device, i.texels), uploaded(device, lod_table(texture))]
        lattice = Lattice(texture.origin, texture.finest, texture.level, texture.extent, i.cache)
        self._origin, self._words = texture.origin, grid_words(lattice, texture.origin, None, scale)
        self.bytes = size + i.texels.nbytes
        self.seconds = 0.0

    def _found(self, positions: Any, normals: Any, channels: int) -> tuple[F32, I32, F32]:
        """(N, channels), level (N,) and weight (N,) at `positions` (N, 3) m for `normals` (N, 3), arrays on the host."""
        n = check_triples("positions", positions)
        check_triples("normals", normals, n)
        results = [
            empty(self._device, s, t) for s, t in (((n, channels), np.float32), ((n,), np.int32), ((n,), np.float32))
        ]
        if n:
            p = uploaded(self._device, (np.asarray(positions, np.float64) - self._origin).astype(np.float32))
            d = uploaded(self._device, np.asarray(normals, dtype=np.float32))
            outputs = [r.base_data for r in results]
            event = self._kernel(
                self._device.queue, *grouped(n), *self._textures, self._words, p, d, *outputs, np.int32(n)
            )
            self.seconds = _waited(event)
        out, level, weight = (r.get() for r in results)
        return out, level, weight

    def __call__(self, positions: Any, normals: Any) -> Samples:
        """`Samples` at `positions` (N, 3) m for unit `normals` (N, 3), both on the host. Raises ValueError on other shapes."""
        return Samples(*self._found(positions, normals, 3))


def _packed(device: OpenDevice, texture: VirtualTexture, storage: Storage) -> tuple[list[str], Any, float, int]:
    """Build options, buffer, exposure and size of the packed texture. Raises ValueError for a storage that layout does not hold."""
    check_format(storage, "packed")
    light = cache_textures(texture, storage, "packed").light
    return build_options(storage, "packed"), uploaded(device, light), exposure(texture, storage), light.nbytes


class FixedPoint(_Way):
    """Fractions rounded to `bits` bits."""

    def __init__(
        self, device: OpenDevice, texture: VirtualTexture, storage: Storage = "half", bits: int = FRACTION_BITS
    ) -> None:
        """Raises ValueError for a storage that the packed layout does not hold, or bits out of 1 … 16."""
        if not 1 <= bits <= 16:
            raise ValueError(f"bits must be 1 … 16, got {bits}")
        options, held, scale, size = _packed(device, texture, storage)
        super().__init__(device, texture, [*options, f"-DWAY={_FIXED}", f"-DFRACTION_BITS={bits}"], [held], scale, size)


class Chebyshev(_Way):
    """Eight loads with visibility weights."""

    def __init__(
        self, device: OpenDevice, texture: VirtualTexture, maps: DistanceMaps, storage: Storage = "half"
    ) -> None:
        """maps: of this texture's tiles. Raises ValueError for maps of another, or a storage that the packed layout does not hold."""
        moments, number = maps.moments, maps.number
        if (
            number.shape != texture.texels.shape[:2]
            or moments.dtype != np.float16
            or moments.shape[1:] != (moments.shape[1],) * 2 + (2,)
        ):
            raise ValueError(
                f"expected numbers {texture.texels.shape[:2]} and maps (M, S, S, 2) of halves, got {number.shape} and "
                f"{moments.shape} {moments.dtype}"
            )
        if number.min() < 0 or number.max() >= len(moments):
            raise ValueError(f"texels must name maps 0 … {len(moments) - 1}, got {number.min()} … {number.max()}")
        options, held, scale, size = _packed(device, texture, storage)
        options += [f"-DWAY={_CHEBYSHEV}", f"-DSIDE={moments.shape[1]}", f"-DLEAST_VARIANCE={LEAST_VARIANCE!r}f"]
        options += ["-cl-fp32-correctly-rounded-divide-sqrt"]
        textures = [held, uploaded(device, moments), uploaded(device, np.ascontiguousarray(number, dtype=np.int32))]
        super().__init__(device, texture, options, textures, scale, size + maps.bytes)


class RatioL1(_Way):
    """L0 and ratios, filtered before they are decoded."""

    def __init__(self, device: OpenDevice, texture: VirtualTexture, texels: RatioTexels) -> None:
        """texels: those of `texture`. Raises ValueError where they are not as many."""
        if len(texels.base) != texture.texels.shape[0] * texture.texels.shape[1]:
            raise ValueError(
                f"expected {texture.texels.shape[0] * texture.texels.shape[1]} texels, got {len(texels.base)}"
            )
        held = packed_ratios(texels)
        options = [*build_options("half", "packed"), f"-DWAY={_RATIO}"]
        super().__init__(device, texture, options, [uploaded(device, held)], texels.exposure, held.nbytes)


def packed_ratios(texels: RatioTexels) -> npt.NDArray[np.uint8]:
    """16 bytes a texel (T · 27, 16): three halves of L0, nine ratios, the weight."""
    base = np.ascontiguousarray(texels.base).view(np.uint8).reshape(-1, 6)
    return np.concatenate([base, texels.ratio.reshape(-1, 9), texels.weight[:, None]], axis=1)


class PerMesh(_Way):
    """One sample a mesh."""

    def __init__(self, device: OpenDevice, texture: VirtualTexture, middles: Any, storage: Storage = "half") -> None:
        """middles (M, 3) m: where each mesh is sampled. Raises ValueError on another shape, or a storage that the packed layout does
        not hold."""
        options, held, scale, size = _packed(device, texture, storage)
        super().__init__(device, texture, [*options, f"-DWAY={_LIGHT}"], [held], scale, size)
        check_triples("middles", middles)
        self._middles = np.asarray(middles, dtype=np.float64)
        self._evaluate = pyopencl_module().Kernel(
            program(device, "other_ways.cl", [*options, f"-DWAY={_LIGHT}"]), "per_mesh"
        )
        self.bytes += 48 * len(self._middles)

    def light(self) -> F32:
        """Radiance SH (M, 12) of the meshes: four coefficients of red, of green, of blue; 0 where no level answers."""
        return self._found(self._middles, np.zeros_like(self._middles), 12)[0]

    def pixels(self, meshes: I32, normals: Any) -> F32:
        """Irradiance (N, 3) of pixels on `meshes` (N,) i32 with unit `normals` (N, 3); `seconds` is that of both steps.

        Raises ValueError for a mesh that is not there, or other shapes.
        """
        n = check_triples("normals", normals)
        if meshes.shape != (n,) or (n and (meshes.min() < 0 or meshes.max() >= len(self._middles))):
            raise ValueError(f"expected {n} numbers of meshes 0 … {len(self._middles) - 1}, got {meshes.shape}")
        light, out = self.light(), empty(self._device, (n, 3), np.float32)
        if n:
            held = [
                uploaded(self._device, a) for a in (light, meshes.astype(np.int32), np.asarray(normals, np.float32))
            ]
            self.seconds += _waited(self._evaluate(self._device.queue, *grouped(n), *held, out.base_data, np.int32(n)))
        found: F32 = out.get()
        return found


def _waited(event: Any) -> float:
    """Device time of a launch, s; waits for it."""
    event.wait()
    return float(event.profile.end - event.profile.start) * 1e-9
