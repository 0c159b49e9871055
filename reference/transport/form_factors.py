"""Form factors from any receiver to patches and sky: rays, then a compressed row per receiver.

    patch, lumel, point:  F_ij ≈ n_ij / N for cosine-distributed rays
    probe:                c_j,lm ≈ 4π/N Σ Y_lm(ω) over uniform rays that meet j; radiance SH = Σ_j c_j,lm B_j/π
    cubemap texel:        n_j / (π N) for rays through the texel; radiance = Σ_j of it × B_j

Columns: P patches (backs of two-sided ones included), then the sky's bins, then one column for rays that end on a
black back or inside a closed mesh. Rows of patches therefore always sum to one.

The N rays of a receiver are M independent randomisations of N/M Owen-scrambled Sobol points. The spread of the M
results is the standard error (M - 1 degrees of freedom): no binomial guess, which stratified rays would not obey.
Sums run in a fixed order: the result depends on neither batch size nor threads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..datatypes import F32, F64, I32, I64
from ..device_arrays import drop_device_cache
from ..progress import Progress
from ..sh import Order
from ..sky import SKY_BINS
from ..visibility import Geometry
from .accumulate import Batch, collect_batch, finish_batch, prepare_batch, start_batch
from .hits import upload_patches
from .patches import Patches
from .receivers import Receivers, patch_receivers, point_receivers, probe_receivers

RAYS_PER_BATCH = 1 << 20
RAYS_PER_LAST_BATCH = 1 << 18
REPLICATES = 8


@dataclass(frozen=True, eq=False)
class FormFactors:
    """Compressed rows. indptr (R + 1,) i64, columns (nnz,) i32, values (nnz, K) f32; K = 4 for probes, 9 where they hold SH of
    order 2, else 1: an entry takes 4 + 4 K bytes in an update, and 4 K more here for `se`.

    patches: number of patch columns; SKY_BINS sky columns follow, then one absorbing column.
    back_share (R,) f64: share of the receiver's rays that met the inside of something. rays (R,) i64: rays per receiver.
    se (nnz, K) f32: standard error of each value, REPLICATES - 1 degrees of freedom; 0 where a closed form was used.
    """

    indptr: I64
    columns: I32
    values: F32
    patches: int
    back_share: F64
    rays: I64
    se: F32

    @property
    def rows(self) -> int:
        """Number of receivers."""
        return len(self.indptr) - 1

    @property
    def bytes(self) -> int:
        """Size of the matrix that an update reads (without the standard errors)."""
        return self.indptr.nbytes + self.columns.nbytes + self.values.nbytes

    @property
    def row_se(self) -> F64:
        """Root sum of squares of each row's standard errors, (R, K): the error of what it gathers per unit of light
        that differs from column to column at random."""
        squares = np.concatenate([np.zeros((1, self.se.shape[1])), np.cumsum(self.se.astype(np.float64) ** 2, axis=0)])
        return np.sqrt(np.maximum(squares[self.indptr[1:]] - squares[self.indptr[:-1]], 0.0))

    def matrix(self, k: int = 0) -> sparse.csr_array:
        """Component `k` as a SciPy CSR array (rows, patches + SKY_BINS + 1): the plain twin of every product."""
        shape = (self.rows, self.patches + SKY_BINS + 1)
        return sparse.csr_array((self.values[:, k], self.columns, self.indptr), shape=shape)


def patch_form_factors(g: Geometry, p: Patches, rays: int | I64, seed: int, progress: Progress) -> FormFactors:
    """Form factors from every patch, K = 1. rays: per patch, or (P,) of powers of two."""
    return form_factors(g, p, patch_receivers(g, p), rays, seed, progress, "form factors of patches")


def probe_form_factors(
    g: Geometry, p: Patches, positions: F64, rays: int | I64, seed: int, progress: Progress, order: Order = 1
) -> FormFactors:
    """SH form factors of probes at `positions` (R, 3) m, K = 4, of order 2 K = 9: the first four are then the same, bit for bit."""
    return form_factors(g, p, probe_receivers(g, positions, order), rays, seed, progress, "form factors of probes")


def point_form_factors(
    g: Geometry, p: Patches, positions: F64, normals: F64, rays: int, seed: int, progress: Progress
) -> FormFactors:
    """Form factors of surface elements at `positions` (R, 3) m with unit `normals` (R, 3), K = 1."""
    return form_factors(g, p, point_receivers(g, positions, normals), rays, seed, progress, "form factors of points")


def form_factors(
    g: Geometry, p: Patches, receivers: Receivers, rays: int | I64, seed: int, progress: Progress, stage: str
) -> FormFactors:
    """Rows of any receivers. rays: powers of two, at least 2 · REPLICATES.

    Raises ValueError for other ray counts.
    """
    counts = np.broadcast_to(np.asarray(rays, dtype=np.int64), (receivers.count,))
    bad = counts[(counts & (counts - 1) != 0) | (counts < 2 * REPLICATES)]
    if len(bad):
        raise ValueError(f"rays must be a power of two, at least {2 * REPLICATES}, got {bad[0]}")
    done: list[Batch] = []
    finished, device, pending = 0, upload_patches(g, p), None
    for rows, n in [*_batches(counts), (None, 0)]:
        # The next batch is drawn up while the last one is traced, and traced while that one is summed.
        upcoming = None if rows is None else prepare_batch(g, device, receivers, rows, n, REPLICATES, seed)
        traced = None if pending is None else collect_batch(pending)
        if upcoming is not None:
            start_batch(upcoming)
        if traced is not None:
            done.append(finish_batch(traced))
            finished += len(done[-1].rows)
            progress(stage, finished, receivers.count)
        pending = upcoming
    drop_device_cache()
    return _assembled(done, counts, p.count, receivers.components)


def _batches(counts: I64) -> list[tuple[I64 | None, int]]:
    """Rows with equal ray counts: half of what is left at a time, RAYS_PER_BATCH rays at most. So little is left to sum
    when there is nothing more to trace."""
    batches: list[tuple[I64 | None, int]] = []
    for n in np.unique(counts):
        rows, begin = np.flatnonzero(counts == n), 0
        most, least = (max(1, rays // int(n)) for rays in (RAYS_PER_BATCH, RAYS_PER_LAST_BATCH))
        while begin < len(rows):
            step = min(most, max(least, (len(rows) - begin) // 2))
            batches.append((rows[begin : begin + step], int(n)))
            begin += step
    return batches


def _assembled(batches: list[Batch], rays: I64, patches: int, k: int) -> FormFactors:
    """Batches in the order of their rows; each batch is dropped once copied, so that memory holds the rows once."""
    lengths, back = np.zeros(len(rays), dtype=np.int64), np.zeros(len(rays))
    for b in batches:
        lengths[b.rows], back[b.rows] = b.lengths, b.back_share
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    columns = np.empty(indptr[-1], dtype=np.int32)
    values, se = np.empty((indptr[-1], k), dtype=np.float32), np.empty((indptr[-1], k), dtype=np.float32)
    while batches:
        b = batches.pop()
        at: slice | I64 = slice(indptr[b.rows[0]], indptr[b.rows[-1] + 1])
        if b.rows[-1] - b.rows[0] + 1 != len(b.rows):  # not neighbours: other rows lie between
            shift = indptr[b.rows] - (np.cumsum(b.lengths) - b.lengths)
            at = np.repeat(shift, b.lengths) + np.arange(len(b.columns))
        columns[at], values[at], se[at] = b.columns, b.values, b.se
    return FormFactors(indptr, columns, values, patches, back, np.array(rays), se)
