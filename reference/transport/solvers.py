"""Radiosity solvers behind one interface: Jacobi, Gauss-Seidel, Southwell, and one bounce an update with feedback.

    Jacobi        B += r,                 r <- M r              gathers; one bounce a sweep
    Gauss-Seidel  B += d, (1 - L) d = r,  r <- U d              M = L + U, L lower with the diagonal
    Southwell     B_i += d, d = r_i / (1 - M_ii), r += M_:i d   i: largest A_i Σ|r_i| of the three colours
    one bounce    B <- S + M B                                  r: the last change, all that a frame knows

Cohen, Chen, Wallace and Greenberg 1988, "A progressive refinement approach to fast radiosity image generation" (shooting
is Southwell relaxation: Gortler, Cohen and Slusallek 1994, "Radiosity and relaxation methods"). Jacobi and Gauss-Seidel
carry the residual instead of computing it anew, so it falls as far as asked for in single precision too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..datatypes import F64
from .solver_types import History, Method, Solution, Sweep, System
from .spectral import Spectrum, bounce_count, estimate_spectrum, refuse_slow

PATIENCE = 10  # times the row operations that the spectral radius lets expect


@dataclass(frozen=True)
class Jacobi:
    """Every patch gathers from all others at once."""

    name: str = "jacobi"

    def prepare(self, system: System) -> Sweep:
        """Nothing to prepare."""

        def sweep(b: F64, r: F64) -> int:
            b += r
            r[:] = system.reflected(r)
            return system.patches

        return sweep


@dataclass(frozen=True)
class GaussSeidel:
    """Patches gather one after the other and use what the earlier ones have just got."""

    name: str = "gauss-seidel"

    def prepare(self, system: System) -> Sweep:
        """Per colour, 1 - L as its own triangular factor: SuperLU in natural order has no fill and solves in C."""
        matrix = system.rows(self.name)
        upper = sparse.csr_array(sparse.triu(matrix, 1))
        lower, unit = sparse.tril(matrix), sparse.eye_array(system.patches)
        albedos, same = np.unique(system.albedo, axis=1, return_inverse=True)
        colours = [np.flatnonzero(same.ravel() == k) for k in range(albedos.shape[1])]
        factors = [
            splu(sparse.csc_array(unit - sparse.diags_array(rho) @ lower), permc_spec="NATURAL", diag_pivot_thresh=0.0)
            for rho in albedos.T
        ]

        def sweep(b: F64, r: F64) -> int:
            step = np.empty_like(r)
            for factor, c in zip(factors, colours, strict=True):
                step[:, c] = factor.solve(r[:, c])
            b += step
            r[:] = system.albedo * (upper @ step)
            return system.patches

        return sweep


@dataclass(frozen=True)
class Southwell:
    """Progressive refinement: the patch with the most unshot power shoots, column by column."""

    name: str = "southwell"

    def prepare(self, system: System) -> Sweep:
        """The columns of F, once. A sweep is P/8 shots."""
        columns = sparse.csc_array(system.rows(self.name))
        pointers, row, value = columns.indptr, columns.indices, columns.data
        albedo, area, colours = system.albedo, system.area, np.ones(3)
        kept = 1.0 - albedo * columns.diagonal()[:, None]
        shots = max(1, system.patches // 8)

        def sweep(b: F64, r: F64) -> int:
            unshot = area * (np.abs(r) @ colours)
            for shot in range(shots):
                i = int(unshot.argmax())
                if unshot[i] == 0.0:
                    return shot
                step = r[i] / kept[i]
                b[i] += step
                part = slice(pointers[i], pointers[i + 1])
                j = row[part]
                received = r.take(j, axis=0) + albedo.take(j, axis=0) * (value[part, None] * step)
                r[j] = received
                unshot[j] = area.take(j) * (np.abs(received) @ colours)
                r[i] = unshot[i] = 0.0
            return shots

        return sweep


@dataclass(frozen=True)
class TemporalFeedback:
    """The run-time mode under light that stands still: `OneBounce` frame by frame."""

    name: str = "one-bounce"

    def prepare(self, system: System) -> Sweep:
        """Nothing to prepare."""

        def sweep(b: F64, r: F64) -> int:
            after = one_bounce(system, b, system.source)
            r[:] = after - b
            b[:] = after
            return system.patches

        return sweep


def one_bounce(system: System, radiosity: F64, source: F64) -> F64:
    """S + M B (P, 3), W·m⁻²."""
    return np.asarray(source + system.reflected(radiosity))


class OneBounce:
    """One bounce an update with temporal feedback: B_t = S_t + M B_{t-1}. The state lives from frame to frame.

    radiosity (P, 3) W·m⁻²: of the last update, zero before the first. After a step of light the error falls by the
    spectral radius per update: `bounce_count(radius, 0.01)` updates to one per cent.
    """

    def __init__(self, system: System, radiosity: F64 | None = None) -> None:
        self._system = system
        self.radiosity: F64 = np.zeros_like(system.source) if radiosity is None else radiosity.astype(np.float64)

    def step(self, source: F64 | None = None) -> F64:
        """One update under `source` (P, 3), W·m⁻², of this frame (the system's own by default); returns the radiosity."""
        light = self._system.source if source is None else source
        if light.shape != self.radiosity.shape:
            raise ValueError(f"source must have the shape {self.radiosity.shape}, got {light.shape}")
        self.radiosity = one_bounce(self._system, self.radiosity, light)
        return self.radiosity


class Unshot:
    """The residual as one number: how much of the source has not been passed on yet, in the worst colour.

    The larger of the share of power, Σ A |r| / Σ A S, and the share of the peak, max |r| / max S: a small bright lamp has a
    peak beside which the whole room is dark, and a small patch has no power beside the room. Where a start leaves a first
    residual above the source (lamps that went out), that is the measure.
    """

    def __init__(self, system: System, first: F64) -> None:
        self._area = system.area
        self._scale = np.maximum(self._sizes(system.source), self._sizes(first))
        self._scale[self._scale == 0.0] = 1.0

    def _sizes(self, light: F64) -> F64:
        """Power and peak (2, 3) of `light` (P, 3)."""
        size = np.abs(light)
        return np.stack([self._area @ size, size.max(axis=0, initial=0.0)])

    def __call__(self, r: F64) -> float:
        """Share of residual `r` (P, 3)."""
        return float((self._sizes(r) / self._scale).max())


JACOBI: Method = Jacobi()
METHODS: Mapping[str, Method] = MappingProxyType(
    {m.name: m for m in (JACOBI, GaussSeidel(), Southwell(), TemporalFeedback())}
)


def solve(
    system: System,
    method: Method = JACOBI,
    tolerance: float = 1e-6,
    start: F64 | None = None,
    spectrum: Spectrum | None = None,
) -> Solution:
    """Sweep until at most `tolerance` of the source is `Unshot`.

    start: radiosity (P, 3) to begin with, e.g. of the last lighting. spectrum: of this system if it is known already (it
    does not depend on the source); its estimation is not part of `seconds`. Raises ValueError if the spectral radius is
    not under 0.999, or if the tolerance is not reached within ten times the row operations that the radius lets expect.
    """
    spectrum = spectrum or estimate_spectrum(system)
    refuse_slow(system, spectrum)
    expected = bounce_count(spectrum.upper, min(tolerance, 0.5) / spectrum.spread) + 1
    began = time.perf_counter()
    sweep = method.prepare(system)
    b = np.zeros_like(system.source) if start is None else start.astype(np.float64)
    r = system.source.astype(np.float64) if start is None else system.source + system.reflected(b) - b
    unshot = Unshot(system, r)
    operations, limit = 0, PATIENCE * expected * system.patches
    history = [(0, time.perf_counter() - began, unshot(r))]
    while not history[-1][2] <= tolerance:  # NaN goes on to the limit, and is refused there
        if operations >= limit:
            raise ValueError(
                f"tolerance {tolerance:g} not reached by {method.name} in {operations // system.patches} iterations "
                f"(residual {history[-1][2]:.2g}, spectral radius {spectrum.upper:.4f}): ask for less, or lower the albedo"
            )
        operations += sweep(b, r)
        history.append((operations, time.perf_counter() - began, unshot(r)))
    counts, seconds, residuals = (np.array(column) for column in zip(*history, strict=True))
    return Solution(
        b, history[-1][2], -(-operations // max(1, system.patches)), operations, history[-1][1],
        History(counts, 1e3 * seconds, residuals),
    )  # fmt: skip
