"""Diffuse albedo that a material has for the radiosity.

A plastic's diffuse reflectance ρ lies under a dielectric coat: light is refracted in, may be reflected back inside, and
is refracted out, so what leaves is less than ρ, and the coat itself reflects. With the coat's hemispherical reflectance
F_e from outside and F_i = 1 - (1 - F_e)/η² from inside (η = n_int / n_ext),

    ρ_hemispherical = F_e + (1 - F_e)(1 - F_i) ρ / (1 - F_i ρ)

(Saunderson 1942; Mitsuba's `plastic`, `nonlinear`; without `nonlinear` the denominator is 1 - F_i.) The gloss is spread
over all directions, which keeps its energy: a model error in direction, not in power.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, Material

PLASTICS = frozenset({"plastic", "roughplastic"})
DEFAULT_IOR = 1.49


def baked_albedo(material: Material, colours: npt.NDArray[np.floating]) -> F64:
    """What `material` reflects where its `albedo` or `texture` reads `colours` (..., 3); returns (..., 3)."""
    plastic = _find(material.truth_bsdf, PLASTICS)
    rho = np.asarray(colours, dtype=np.float64)
    if plastic is None:
        return rho
    inner, outer = (_ior(plastic.get(k), d) for k, d in (("int_ior", DEFAULT_IOR), ("ext_ior", 1.0)))
    eta = inner / outer
    outside = fresnel_hemispherical(eta)
    inside = 1.0 - (1.0 - outside) / eta**2
    below = rho if plastic.get("nonlinear", False) else 1.0
    return np.asarray(outside + (1.0 - outside) * (1.0 - inside) * rho / (1.0 - inside * below))


def fresnel_hemispherical(eta: float, samples: int = 4096) -> float:
    """∫ F(θ) 2 cosθ d(cosθ): share of diffuse light that a dielectric of relative index `eta` reflects."""
    cos_i = (np.arange(samples) + 0.5) / samples
    cos_t = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cos_i**2) / eta**2))
    s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return float((0.5 * (s**2 + p**2) * 2.0 * cos_i).mean())


def _ior(value: Any, default: float) -> float:
    return float(value) if isinstance(value, int | float) else default


def _find(bsdf: Mapping[str, Any] | None, types: frozenset[str]) -> Mapping[str, Any] | None:
    """The first plugin of one of `types`, inside `twosided`, `mask` and the like too."""
    if bsdf is None or bsdf.get("type") in types:
        return bsdf
    nested = (v for v in bsdf.values() if isinstance(v, Mapping))
    return next((found for v in nested if (found := _find(v, types)) is not None), None)
