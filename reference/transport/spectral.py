"""Spectral radius of M = diag(ρ) F, and the number of bounces that follows from it.

For a non-negative matrix and any x > 0, min (M x)_i / x_i <= radius <= max (M x)_i / x_i (Collatz 1942; Wielandt 1950,
"Unzerlegbare, nicht negative Matrizen"). Power iteration on M + s closes that bracket; the shift s > 0 keeps two facing
plates, whose light swings to and fro, from keeping it open. What n bounces leave unsolved is at most radius^n of the
source in the norm max |r_i| / x_i, so n = ln tolerance / ln radius is known before any light moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..datatypes import F64
from .solver_types import System

MAX_RADIUS = 0.999
ROUNDING = 1e-6  # single-precision rows sum to one within this
MAX_PRODUCTS = 200
SETTLED = 1.05  # ratio of bounce counts, between the bounds or over PATIENCE products, that ends the iteration
PATIENCE = 4
SHIFT = 0.1  # of the first upper bound


@dataclass(frozen=True)
class Spectrum:
    """Spectral radius of the worst colour. lower <= radius <= upper; upper holds in any case and is what decides.

    colour: 0 red, 1 green, 2 blue. spread: max over min of the vector x that proves `upper`. products: of F, spent on it.
    """

    radius: float
    lower: float
    upper: float
    colour: int
    spread: float
    products: int


def estimate_spectrum(system: System) -> Spectrum:
    """Power iteration from x = ρ until the bracket settles the number of bounces, or does not narrow any more.

    Where the scene falls into parts that do not see each other, only the upper bound closes.
    """
    x = system.albedo.astype(np.float64)  # black rows are zero rows of M: without them the radius is the same
    lower, upper, shift = np.zeros(3), np.ones(3), np.zeros(3)
    past: list[F64] = []
    for products in range(1, MAX_PRODUCTS + 1):
        y = system.reflected(x)
        low, high = _bracket(x, y)
        lower, upper = np.maximum(lower, low), np.minimum(upper, high)
        shift = SHIFT * upper if products == 1 else shift
        past.append(upper)
        if _settled(lower, past) or products == MAX_PRODUCTS:
            break
        x = np.where(y > 0.0, y + shift * x, 0.0)  # a row that sees none of the others cannot carry the radius
        x /= np.maximum(x.max(axis=0, initial=0.0), 1e-300)
    worst = int(np.argmax(upper))
    seen = x[:, worst][x[:, worst] > 0.0]
    quotient = float((x[:, worst] @ y[:, worst]) / max(float(seen @ seen), 1e-300))
    radius = min(max(quotient, float(lower[worst])), float(upper[worst]))
    spread = float(seen.max() / seen.min()) if len(seen) else 1.0
    return Spectrum(radius, float(lower[worst]), float(upper[worst]), worst, spread, products)


def _bracket(x: F64, y: F64) -> tuple[F64, F64]:
    """Smallest and largest y_i / x_i (3,) over the rows with x_i > 0; (0, 0) without any."""
    on = x > 0.0
    ratio = np.divide(y, x, out=np.zeros_like(x), where=on)
    low = np.where(on, ratio, np.inf).min(axis=0, initial=np.inf)
    return np.where(np.isfinite(low), low, 0.0), ratio.max(axis=0, initial=0.0)


def _settled(lower: F64, past: list[F64]) -> bool:
    """Whether more products would change nothing that matters, in the worst colour."""
    worst = int(np.argmax(past[-1]))
    high, low = float(past[-1][worst]), float(lower[worst])
    if low < MAX_RADIUS - ROUNDING <= high:
        return False  # refusal hangs on it
    if _decay(low) <= SETTLED * _decay(high):
        return True
    return len(past) > PATIENCE and _decay(high) <= SETTLED * _decay(float(past[-1 - PATIENCE][worst]))


def _decay(radius: float) -> float:
    """-ln radius: what a bounce takes from the light, as an exponent; bounce counts go with its inverse."""
    return math.inf if radius == 0.0 else max(0.0, -math.log(radius))


def bounce_count(radius: float, tolerance: float) -> int:
    """Bounces after which at most `tolerance` of the source is left: ceil(ln tolerance / ln radius), at least 1.

    With tolerance 0.01 this is the lag, in updates, of one bounce an update behind a step of light (failure-catalogue B7).
    Raises ValueError for a radius outside [0, 1) or a tolerance outside (0, 1).
    """
    if not 0.0 <= radius < 1.0:
        raise ValueError(f"spectral radius must lie in [0, 1), got {radius:.6g}")
    if not 0.0 < tolerance < 1.0:
        raise ValueError(f"tolerance must lie in (0, 1), got {tolerance:g}")
    if radius == 0.0:
        return 1
    return max(1, math.ceil(math.log(tolerance) / math.log(radius) - 1e-9))


def refuse_slow(system: System, spectrum: Spectrum) -> None:
    """Raise ValueError for a radius that is not under MAX_RADIUS: the light would need thousands of bounces to die."""
    if spectrum.upper < MAX_RADIUS - ROUNDING:
        return
    colour = ("red", "green", "blue")[spectrum.colour]
    albedo = system.albedo[:, spectrum.colour]
    mean = float(system.area @ albedo / system.area.sum())
    raise ValueError(
        f"spectral radius of the bounces must be under {MAX_RADIUS} for the radiosity to converge, got {spectrum.upper:.4f} "
        f"in {colour} (albedo there: mean {mean:.4f}, largest {albedo.max():.4f}): lower the albedo of the brightest "
        f"materials, 0.95 is white paint, or open the scene"
    )
