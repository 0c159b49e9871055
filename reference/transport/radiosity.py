"""Radiosity: B = M + ρ (E_direct + F B), iterated to a residual, and the light that probes gather.

What a receiver may see is B without the exitance of lights tagged `engine` (their direct light is the engine's), plus
the sky if it is tagged `input`. Cohen and Greenberg 1985, "The hemi-cube", eq. 1, gathered by Jacobi iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, Scene
from ..sky import SKY_BINS, bin_radiance
from .gather import DeviceRows, gather
from .patches import Patches

MAX_ITERATIONS = 2000
MAX_ALBEDO = 0.999


@dataclass(frozen=True, eq=False)
class Radiosity:
    """Steady light on the patches.

    radiosity (P, 3), W·m⁻²: reflected plus exitance tagged `input`; irradiance (P, 3), W·m⁻², total incident.
    light (P + SKY_BINS + 1, 3): what form-factor columns carry to a receiver (π L for sky bins, 0 for absorbed).
    iterations, residual: of the solver. energy_residual: |power in - power out| / power in, worst colour: in are
    exitance, direct light and sky, out is what patches absorb and what leaves through the sky or black backs.
    """

    radiosity: F64
    irradiance: F64
    light: F64
    iterations: int
    residual: float
    energy_residual: float


def solve(scene: Scene, p: Patches, rows: DeviceRows, direct: F64, tolerance: float) -> Radiosity:
    """Iterate until the largest change is below `tolerance` × the largest source.

    direct: (P, 3) irradiance of engine lights. Raises ValueError if an albedo reaches 0.999 (the iteration would need
    thousands of steps, failure-catalogue B1), or if MAX_ITERATIONS do not reach the tolerance.
    """
    worst = float(p.albedo.max(initial=0.0))
    if worst >= MAX_ALBEDO - 1e-9:  # patches hold rounded means
        raise ValueError(
            f"largest patch albedo must be under {MAX_ALBEDO} for the radiosity to converge, got {worst:.4f}"
        )
    sky = np.pi * bin_radiance(scene.sky)
    engine_sky = scene.sky is not None and scene.sky.engine_lit
    b = p.exitance + p.albedo * direct
    scale = max(float((p.exitance + direct).max(initial=0.0)), float(sky.max(initial=0.0)), 1e-30)
    residual, iterations, incident = np.inf, 0, direct
    while residual > tolerance and iterations < MAX_ITERATIONS:
        gathered = gather(rows, np.concatenate([b, sky, np.zeros((1, 3))]))[:, 0].astype(np.float64)
        incident = direct + gathered
        updated = p.exitance + p.albedo * incident
        residual = float(np.abs(updated - b).max(initial=0.0)) / scale
        b, iterations = updated, iterations + 1
    if residual > tolerance:
        raise ValueError(
            f"radiosity.tolerance {tolerance:g} not reached in {MAX_ITERATIONS} iterations (residual {residual:.2g}): the "
            f"largest albedo, {worst:.4f}, is too high for a scene this closed"
        )
    seen_sky = np.zeros_like(sky) if engine_sky else sky
    return Radiosity(
        radiosity=b,
        irradiance=incident,
        light=np.concatenate([b, seen_sky, np.zeros((1, 3))]),
        iterations=iterations,
        residual=residual,
        energy_residual=_energy_residual(p, rows, b, direct, sky),
    )


def _energy_residual(p: Patches, rows: DeviceRows, b: F64, direct: F64, sky: F64) -> float:
    """Energy balance. With B = M + ρH and rows that sum to one, in - out = Σ A B (1 - escaping) - Σ A (F B): the power
    patches send to patches less the power they gather from them, which only reciprocal form factors make equal."""
    empty = np.zeros((p.count, 3))
    nothing = np.zeros((SKY_BINS + 1, 3))
    gathered = p.area @ gather(rows, np.concatenate([b, nothing]))[:, 0].astype(np.float64)
    kept = gather(rows, np.concatenate([np.ones((p.count, 3)), nothing]))[:, 0].astype(np.float64)
    sent = p.area @ (b * kept)
    from_sky = gather(rows, np.concatenate([empty, sky, np.zeros((1, 3))]))[:, 0].astype(np.float64)
    power_in = p.area @ (p.exitance + direct + from_sky)
    lit = power_in > 0.0
    return float((np.abs(sent - gathered)[lit] / power_in[lit]).max(initial=0.0))
