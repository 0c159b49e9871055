"""What culling does to the error at sample points, under every single patch and under random lightings, all at once.

    E = W F B,   W (N, K R): what points read of probes' SH for their normals,   F (K R, C): form factors,   B: radiosity
    e² = mean over points of (E - R_a)(E - R_b),   R_a, R_b: light gathered by the points' own rays, two independent halves

so that the reference's noise cancels. Culling replaces F by G F (`culling.replaced`); with D = W (G - I) F

    Δe² = mean over points of D (2 E - R_a - R_b + D),   raise = √(1 + Δe²/e²) - 1

Single patches are columns of F; what 64 of their rays say about e² is shared with their cluster.

D is a sum over culled probes, and so is Δe²: probe i's part in Δe²_j is the mean over points of D_ij (2 E - R_a - R_b + D)_j. Where a
patch j gets worse than asked, `blame` says whose parts these are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I32, I64
from .lightings import noticed

TINY = np.finfo(np.float64).tiny
ROWS_AT_ONCE = 32
OWN_SHARE = 0.5  # of a column's own error in what is used for it; the rest is its cluster's
_Matrix = F32 | F64 | sparse.csr_array


@dataclass(frozen=True)
class Verdict:
    """Odds that culling raises the error by more than the target: over: with a single patch lit, half the time drawn by the light
    it sends, half evenly; lit_over: under one of the random lightings. worst: largest raise under those. own: raise under the
    scene's expected light."""

    over: float
    lit_over: float
    worst: float
    own: float


@dataclass(frozen=True, eq=False)
class Blame:
    """Of J single patches. excess (J,): of Δe² over what is allowed, as a share of that. parts (R, J) csc: of each probe in Δe², in the
    same unit."""

    excess: F64
    parts: sparse.csc_array


@dataclass(frozen=True, eq=False)
class Stage:
    """Points, probes and light. reading (N, R): weights of points on probes; normal_weights (N, K), see `sh.irradiance_weights`.
    factors (K R, C): F, see `stacked`. halves: two (N, C) matrices of the points' own form factors. lightings (C, m); expected
    (C,) light. cluster (C,) of each column."""

    reading: sparse.csr_array
    normal_weights: F64
    factors: sparse.csr_array
    halves: tuple[sparse.csr_array, sparse.csr_array]
    lightings: F64
    expected: F64
    cluster: I64


class Judge:
    """Judges replacements. seen (C,): light that points get from each column; square (C,): e² of columns where they are noticed,
    else infinite."""

    def __init__(self, stage: Stage) -> None:
        self._n, self._r = stage.reading.shape
        reading = stage.reading.astype(np.float32)
        weights = stage.normal_weights.astype(np.float32)
        self._read = [sparse.diags_array(weights[:, k]) @ reading for k in range(weights.shape[1])]
        self._factors = stage.factors
        a, b = stage.halves
        self.seen = np.asarray(a.sum(axis=0) + b.sum(axis=0)).ravel() / (2.0 * self._n)
        light = np.concatenate([stage.lightings, stage.expected[:, None]], axis=1).astype(np.float32)
        self._lit = np.asarray(self._factors @ light)
        every = sparse.hstack(self._read, format="csr")
        self._error, squares = _errors((every @ self._factors).tocsr(), a, b)
        self._lit_error, self._lit_square = _errors(every @ self._lit, a @ light, b @ light)
        self.square = self._shared(squares, stage.cluster)
        known = np.isfinite(self.square)
        self._odds = np.where(
            known, 0.5 * self.seen / max(self.seen[known].sum(), TINY) + 0.5 / max(known.sum(), 1), 0.0
        )

    def _shared(self, squares: F64, cluster: I64) -> F64:
        """Squared errors of columns, half their own, half what their cluster has per squared light."""
        count, seen2 = int(cluster.max()) + 1, self.seen**2
        rate: F64 = np.bincount(cluster, np.maximum(squares, 0.0), count).astype(np.float64)
        rate /= np.maximum(np.bincount(cluster, seen2, count), TINY)
        shared = OWN_SHARE * np.maximum(squares, 0.0) + (1.0 - OWN_SHARE) * rate[cluster] * seen2
        return np.where(noticed(self.seen) & (shared > 0.0), shared, np.inf)

    def __call__(self, replace: sparse.csr_array, target: float) -> Verdict:
        """What G = `replace` (R, R) does."""
        moved = self._moved(self._less_itself(replace))
        raises = raised(_change((moved @ self._factors).tocsr(), self._error) / self.square)
        lit = np.asarray(moved @ self._lit)
        lit_change = np.mean(lit * (2.0 * self._lit_error + lit), axis=0, dtype=np.float64)
        positive = self._lit_square > 0.0  # under its own noise a raise has no meaning
        lit_raises = np.where(positive, raised(lit_change / np.where(positive, self._lit_square, 1.0)), 0.0)
        over = float(self._odds[raises > target].sum())
        random = lit_raises[:-1]
        lit_over = float((random > target).mean()) if len(random) else 0.0
        return Verdict(over, lit_over, float(random.max(initial=0.0)), float(lit_raises[-1]))

    def blame(self, replace: sparse.csr_array, target: float) -> Blame:
        """Single patches under which G = `replace` (R, R) raises the error by more than `target`, and who is to blame."""
        change = self._less_itself(replace)
        moved = (self._moved(change) @ self._factors).tocsr()
        growth = _change(moved, self._error) / (((1.0 + target) ** 2 - 1.0) * self.square)
        over = np.flatnonzero(growth > 1.0)
        here = moved[:, over].toarray()
        terms = (2.0 * self._error[:, over] + here) / (self._n * ((1.0 + target) ** 2 - 1.0) * self.square[over])
        factors = self._factors[:, over].tocsr()
        parts = sparse.csr_array((self._r, len(over)))
        for k, read in enumerate(self._read):
            of_probes = (change @ factors[k * self._r : (k + 1) * self._r]).tocsr()
            parts = parts + of_probes.multiply(read.T @ terms)
        return Blame(growth[over] - 1.0, sparse.csc_array(parts))

    def _less_itself(self, replace: sparse.csr_array) -> sparse.csr_array:
        """G - I, (R, R) f32."""
        return (replace - sparse.eye_array(self._r, format="csr")).astype(np.float32).tocsr()

    def _moved(self, change: sparse.csr_array) -> sparse.csr_array:
        """W (G - I), (N, K R)."""
        return sparse.hstack([read @ change for read in self._read], format="csr")


def stacked(values: F32, indptr: I64, columns: I32, count: int) -> sparse.csr_array:
    """F (K R, count) from rows of entries `values` (nnz, K) in `columns` (nnz,): first all rows of the first coefficient."""
    nnz, k = values.shape
    ends = np.concatenate([indptr[:-1] + i * nnz for i in range(k)] + [[k * nnz]])
    data = np.ascontiguousarray(values.T).ravel()
    return sparse.csr_array((data, np.tile(columns, k), ends), shape=(k * (len(indptr) - 1), count))


def raised(change: F64) -> F64:
    """√(1 + Δe²/e²) - 1."""
    return np.asarray(np.sqrt(np.maximum(1.0 + change, 0.0)) - 1.0)


def _errors(ours: _Matrix, a: _Matrix, b: _Matrix) -> tuple[F32, F64]:
    """Error (N, C) against both halves together, and mean of its squares (C,), in which the halves' noise cancels.

    Some rows at a time, which fit the caches: that takes a third of the time, and one dense matrix is made instead of six."""
    error, square = np.empty(ours.shape, dtype=np.float32), np.zeros(ours.shape[1])
    for begin in range(0, len(error), ROWS_AT_ONCE):
        part = slice(begin, begin + ROWS_AT_ONCE)
        less_a, less_b = (_dense(ours, part) - _dense(half, part) for half in (a, b))
        square += np.sum(less_a * less_b, axis=0, dtype=np.float64)
        error[part] = 0.5 * (less_a + less_b)
    return error, square / max(len(error), 1)


def _dense(matrix: _Matrix, part: slice) -> F64:
    """Rows of a matrix, dense or sparse, in double precision."""
    rows = matrix[part]
    return np.asarray(rows.toarray() if sparse.issparse(rows) else rows, dtype=np.float64)


def _change(d: sparse.csr_array, error: F32) -> F64:
    """Mean over points of D (2 error + D), (C,), for sparse D (N, C)."""
    row = np.repeat(np.arange(d.shape[0]), np.diff(d.indptr))
    terms = d.data * (2.0 * error[row, d.indices] + d.data)
    return np.bincount(d.indices, terms, d.shape[1]) / d.shape[0]
