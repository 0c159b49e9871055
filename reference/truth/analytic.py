"""Closed forms."""

from __future__ import annotations

import numpy as np

from ..datatypes import F64


def closed_sphere_radiosity(area: F64, albedo: F64, exitance: F64) -> F64:
    """Radiosity (P, 3), W·m⁻², inside a sphere of uniform albedo: B = M + ρ M̄ / (1 - ρ).

    Every point of a sphere sees every other with F_ij = A_j / A, so the irradiance is the same everywhere
    (Walsh 1920; Hottel and Sarofim, Radiative Transfer, 1967, ch. 3). area (P,), albedo (P, 3), exitance (P, 3).
    Raises ValueError if the albedo is not uniform.
    """
    rho = albedo.mean(axis=0)
    if np.abs(albedo - rho).max() > 1e-6:
        raise ValueError(f"the closed form needs one albedo, got {albedo.min(axis=0)} … {albedo.max(axis=0)}")
    mean = area @ exitance / area.sum()
    return np.asarray(exitance + rho * mean / (1.0 - rho))


def closed_sphere_irradiance(area: F64, albedo: F64, exitance: F64) -> F64:
    """Irradiance (3,), W·m⁻², everywhere on the inside of such a sphere: its mean radiosity. Arguments and errors as above."""
    return np.asarray(area @ closed_sphere_radiosity(area, albedo, exitance) / area.sum())
