"""Real orthonormal spherical harmonics of orders 1 and 2, and irradiance from radiance SH.

Order of coefficients: L00, L1-1 (y), L10 (z), L11 (x), then L2-2 (xy), L2-1 (yz), L20 (3 z² - 1), L21 (xz), L22 (x² - y²), no
Condon-Shortley phase. Irradiance is the convolution of radiance with the clamped cosine: A0 = π, A1 = 2π/3, A2 = π/4
(Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", eq. 8).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from .datatypes import F64

Order = Literal[1, 2]
COEFFICIENTS = 4  # of order 1
COEFFICIENTS_2 = 9  # of order 2
Y0 = 0.5 * math.sqrt(1.0 / math.pi)
Y1 = 0.5 * math.sqrt(3.0 / math.pi)
Y2 = 0.5 * math.sqrt(15.0 / math.pi)  # of xy, yz, xz; of x² - y² half of it
Y20 = 0.25 * math.sqrt(5.0 / math.pi)
COSINE_A0 = math.pi
COSINE_A1 = 2.0 * math.pi / 3.0
COSINE_A2 = math.pi / 4.0


def coefficient_count(order: Order) -> int:
    """4 or 9."""
    return COEFFICIENTS if order == 1 else COEFFICIENTS_2


def basis(directions: npt.NDArray[np.floating], order: Order = 1) -> F64:
    """Y_lm at unit `directions` (..., 3); returns (..., 4) f64, of order 2 (..., 9)."""
    d = np.asarray(directions, dtype=np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    linear = [np.full(d.shape[:-1], Y0), Y1 * y, Y1 * z, Y1 * x]
    if order == 1:
        return np.stack(linear, axis=-1)
    second = [Y2 * x * y, Y2 * y * z, Y20 * (3.0 * z * z - 1.0), Y2 * x * z, 0.5 * Y2 * (x * x - y * y)]
    return np.stack([*linear, *second], axis=-1)


def irradiance_weights(normals: npt.NDArray[np.floating], order: Order = 1) -> F64:
    """Row w with E(n) = Σ w_k L_k for radiance coefficients L_k; `normals` (..., 3) unit; returns (..., 4 or 9) f64."""
    w = basis(normals, order)
    w[..., 0] *= COSINE_A0
    w[..., 1:4] *= COSINE_A1
    w[..., 4:] *= COSINE_A2
    return w


def irradiance(coefficients: npt.NDArray[np.floating], normals: npt.NDArray[np.floating]) -> F64:
    """Linear irradiance, W·m⁻², of the order that the coefficients have, from radiance SH (..., 4 or 9, 3) at unit `normals` (..., 3);
    returns (..., 3) f64."""
    light = np.asarray(coefficients, dtype=np.float64)
    return np.einsum("...k,...kc->...c", irradiance_weights(normals, order_of(light.shape[-2])), light)


def order_of(coefficients: int) -> Order:
    """1 for 4 coefficients, 2 for 9. Raises ValueError for other counts."""
    if coefficients not in (COEFFICIENTS, COEFFICIENTS_2):
        raise ValueError(f"radiance SH must have 4 or 9 coefficients, got {coefficients}")
    return 1 if coefficients == COEFFICIENTS else 2
