"""Hemispherical albedo of plastics against Mitsuba's own BSDFs, integrated over both hemispheres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lightgauge.reference.datatypes import Material
from lightgauge.reference.transport.baked_albedo import baked_albedo, fresnel_hemispherical
from lightgauge.reference.variant import ensure_variant


def mitsuba_albedo(bsdf: dict[str, Any], n: int = 1 << 20) -> float:
    """Mean weight of BSDF samples for cosine-distributed incidence (seeded; standard error about 1e-3)."""
    ensure_variant()
    import drjit as dr
    import mitsuba as mi

    plugin = mi.load_dict(bsdf)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, n)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    _, weight = plugin.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
    return float(np.array(weight).mean())


@pytest.mark.parametrize("rho", [0.2, 0.8])
@pytest.mark.parametrize("nonlinear", [True, False])
@pytest.mark.parametrize("eta", [1.3, 1.5])
def test_smooth_plastic(rho: float, nonlinear: bool, eta: float) -> None:
    bsdf = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [rho] * 3}, "int_ior": eta, "ext_ior": 1.0,
            "nonlinear": nonlinear}  # fmt: skip
    m = Material("m", np.full(3, rho), truth_bsdf={"type": "twosided", "bsdf": bsdf})
    assert baked_albedo(m, m.albedo) == pytest.approx(np.full(3, mitsuba_albedo(bsdf)), abs=0.006)


def test_diffuse_is_unchanged() -> None:
    m = Material("m", np.array([0.1, 0.5, 0.9]))
    assert np.array_equal(baked_albedo(m, m.albedo), m.albedo)


def test_fresnel_of_glass() -> None:
    """0.0918 for η = 1.5 (Egan and Hilgeman 1979, table; also Judd 1942)."""
    assert fresnel_hemispherical(1.5) == pytest.approx(0.0918, abs=2e-4)
    assert fresnel_hemispherical(1.0) == pytest.approx(0.0, abs=1e-12)
