"""Radiosity: B = M + ρ (E_direct + F B), solved to a residual, and the light that probes gather.

What a receiver may see is B without the exitance of lights tagged `engine` (their direct light is the engine's), plus
the sky if it is tagged `input`. Cohen and Greenberg 1985, "The hemi-cube", eq. 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, Scene
from ..sky import SKY_BINS, bin_radiance, split_peaks
from .form_factors import FormFactors
from .gather import DeviceRows, gather
from .patches import Patches
from .solver_types import Method, device_system
from .solvers import JACOBI
from .solvers import solve as solve_system
from .spectral import Spectrum, bounce_count, estimate_spectrum


@dataclass(frozen=True, eq=False)
class Radiosity:
    """Steady light on the patches.

    radiosity (P, 3), W·m⁻²: reflected plus exitance tagged `input`; irradiance (P, 3), W·m⁻², total incident.
    light (P + SKY_BINS + 1, 3): what form-factor columns carry to a receiver (π L for sky bins, 0 for absorbed).
    iterations, residual: of the solver. energy_residual: |power in - power out| / power in, worst colour: in are
    exitance, direct light and sky, out is what patches absorb and what leaves through the sky or black backs.
    spectral_radius: of ρ F, worst colour, as a bound from above. bounces: after so many at most the tolerance is left.
    """

    radiosity: F64
    irradiance: F64
    light: F64
    iterations: int
    residual: float
    energy_residual: float
    spectral_radius: float
    bounces: int


def solve(
    scene: Scene,
    p: Patches,
    rows: DeviceRows,
    direct: F64,
    tolerance: float,
    method: Method = JACOBI,
    host: FormFactors | None = None,
    spectrum: Spectrum | None = None,
) -> Radiosity:
    """Solve until what is unshot is at most `tolerance` of the source in every colour; then one last gather.

    direct: (P, 3) irradiance of engine lights. host: the rows again, for methods that walk single ones. spectrum: of an
    earlier solution of the same bake; it does not depend on the lights. Raises ValueError if the spectral radius is not
    under 0.999 (the light would need thousands of bounces, failure-catalogue B1), or if the tolerance is not reached.
    """
    sky = np.pi * bin_radiance(scene.sky)
    engine_sky = scene.sky is not None and scene.sky.engine_lit
    smooth = None if scene.sky is None else split_peaks(scene.sky)[0]  # its peaks are direct light already
    from_sky = _gathered(rows, np.zeros((p.count, 3)), np.pi * bin_radiance(smooth))
    system = device_system(rows, p.albedo, p.exitance + p.albedo * (direct + from_sky), p.area, host)
    spectrum = spectrum or estimate_spectrum(system)
    solution = solve_system(system, method, tolerance, spectrum=spectrum)
    incident = direct + from_sky + system.product(solution.radiosity)
    b = p.exitance + p.albedo * incident  # one bounce more, so that radiosity and irradiance belong together
    seen_sky = np.zeros_like(sky) if engine_sky else sky
    return Radiosity(
        radiosity=b,
        irradiance=incident,
        light=np.concatenate([b, seen_sky, np.zeros((1, 3))]),
        iterations=solution.iterations,
        residual=solution.residual,
        energy_residual=_energy_residual(p, rows, b, direct, from_sky),
        spectral_radius=spectrum.upper,
        bounces=bounce_count(spectrum.upper, tolerance),
    )


def _gathered(rows: DeviceRows, from_patches: F64, from_sky: F64) -> F64:
    """Irradiance (P, 3), W·m⁻², from radiosity (P, 3) and π × the radiance of the sky's bins (SKY_BINS, 3)."""
    return gather(rows, np.concatenate([from_patches, from_sky, np.zeros((1, 3))]))[:, 0].astype(np.float64)


def _energy_residual(p: Patches, rows: DeviceRows, b: F64, direct: F64, from_sky: F64) -> float:
    """|in - out| / in, worst colour. In: exitance, direct light and sky that reach patches. Out: what patches absorb of the
    light that the *final* radiosity sends them, and what it sends outside. It holds if the form factors are reciprocal and
    closed and the radiosity is a solution; an unconverged one shows."""
    dark = np.zeros((SKY_BINS, 3))
    incident = direct + from_sky + _gathered(rows, b, dark)
    leaving = 1.0 - _gathered(rows, np.ones((p.count, 3)), dark)  # rows sum to one
    power_in = p.area @ (p.exitance + direct + from_sky)
    power_out = p.area @ ((1.0 - p.albedo) * incident + b * leaving)
    lit = power_in > 0.0
    return float((np.abs(power_in - power_out)[lit] / power_in[lit]).max(initial=0.0))
