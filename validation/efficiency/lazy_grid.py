"""Uniform grids of any fineness, baked only where they are read.

N points read at most 8 N probes of a grid, however many it has; the others change its cost, not its error. So a grid of a
million probes is measured for the price of a few thousand. It gets what an adaptive placement gets: probes that see back faces
have weight 0 and the rest is divided by the weight; where all eight are invalid, the grid of twice the spacing is asked. Only light
is not copied into dead edges, which changes no mean error that was measured (the sweep `copies` of every run).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import F64, I64, Bool, Scene
from ...reference.lattice import MAX_LEVEL, OCTANTS, Grid, cells, index_of, keys
from ...reference.progress import silent
from ...reference.sh import irradiance_weights
from ...reference.transport.form_factors import form_factors
from ...reference.transport.gather import gather, upload
from ...reference.transport.receivers import probe_receivers
from ...reference.truth.points import Points

CENSUS = 2048  # probes, drawn from all of the grid, that tell its valid share and its mean size of a row


@dataclass(frozen=True, eq=False)
class Lit:
    """Probes at lattice corners. key (R,) i64 sorted; light (R, 4, 3) radiance SH; valid (R,); entries: mean number of
    form factors in a row."""

    key: I64
    light: F64
    valid: Bool
    entries: float


@dataclass(frozen=True)
class GridSize:
    """What a whole uniform grid would cost. probes: all of them; valid_share, entries: estimated from CENSUS of them."""

    probes: int
    valid_share: float
    entries: float


def light_corners(
    scene: Scene, surfaces: pipeline.Surfaces, light: pipeline.PatchLight, grid: Grid, key: I64, seed: int
) -> Lit:
    """Form factors and light of the probes at corners `key` (R,) of a grid."""
    s, g = scene.settings.placement, surfaces.geometry
    positions = grid.corner_positions(cells(key))
    receivers = probe_receivers(g, positions)
    rays = pipeline.allocated(
        surfaces, receivers, s.probe_noise, s.probe_rays, seed + 3, pipeline.LEAST_PROBE_RAYS
    ).rays
    rows = form_factors(g, surfaces.patches, receivers, rays, seed + 3, silent, "uniform grid")
    found = gather(upload(rows), light.radiosity.light) + pipeline.punctual_input(scene, g, positions)
    valid = rows.back_share <= s.backface_tolerance
    return Lit(key, found.astype(np.float64), valid, len(rows.columns) / max(1, rows.rows))


def census(scene: Scene, surfaces: pipeline.Surfaces, light: pipeline.PatchLight, grid: Grid, seed: int) -> GridSize:
    """Cost of the whole grid."""
    _, upper = pipeline.probe_bounds(scene, surfaces.geometry)
    cover = np.ceil(
        (upper - grid.origin) / grid.finest - 1e-9
    )  # a grid that others lay needs no margin beyond the bounds
    count = int(np.prod(np.minimum(cover, grid.extent) + 1))
    rng = np.random.default_rng([seed, 41])
    drawn = np.unique(keys(np.stack([rng.integers(0, n + 1, CENSUS) for n in grid.extent], axis=1)))
    lit = light_corners(scene, surfaces, light, grid, drawn, seed)
    return GridSize(count, float(lit.valid.mean()), lit.entries)


def sample_grid(
    scene: Scene, surfaces: pipeline.Surfaces, light: pipeline.PatchLight, grid: Grid, points: Points,
    offsets: tuple[float, ...], seed: int,
) -> F64:  # fmt: skip
    """Irradiance (offsets, N, 3) at points lifted along their normals by each of `offsets`, in voxels."""
    lift = np.where(points.mesh >= 0, 1.0, 0.0)[:, None] * points.normals
    q = np.stack([(points.positions - grid.origin) / grid.finest + o * lift for o in offsets]).reshape(-1, 3)
    q = np.clip(q, 0.0, grid.extent)
    weights = np.tile(irradiance_weights(points.normals), (len(offsets), 1))
    out = np.zeros((len(q), 3))
    active = np.arange(len(q))
    for scale in 1 << np.arange(MAX_LEVEL + 1):
        corner, share = _corners(q[active], int(scale), grid)
        key = np.unique(keys(corner.reshape(-1, 3)))
        lit = light_corners(scene, surfaces, light, grid, key, seed)
        at = index_of(lit.key, keys(corner.reshape(-1, 3))).reshape(-1, 8)
        w = share * lit.valid[at]
        total = w.sum(axis=1)
        good = total >= 1.0 / 1024.0
        mixed = np.einsum("nc,nckd->nkd", w[good], lit.light[at[good]]) / total[good, None, None]
        out[active[good]] = np.einsum("nk,nkd->nd", weights[active[good]], mixed)
        active = active[~good]
        if not len(active) or scale >= int(grid.extent.max()):
            break
    return out.reshape(len(offsets), -1, 3)


def _corners(q: F64, scale: int, grid: Grid) -> tuple[I64, F64]:
    """The eight corners (N, 8, 3) of the voxels of `scale` finest voxels that hold `q` (N, 3), and their trilinear weights."""
    last = np.maximum((grid.extent + scale - 1) // scale - 1, 0)
    cell = np.minimum((q // scale).astype(np.int64), last)
    f = q / scale - cell
    share = np.prod(np.where(OCTANTS[None] == 1, f[:, None, :], 1.0 - f[:, None, :]), axis=2)
    return (cell[:, None, :] + OCTANTS[None]) * scale, share
