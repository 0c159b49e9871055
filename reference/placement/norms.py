"""Norms of a difference of form-factor rows, as data: name, formula, and what each promises.

A row's difference ΔF has four SH coefficients per column (radiance per radiosity). Two sizes of one column's:

    |ΔF_j|²   = π/4 ΔF_j0² + π/9 (ΔF_j1² + ΔF_j2² + ΔF_j3²)         mean square of the irradiance it makes, over all normals
    sup|ΔF_j| = A0 Y0 |ΔF_j0| + A1 Y1 √(ΔF_j1² + ΔF_j2² + ΔF_j3²)    its largest irradiance at any normal

Rows are sparse, four neighbouring entries per column (4 j + k). Norms that predict take clusters of columns and subtract the
variance σ² that the rays put there (standard errors in quadrature); the one that bounds takes every column as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from ..datatypes import F64
from ..sh import COSINE_A0, COSINE_A1, Y0, Y1

SH = 4
MEAN_SQUARE = np.array([(COSINE_A0 * Y0) ** 2, *[(COSINE_A1 * Y1) ** 2 / 3.0] * 3])  # π/4, π/9, π/9, π/9


@dataclass(frozen=True, eq=False)
class Difference:
    """delta (n, 4 C) sparse: rows minus what would replace them. variance (n, 4 C) sparse: of delta, by rays, for norms that subtract
    it. weights (C,): what lightings are expected, per column: the mean radiosity μ for `power`, the weight w for `relative`."""

    delta: sparse.csr_array
    variance: sparse.csr_array | None
    weights: F64


@dataclass(frozen=True)
class Norm:
    """columns: what its columns are. of: sizes (n,) of differences, W·m⁻² per unit of the lighting that `promise` names."""

    name: str
    formula: str
    promise: str
    columns: Literal["clusters", "single"]
    of: Callable[[Difference], F64]


def _by_column(entries: sparse.csr_array, values: F64) -> sparse.csr_array:
    """`values` (nnz,) in the places of `entries` (n, 4 C), summed over the four coefficients: (n, C)."""
    n, width = entries.shape
    row = np.repeat(np.arange(n), np.diff(entries.indptr))
    return sparse.csr_array((values, (row, entries.indices // SH)), shape=(n, width // SH))


def mean_squares(d: Difference) -> sparse.csr_array:
    """|ΔF_j|² (n, C), unbiased: less its variance, so that it may be negative."""
    found = _by_column(d.delta, d.delta.data.astype(np.float64) ** 2 * MEAN_SQUARE[d.delta.indices % SH])
    if d.variance is None:
        return found
    noise = _by_column(d.variance, d.variance.data.astype(np.float64) * MEAN_SQUARE[d.variance.indices % SH])
    return (found - noise).tocsr()


def _summed(m: sparse.csr_array) -> F64:
    return np.asarray(m.sum(axis=1, dtype=np.float64)).ravel()


def l1(d: Difference) -> F64:
    """Σ_c √max(|ΔF_c|², 0)."""
    squares = mean_squares(d)
    squares.data = np.sqrt(np.maximum(squares.data, 0.0))
    return _summed(squares)


def l2(d: Difference) -> F64:
    """√max(Σ_c |ΔF_c|², 0)."""
    return np.sqrt(np.maximum(_summed(mean_squares(d)), 0.0))


def power(d: Difference) -> F64:
    """√max(|Σ_c μ_c ΔF_c|² + Σ_c μ_c² |ΔF_c|², 0)."""
    mu = d.weights
    each = np.kron(mu[:, None], np.eye(SH))  # (4 C, 4): the four coefficients under the mean light
    together = (d.delta @ each) ** 2
    if d.variance is not None:
        together -= d.variance @ (each**2)
    apart = mean_squares(d) @ (mu**2)
    return np.sqrt(np.maximum(together @ MEAN_SQUARE + apart, 0.0))


def worst(d: Difference) -> F64:
    """Σ_j sup|ΔF_j|."""
    values = d.delta.data.astype(np.float64)
    first = d.delta.indices % SH == 0
    directed = _by_column(d.delta, np.where(first, 0.0, values**2))
    directed.data = COSINE_A1 * Y1 * np.sqrt(directed.data)
    return _summed(_by_column(d.delta, np.where(first, COSINE_A0 * Y0 * np.abs(values), 0.0))) + _summed(directed)


def relative(d: Difference) -> F64:
    """√Σ_j w_j |ΔF_j|². In single precision but for the sums: it is asked for often."""
    each = np.kron(d.weights, MEAN_SQUARE).astype(np.float32)
    squares = sparse.csr_array(
        (d.delta.data**2 * each[d.delta.indices], d.delta.indices, d.delta.indptr), d.delta.shape
    )
    return np.sqrt(_summed(squares))


NORMS = {
    norm.name: norm
    for norm in (
        Norm("l1", "Σ_c √max(|ΔF_c|² - σ_c², 0)", "about the error where every cluster is as bright as 1 and no two cancel",
             "clusters", l1),
        Norm("l2", "√max(Σ_c |ΔF_c|² - σ_c², 0)", "root mean square error where clusters vary independently, variance 1",
             "clusters", l2),
        Norm("power", "√max(|Σ_c μ_c ΔF_c|² + Σ_c μ_c² |ΔF_c|² - σ², 0)",
             "root mean square error under light of mean μ whose clusters vary independently, as much as their mean",
             "clusters", power),
        Norm("worst", "Σ_j sup|ΔF_j|", "bound: no lighting with 0 ≤ B ≤ B_max has more error than this times B_max",
             "single", worst),
        Norm("relative", "√Σ_j w_j |ΔF_j|²", "root mean square error where one patch at a time shines, so brightly that the "
             "error that is there already is 1", "single", relative),
    )
}  # fmt: skip
