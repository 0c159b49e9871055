"""What all radiosity solvers share: the linear system, a method as data, and the solution with its history.

    B = S + diag(ρ) F B,   M = diag(ρ) F,   residual r = S + M B - B

for three colours at once. A method owns no numbers of a run: `prepare` turns it and a system into a `Sweep` that moves
light from the residual into the radiosity (diffrax's way of a solver as data).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I64
from ..sky import SKY_BINS
from .form_factors import FormFactors
from .gather import DeviceRows, gather


@dataclass(frozen=True, eq=False)
class System:
    """B = S + ρ F B.

    product: F times light, (P, 3) -> (P, 3). albedo ρ (P, 3) in [0, 1), source S (P, 3) W·m⁻², area (P,) m².
    matrix: F as CSR (P, P) f64, or None where only the product is at hand; methods that walk single rows or columns
    need it. Raises ValueError for wrong shapes, albedo outside [0, 1), light that is not finite, areas that are not > 0.
    """

    product: Callable[[F64], F64 | F32]
    albedo: F64
    source: F64
    area: F64
    matrix: sparse.csr_array | None = None

    def __post_init__(self) -> None:
        p = len(self.area)
        for name, value in (("albedo", self.albedo), ("source", self.source)):
            if value.shape != (p, 3):
                raise ValueError(f"{name} must have the shape {(p, 3)}, got {value.shape}")
        if self.matrix is not None and self.matrix.shape != (p, p):
            raise ValueError(f"matrix must have the shape {(p, p)}, got {self.matrix.shape}")
        if not np.isfinite(self.source).all():
            row = int(np.flatnonzero(~np.isfinite(self.source).all(axis=1))[0])
            raise ValueError(f"source must be finite, got {self.source[row]} at patch {row}")
        if not ((self.albedo >= 0.0) & (self.albedo < 1.0)).all():  # NaN fails both
            raise ValueError(f"albedo must lie in [0, 1), got {self.albedo.min():.4g} … {self.albedo.max():.4g}")
        if not (self.area > 0.0).all():
            raise ValueError(f"area must be > 0, got {self.area.min():.4g}")

    @property
    def patches(self) -> int:
        """P."""
        return len(self.area)

    def reflected(self, light: F64) -> F64:
        """M B: what patches reflect of the radiosity `light` (P, 3), W·m⁻²."""
        return np.asarray(self.albedo * self.product(light), dtype=np.float64)

    def rows(self, method: str) -> sparse.csr_array:
        """The matrix; ValueError if `method` needs it and there is none."""
        if self.matrix is None:
            raise ValueError(f"method {method} walks single rows of F and needs the matrix, got a product only")
        return self.matrix


def matrix_system(rows: FormFactors | sparse.csr_array, albedo: F64, source: F64, area: F64) -> System:
    """System on the host in double precision. rows: form factors, or CSR (P, P or more); columns after P carry no patch."""
    p = len(area)
    full = rows.matrix(0) if isinstance(rows, FormFactors) else rows
    matrix = full[:, :p].astype(np.float64).tocsr()
    return System(lambda light: matrix @ light, albedo, source, area, matrix)


def device_system(rows: DeviceRows, albedo: F64, source: F64, area: F64, host: FormFactors | None = None) -> System:
    """System whose products run on the device, in single precision: relative error about 1e-7 each.

    host: the same rows, for methods that walk single ones.
    """
    outside = np.zeros((SKY_BINS + 1, 3))  # sky and absorbed columns: their light is part of the source

    def product(light: F64) -> F32:
        return gather(rows, np.concatenate([light, outside]))[:, 0]

    matrix = None if host is None else host.matrix(0)[:, : len(area)].astype(np.float64).tocsr()
    return System(product, albedo, source, area, matrix)


class Sweep(Protocol):
    """One pass of a method: changes radiosity b and residual r, both (P, 3) f64, in place; returns row operations."""

    def __call__(self, b: F64, r: F64) -> int: ...


class Method(Protocol):
    """A way to solve a system, as data."""

    @property
    def name(self) -> str:
        """As settings and reports call it."""
        ...

    def prepare(self, system: System) -> Sweep:
        """Do once what depends on F and ρ alone. Raises ValueError if the system lacks what the method needs."""
        ...


@dataclass(frozen=True, eq=False)
class History:
    """How the residual fell: one entry before the first sweep and one after each.

    row_operations (N,) i64: rows of F gathered, or columns shot, so far. milliseconds (N,) f64, preparation included.
    residual (N,) f64: share of the source that is not passed on yet, worst colour (`solvers.Unshot`).
    """

    row_operations: I64
    milliseconds: F64
    residual: F64


@dataclass(frozen=True, eq=False)
class Solution:
    """radiosity (P, 3) W·m⁻² and how it was reached. residual as in `History`; iterations: row operations over P, rounded
    up (sweeps, for all but Southwell); seconds: preparation and sweeps."""

    radiosity: F64
    residual: float
    iterations: int
    row_operations: int
    seconds: float
    history: History
