"""Form factors from any receiver to patches and sky: rays, then a compressed row per receiver.

    patch:  F_ij ≈ n_ij / N for cosine-distributed rays from stratified points of the patch
    probe:  c_j,lm ≈ 4π/N Σ Y_lm(ω) over uniform rays that meet j; radiance SH = Σ_j c_j,lm B_j/π

Columns: P patches (backs of two-sided ones included), then the sky's bins, then one column for rays that end on a
black back or inside a closed mesh. Rows therefore always sum to one (patches), or to ∫Y dω (probes). Sums run in a
fixed order: the result depends on neither batch size nor threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

from ..datatypes import F32, F64, I32, I64, Bool
from ..directions import cosine_hemisphere, fibonacci_sphere, frames, random_rotations, rotate, rotations, sobol
from ..progress import Progress
from ..sh import COEFFICIENTS, basis
from ..sky import SKY_BINS, bin_of
from ..visibility import Geometry, cast, to_box, vectors
from .elements import element_of
from .patches import Patches, surface_samples

RAYS_PER_BATCH = 1 << 21


@dataclass(frozen=True, eq=False)
class FormFactors:
    """Compressed rows. indptr (R + 1,) i64, columns (nnz,) i32, values (nnz, K) f32; K = 1 for patches, 4 for probes.

    patches, sky, absorbed: number of patch columns, then SKY_BINS sky columns, then one absorbing column.
    back_share (R,) f64: share of the receiver's rays that met the inside of something. rays: rays per receiver.
    """

    indptr: I64
    columns: I32
    values: F32
    patches: int
    back_share: F64
    rays: int

    @property
    def rows(self) -> int:
        """Number of receivers."""
        return len(self.indptr) - 1

    @property
    def bytes(self) -> int:
        """Size of the matrix."""
        return self.indptr.nbytes + self.columns.nbytes + self.values.nbytes

    def matrix(self, k: int = 0) -> sparse.csr_array:
        """Component `k` as a SciPy CSR array (rows, patches + SKY_BINS + 1): the plain twin of every product."""
        shape = (self.rows, self.patches + SKY_BINS + 1)
        return sparse.csr_array((self.values[:, k], self.columns, self.indptr), shape=shape)


def patch_form_factors(g: Geometry, p: Patches, rays: int, seed: int, progress: Progress) -> FormFactors:
    """Form factors from every patch, K = 1."""
    table = sobol(rays, 5, seed)
    offsets = rotations(p.count, 5, seed)

    def batch(rows: I64) -> tuple[I32, F32, F64]:
        xi = rotate(table[None], offsets[rows][:, None, :])
        points, normals = surface_samples(g, p, rows, xi[..., :3])
        points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
        directions = _turned(cosine_hemisphere(xi[..., 3:]).reshape(-1, 3), normals)
        columns, _ = hit_columns(g, p, points, normals, directions)
        columns = columns.reshape(len(rows), rays)
        weights = np.full((*columns.shape, 1), 1.0 / rays, dtype=np.float32)
        return columns, weights, (columns == p.count + SKY_BINS).mean(axis=1)

    return _rows(p, p.count, rays, batch, progress, "form factors of patches")


def probe_form_factors(
    g: Geometry, p: Patches, positions: F64, rays: int, seed: int, progress: Progress
) -> FormFactors:
    """SH form factors of probes at `positions` (R, 3) m, K = 4: rotated Fibonacci directions, a rotation per probe."""
    lattice = fibonacci_sphere(rays)
    turns = random_rotations(len(positions), seed)

    def batch(rows: I64) -> tuple[I32, F32, F64]:
        directions = np.einsum("nij,kj->nki", turns[rows], lattice)
        origins = np.repeat(positions[rows], rays, axis=0)
        columns, back = hit_columns(g, p, origins, None, directions.reshape(-1, 3))
        columns = columns.reshape(len(rows), rays)
        weights = (basis(directions) * (4.0 / rays)).astype(np.float32)  # 4π/N · 1/π
        return columns, weights, back.reshape(columns.shape).mean(axis=1)

    return _rows(p, len(positions), rays, batch, progress, "form factors of probes")


def point_form_factors(
    g: Geometry, p: Patches, positions: F64, normals: F64, rays: int, seed: int, progress: Progress
) -> FormFactors:
    """Form factors of surface elements at `positions` (R, 3) m with unit `normals` (R, 3), K = 1."""
    table = sobol(rays, 2, seed)
    offsets = rotations(len(positions), 2, seed)

    def batch(rows: I64) -> tuple[I32, F32, F64]:
        local = cosine_hemisphere(rotate(table[None], offsets[rows][:, None, :])).reshape(-1, 3)
        normal = np.repeat(normals[rows], rays, axis=0)
        columns, back = hit_columns(g, p, np.repeat(positions[rows], rays, axis=0), normal, _turned(local, normal))
        weights = np.full((len(rows), rays, 1), 1.0 / rays, dtype=np.float32)
        return columns.reshape(len(rows), rays), weights, back.reshape(len(rows), rays).mean(axis=1)

    return _rows(p, len(positions), rays, batch, progress, "form factors of points")


def _turned(local: F64, normals: F64) -> F64:
    """Directions (N, 3) about +z turned to be about `normals` (N, 3)."""
    tangent, bitangent = frames(normals)
    return np.asarray(local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * normals)


def hit_columns(g: Geometry, p: Patches, origins: F64, normals: F64 | None, directions: F64) -> tuple[I32, Bool]:
    """Column (N,) each ray ends in, and whether it met the inside of something."""
    hits = cast(g, to_box(g, origins, normals), vectors(directions))
    found, front = np.array(hits.hit), np.array(hits.front)
    columns = np.full(len(found), p.count + SKY_BINS, dtype=np.int32)
    columns[~found] = p.count + bin_of(directions[~found])
    triangle = np.array(hits.triangle).astype(np.int64)[found]
    u, v = np.array(hits.u)[found].astype(np.float64), np.array(hits.v)[found].astype(np.float64)
    element = element_of(p.cuts, p.first_element, triangle, u, v)
    patch = np.where(front[found], p.element_patch[element], p.element_back[element])
    columns[found] = np.where(patch >= 0, patch, p.count + SKY_BINS)
    back = np.zeros(len(found), dtype=np.bool_)
    back[found] = ~front[found] & g.counts_as_back[triangle]
    return columns, back


def _rows(
    p: Patches,
    count: int,
    rays: int,
    batch: Callable[[I64], tuple[I32, F32, F64]],
    progress: Progress,
    stage: str,
) -> FormFactors:
    step = max(1, RAYS_PER_BATCH // rays)
    lengths, columns, values, back = [], [], [], []
    for begin in range(0, count, step):
        rows = np.arange(begin, min(begin + step, count))
        c, w, b = batch(rows)
        length, column, value = compress(c, w)
        lengths.append(length)
        columns.append(column)
        values.append(value)
        back.append(b)
        progress(stage, int(rows[-1]) + 1, count)
    k = COEFFICIENTS if not values else values[0].shape[1]
    indptr = np.concatenate([[0], np.cumsum(np.concatenate(lengths))]) if lengths else np.zeros(1)
    return FormFactors(
        indptr.astype(np.int64),
        np.concatenate(columns) if columns else np.zeros(0, np.int32),
        np.concatenate(values) if values else np.zeros((0, k), np.float32),
        p.count,
        np.concatenate(back) if back else np.zeros(0),
        rays,
    )


def compress(columns: I32, weights: npt.NDArray[np.floating]) -> tuple[I64, I32, F32]:
    """Sum the weights (R, N, K) of equal columns (R, N) within each row.

    Returns entries per row (R,), columns (nnz,) ascending within a row, values (nnz, K).
    """
    order = np.argsort(columns, axis=1, kind="stable")
    sorted_columns = np.take_along_axis(columns, order, axis=1)
    first = np.ones(columns.shape, dtype=np.bool_)
    first[:, 1:] = sorted_columns[:, 1:] != sorted_columns[:, :-1]
    starts = np.flatnonzero(first)
    sorted_weights = np.take_along_axis(weights, order[..., None], axis=1).reshape(-1, weights.shape[-1])
    values = np.add.reduceat(sorted_weights.astype(np.float64), starts, axis=0).astype(np.float32)
    return first.sum(axis=1).astype(np.int64), sorted_columns.ravel()[starts], values
