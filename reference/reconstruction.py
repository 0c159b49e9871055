"""Irradiance at a unit normal from radiance SH: the ways to make more of four coefficients, or five more of them.

With I0 = A0 Y0 L00 = √π/2 L00 and the vector I1 = A1 Y1 (L11, L1-1, L10) = √(π/3) L1, per colour:

    linear     E = I0 + I1 · n                                       negative somewhere iff |I1| > I0 (failure-catalogue C1)
    clamped    max(E, 0)
    nonlinear  E = I0 (a + (1 - a)(p + 1) q^p),  r = |I1| / (2 I0),  a = (1 - r)/(1 + r),  p = 1 + 2 r,  q = (1 + n · I1/|I1|) / 2
    zh3        E = I0 + I1 · n + A2 Y20 (3 (n · ẑ)² - 1) L2z,        L2z = L00 (0.08 ρ + 0.6 ρ²),  ρ = |L1 · ẑ| / L00
    l2         E = I0 + I1 · n + A2 Σ_m Y2m(n) L2m

`nonlinear`: G. Hazel 2017, "Converting SH radiance to irradiance": exact for light from all around (r = 0) and from one
direction where it faces (r = 1), never negative, and its mean over normals is I0. `zh3`: Roughton, Sloan, Silvennoinen, Iwanicki
and Shirley 2024, "ZH3: Quadratic Zonal Harmonics", the variant that guesses the zonal coefficient from the linear ones; ẑ is the axis
of luminance, which all colours share. It may be slightly negative opposite the light.

No radiance has r > 1 or ρ > √3: rounding may, and they are held there. Where L00 is not positive there is no light to tell a direction
of, and `nonlinear` and `zh3` give 0 for that colour, so that light of any value, 0 included, gives no NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import get_args

import numpy as np
import numpy.typing as npt

from .config_base import Reconstruction as Reconstruction
from .datatypes import F64
from .sh import COEFFICIENTS, COEFFICIENTS_2, COSINE_A0, COSINE_A2, Y0, Y20, Order
from .sh import irradiance as linear_irradiance

RECONSTRUCTIONS: tuple[Reconstruction, ...] = get_args(
    Reconstruction
)  # a kernel's -D RECONSTRUCTION is the place in here
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
LARGEST_RATIO = math.sqrt(3.0)  # of |L1| to L00, for light from one direction
ZONAL = (0.08, 0.6)  # fit of the paper to lighting of games

Light = npt.NDArray[np.floating]


def order_for(method: Reconstruction) -> Order:
    """Order of the SH that `method` reads."""
    return 2 if method == "l2" else 1


def irradiance(method: Reconstruction, light: Light, normals: Light) -> F64:
    """Irradiance (..., 3) f64, W·m⁻², at unit `normals` (..., 3) from radiance SH `light` (..., 4 or 9, 3), already divided by weights.

    Only `l2` reads more than four coefficients. Raises ValueError for a method that is not in RECONSTRUCTIONS and for other shapes.
    """
    if method not in RECONSTRUCTIONS:
        raise ValueError(f"reconstruction must be one of {', '.join(RECONSTRUCTIONS)}, got {method!r}")
    given, n = np.asarray(light, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    counts = (COEFFICIENTS_2,) if method == "l2" else (COEFFICIENTS, COEFFICIENTS_2)
    if given.ndim < 2 or given.shape[-1] != 3 or given.shape[-2] not in counts:
        raise ValueError(f"light for {method} must be (…, {' or '.join(map(str, counts))}, 3), got {given.shape}")
    return _METHODS[method](given[..., : counts[0], :], n)


def _clamped(light: F64, normals: F64) -> F64:
    return np.maximum(linear_irradiance(light, normals), 0.0)


def _ratios(light: F64) -> tuple[F64, F64, npt.NDArray[np.bool_]]:
    """L00 (..., 3), L1 / L00 (..., xyz, 3) and where L00 is positive; elsewhere L00 is taken for 1."""
    lit = light[..., 0, :] > 0.0
    first = np.where(lit, light[..., 0, :], 1.0)
    return first, light[..., [3, 1, 2], :] / first[..., None, :], lit


def _nonlinear(light: F64, normals: F64) -> F64:
    first, vector, lit = _ratios(light)
    length = np.linalg.norm(vector, axis=-2)
    r = np.minimum(length / LARGEST_RATIO, 1.0)
    along = np.einsum("...a,...ac->...c", normals, vector) / np.where(length > 0.0, length, 1.0)
    q, p, a = np.clip(0.5 + 0.5 * along, 0.0, 1.0), 1.0 + 2.0 * r, (1.0 - r) / (1.0 + r)
    return np.where(lit, COSINE_A0 * Y0 * first * (a + (1.0 - a) * (p + 1.0) * q**p), 0.0)


def _zh3(light: F64, normals: F64) -> F64:
    first, vector, lit = _ratios(light)
    axis = (vector * first[..., None, :]) @ LUMINANCE
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = axis / np.where(length > 0.0, length, 1.0)
    ratio = np.minimum(np.abs(np.einsum("...a,...ac->...c", axis, vector)), LARGEST_RATIO)
    zonal = first * (ZONAL[0] * ratio + ZONAL[1] * ratio**2)
    lobe = COSINE_A2 * Y20 * (3.0 * np.einsum("...a,...a->...", axis, normals) ** 2 - 1.0)
    return np.where(lit, linear_irradiance(light, normals) + zonal * lobe[..., None], 0.0)


_METHODS: dict[Reconstruction, Callable[[F64, F64], F64]] = {
    "linear": linear_irradiance,
    "clamped": _clamped,
    "nonlinear": _nonlinear,
    "zh3": _zh3,
    "l2": linear_irradiance,
}
