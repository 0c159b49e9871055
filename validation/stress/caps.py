"""Caps: cones of radiance 1 W·m⁻²·sr⁻¹ about +z, cosine c of the half angle; what their SH and irradiance are.

    L_l = √(π/(2 l + 1)) (P_(l-1)(c) - P_(l+1)(c)),   so   I0 = π/2 (1 - c),   |I1| / I0 = 1 + c
    E(z) = ∫_c^1 ∫ max(n · ω, 0) dφ dt,   the inner integral in closed form: Lambert's law over each ring of height t

Everything is zonal: normals are known by their height z, and means over all of them are means over z (Archimedes).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import eval_legendre

from ...reference.datatypes import F64
from ...reference.reconstruction import RECONSTRUCTIONS, irradiance

HEIGHTS, WEIGHTS = np.polynomial.legendre.leggauss(300)  # of normals; the weights' sum is 2
WEIGHTS = 0.5 * WEIGHTS
RING, RING_WEIGHTS = np.polynomial.legendre.leggauss(600)
BANDS = 200


def normals_at(z: F64) -> F64:
    """Unit normals (N, 3) of heights z (N,)."""
    return np.stack([np.sqrt(1.0 - z * z), np.zeros_like(z), z], axis=-1)


def coefficient(c: float, band: int) -> float:
    """L_l of a cap."""
    below = 1.0 if band == 0 else float(eval_legendre(band - 1, c))
    return math.sqrt(math.pi / (2 * band + 1)) * (below - float(eval_legendre(band + 1, c)))


def cap_light(c: float, opposite: bool = False) -> F64:
    """Radiance SH (9, 3) of a cap, or of two opposite ones."""
    light = np.zeros((9, 3))
    for place, band in ((0, 0), (2, 1), (6, 2)):
        light[place] = coefficient(c, band) * (1.0 + (-1.0) ** band if opposite else 1.0)
    return light


def cap_irradiance(c: float, z: F64) -> F64:
    """Exact irradiance (N,), W·m⁻², at normals of heights z (N,) from a cap of at most 90°."""
    t = c + 0.5 * (RING + 1.0) * (1.0 - c)
    along, across = z[:, None] * t, np.sqrt((1.0 - t * t) * (1.0 - z[:, None] ** 2))
    turn = np.arccos(np.clip(-along / across, -1.0, 1.0))
    return np.asarray((1.0 - c) * ((along * turn + across * np.sin(turn)) @ RING_WEIGHTS))


def missed(c: float, first: int, opposite: bool = False) -> float:
    """Root mean square over normals of what even bands from `first` on add to the irradiance, over its mean.

    A_l of even bands: Ramamoorthi and Hanrahan 2001, eq. 8; odd ones above 1 are 0. By Parseval the mean square of a band is (A_l
    L_l)² / 4π."""
    total = 0.0
    for band in range(first, BANDS, 2):
        fall = math.exp(math.lgamma(band + 1) - band * math.log(2.0) - 2.0 * math.lgamma(0.5 * band + 1.0))
        total += (2.0 * math.pi * fall / ((band + 2) * (band - 1)) * coefficient(c, band)) ** 2
    mean = 0.5 * math.pi * (1.0 - c)  # two caps have twice the bands and twice the mean
    return math.sqrt(total / (4.0 * math.pi)) / mean


def reconstructed(c: float, opposite: bool = False) -> tuple[F64, dict[str, F64]]:
    """Exact irradiance (N,) at normals HEIGHTS, and by name of the reconstruction what the product makes of exact SH."""
    truth = cap_irradiance(c, HEIGHTS)
    truth = truth + cap_irradiance(c, -HEIGHTS) if opposite else truth
    light = np.tile(cap_light(c, opposite), (len(HEIGHTS), 1, 1))
    return truth, {name: irradiance(name, light, normals_at(HEIGHTS))[:, 1] for name in RECONSTRUCTIONS}


def relative_error(got: F64, truth: F64) -> float:
    """Root mean square over all normals of got - truth (N,), over the mean of the truth."""
    return math.sqrt(float(WEIGHTS @ (got - truth) ** 2)) / float(WEIGHTS @ truth)
