"""Form factors for a reference: closed forms where provably nothing is in the way, shadow rays times closed forms elsewhere.

Every patch is cut into convex cells. A pair of cells whose shaft is empty gets its contour integral; one whose shaft a
single surface fills gets 0; the rest gets the contour integral times its visible share. Pairs are first judged by groups
of coplanar cells: what holds for the groups' outlines holds for all of their cells. Sky and absorbed columns keep their rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, I64, U32
from ..progress import Progress
from ..visibility import Geometry
from .closed_forms.cell_groups import group_codes
from .closed_forms.contour_batch import pair_form_factors
from .closed_forms.planar_cells import cell_areas, cells_and_faces, cells_of
from .closed_forms.polygon_clip import unit_normals
from .closed_forms.shaft import Blockers, build_blockers, classify
from .closed_forms.shaft_walk import BLOCKED, CLEAR, MIXED
from .flows import Flows, flows_of_rays
from .form_factors import FormFactors
from .patches import Patches
from .receivers import element_corners, patch_elements
from .reconcile import Reconciled, reconcile_flows
from .visible_share import upload_cells, visible_share

MAX_CELLS = 8000
PAIRS_PER_BATCH = 1 << 20
PILOT = 16
MOST = 1 << 16
NEAR = 0.02  # form factor from which on rays leave by the cosine too


@dataclass(frozen=True, eq=False)
class Cells:
    """Convex planar pieces of patches: corners (E, 4, 3) m, normals (E, 3), patch (E,) i64, ascending."""

    corners: F64
    normals: F64
    patch: I64


@dataclass(frozen=True, eq=False)
class Hybrid:
    """laws: the reconciled rows. clear, blocked, mixed: pairs of cells that face each other, by proof; rays: shadow rays."""

    laws: Reconciled
    clear: int
    blocked: int
    mixed: int
    rays: int


def patch_cells(g: Geometry, p: Patches) -> Cells:
    """Cells of all patches, backs included."""
    element, sign, patch = patch_elements(p)
    corners = element_corners(g, p.cuts, p.first_element, p.element_triangle[element], element)
    corners = np.where((sign < 0)[:, None, None], corners[:, ::-1], corners)
    # Corners are shared within a patch only, so that no cell reaches over two.
    named = np.column_stack([np.repeat(patch, 3), np.round((corners.reshape(-1, 3) - g.centre) / g.scale, 9)])
    _, first, faces = np.unique(named, axis=0, return_index=True, return_inverse=True)
    cells, face = cells_and_faces(corners.reshape(-1, 3)[first], faces.reshape(-1, 3).astype(np.int32))
    order = np.argsort(patch[face], kind="stable")
    return Cells(cells[order], unit_normals(cells[order]), patch[face][order])


def hybrid_form_factors(
    g: Geometry,
    p: Patches,
    raw: FormFactors,
    noise: float,
    seed: int,
    progress: Progress,
    cells: Cells | None = None,
) -> Hybrid:
    """Reconciled rows of patches whose standard errors, root sum of squares over a row, root mean square over rows, reach
    `noise`. raw: rows from rays, for sky and absorbed columns. cells: of the patches, if they are known.

    Raises ValueError for more than MAX_CELLS cells.
    """
    cells = cells or few_cells(g, p)
    found = _exchanges(build_blockers(cells_of(g.vertices, g.faces)), cells, g.scale, progress)
    open_, rays = _shares(g, p, cells, found, noise, seed)
    of_rays, reciprocity = flows_of_rays(raw, p.area)
    averaged = _flows(p, cells, found, open_, of_rays), reciprocity
    closure = float(np.abs(raw.matrix().sum(axis=1) - 1.0).max(initial=0.0))
    clear, blocked, mixed = (int((found.code == c).sum()) for c in (CLEAR, BLOCKED, MIXED))
    return Hybrid(reconcile_flows(averaged, p.area, raw, closure), clear, blocked, mixed, rays)


def few_cells(g: Geometry, p: Patches) -> Cells:
    """`patch_cells`. Raises ValueError for more than MAX_CELLS of them, whose pairs would take too long."""
    cells = patch_cells(g, p)
    if len(cells.patch) > MAX_CELLS:
        raise ValueError(
            f"closed forms are for at most {MAX_CELLS} cells, and the patches have {len(cells.patch)}: set a larger "
            "radiosity.patch_size, or radiosity.noise to 1e-3 or more"
        )
    return cells


@dataclass(frozen=True, eq=False)
class _Exchanges:
    """Pairs (N, 2) of cells that face each other, x (N,) m² were nothing in between, code (N,) CLEAR, MIXED or BLOCKED."""

    pairs: I64
    x: F64
    code: U32


def _exchanges(blockers: Blockers, cells: Cells, scale: float, progress: Progress) -> _Exchanges:
    group, by_group = group_codes(blockers, cells.corners, cells.normals, scale)
    count, four = len(cells.patch), np.full(len(cells.patch), 4)
    pairs, xs, codes = [], [], []
    step = max(1, PAIRS_PER_BATCH // max(count, 1))
    for begin in range(0, count, step):
        rows = np.arange(begin, min(begin + step, count))
        code = by_group[group[rows][:, None], group[None, begin:]]
        later = np.arange(begin, count) > rows[:, None]
        places = np.flatnonzero(later & (code != BLOCKED))
        a, b = np.divmod(places, count - begin)
        pair, code = np.stack([a, b], axis=1) + begin, code.ravel()[places]
        x = pair_form_factors(cells.corners, four, pair)
        some = np.flatnonzero(x > 0.0)
        pair, code, x = pair[some], code[some], x[some]
        unsure = np.flatnonzero(code == MIXED)
        code[unsure] = classify(blockers, cells.corners, four, pair[unsure])
        pairs.append(pair)
        xs.append(x)
        codes.append(code)
        progress("closed forms", int(rows[-1]) + 1, count)
    return _Exchanges(np.concatenate(pairs), np.concatenate(xs), np.concatenate(codes))


def _shares(
    g: Geometry, p: Patches, cells: Cells, found: _Exchanges, noise: float, seed: int
) -> tuple[tuple[F64, F64], int]:
    """Visible share (N,) of every pair and its standard error, and the rays spent on it (Neyman's allocation)."""
    share, se = (found.code == CLEAR).astype(np.float64), np.zeros(len(found.code))
    mixed = np.flatnonzero(found.code == MIXED)
    if len(mixed) == 0:
        return (share, se), 0
    device, pairs, area = upload_cells(g, cells.corners, cells.normals), found.pairs[mixed], cell_areas(cells.corners)
    smaller = area[pairs[:, 1]] < area[pairs[:, 0]] * (
        1.0 - 1e-9
    )  # to within rounding, so that no scale turns pairs round
    pairs = np.where(smaller[:, None], pairs[:, ::-1], pairs)
    near = found.x[mixed] > NEAR * area[pairs[:, 0]]
    pilot, spread = visible_share(g, device, pairs, near, np.full(len(mixed), PILOT), seed + 1)
    prior = (pilot * PILOT + 0.5) / (PILOT + 1.0)  # Jeffreys': all seen by few rays is not yet all
    weight = np.sqrt((1.0 / p.area[cells.patch[pairs]] ** 2).sum(axis=1)) * found.x[mixed]
    deviation = weight * np.sqrt(np.maximum(prior * (1.0 - prior), PILOT * spread**2))
    exact = deviation * deviation.sum() / (noise**2 * p.count)
    rays = 2 ** np.rint(np.log2(np.clip(exact, PILOT, MOST))).astype(np.int64)
    share[mixed], se[mixed] = visible_share(g, device, pairs, near, rays, seed)
    se[mixed] = np.maximum(se[mixed], 1.0 / (rays + 2.0))  # rule of succession
    return (share, se), int(rays.sum()) + PILOT * len(mixed)


def _flows(p: Patches, cells: Cells, found: _Exchanges, share: tuple[F64, F64], rays: Flows) -> Flows:
    """Cells' exchanges added up over pairs of patches; the outside from rays. What no ray saw is not bent to let light in."""
    seen = np.flatnonzero(found.code != BLOCKED)
    owner = cells.patch[found.pairs[seen]]  # ascending in a pair, as cells are
    # A bent patch sees itself: both directions of such a pair are flows from it to itself.
    twice = np.where(owner[:, 0] == owner[:, 1], 2.0, 1.0) * found.x[seen]
    x, squared = twice * share[0][seen], (twice * share[1][seen]) ** 2
    key = owner[:, 0] * p.count + owner[:, 1]
    if not (np.diff(key) > 0).all():  # patches of several cells
        key, first, pair = np.unique(key, return_index=True, return_inverse=True)
        owner, pair = owner[first], pair.reshape(-1)
        x = np.bincount(pair, x, len(key)).astype(np.float64)
        squared = np.bincount(pair, squared, len(key)).astype(np.float64)
    lo, hi = owner.T.astype(np.int32)
    spread = squared.astype(np.float32)
    return rays._replace(lo=lo, hi=hi, x=x, variance=np.where(x > 0.0, spread, np.float32(0.0)), spread=spread)
