"""Real orthonormal spherical harmonics of order L1, and irradiance from radiance SH.

Order of coefficients: L00, L1-1 (y), L10 (z), L11 (x), no Condon-Shortley phase. Irradiance is the convolution of
radiance with the clamped cosine: A0 = π, A1 = 2π/3 (Ramamoorthi and Hanrahan 2001, "An efficient representation for
irradiance environment maps", eq. 8).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .datatypes import F64

COEFFICIENTS = 4
Y0 = 0.5 * math.sqrt(1.0 / math.pi)
Y1 = 0.5 * math.sqrt(3.0 / math.pi)
COSINE_A0 = math.pi
COSINE_A1 = 2.0 * math.pi / 3.0


def basis(directions: npt.NDArray[np.floating]) -> F64:
    """Y_lm at unit `directions` (..., 3); returns (..., 4) f64."""
    d = np.asarray(directions, dtype=np.float64)
    return np.stack([np.full(d.shape[:-1], Y0), Y1 * d[..., 1], Y1 * d[..., 2], Y1 * d[..., 0]], axis=-1)


def irradiance_weights(normals: npt.NDArray[np.floating]) -> F64:
    """Row w with E(n) = Σ w_k L_k for radiance coefficients L_k; `normals` (..., 3) unit; returns (..., 4) f64."""
    w = basis(normals)
    w[..., 0] *= COSINE_A0
    w[..., 1:] *= COSINE_A1
    return w


def irradiance(coefficients: npt.NDArray[np.floating], normals: npt.NDArray[np.floating]) -> F64:
    """Linear L1 irradiance, W·m⁻², from radiance SH (..., 4, 3) at unit `normals` (..., 3); returns (..., 3) f64."""
    return np.einsum("...k,...kc->...c", irradiance_weights(normals), np.asarray(coefficients, dtype=np.float64))
