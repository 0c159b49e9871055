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
GROUP = 4.0  # cells of typical size to the edge of a group


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
    group, outlines = _groups(cells, scale)
    count, four = len(cells.patch), np.full(len(cells.patch), 4)
    by_group = _group_codes(blockers, outlines)
    pairs, xs, codes = [], [], []
    step = max(1, PAIRS_PER_BATCH // max(count, 1))
    for begin in range(0, count, step):
        i = np.arange(begin, min(begin + step, count))
        a, b = (m.ravel() for m in np.meshgrid(i, np.arange(begin, count), indexing="ij"))
        keep = (b > a) & (group[a] != group[b])
        pair = np.stack([a[keep], b[keep]], axis=1)
        code = by_group[group[pair[:, 0]], group[pair[:, 1]]]
        pair, code = pair[code != BLOCKED], code[code != BLOCKED]
        x = pair_form_factors(cells.corners, four, pair)
        pair, code, x = pair[x > 0.0], code[x > 0.0], x[x > 0.0]
        unsure = np.flatnonzero(code == MIXED)
        code[unsure] = classify(blockers, cells.corners, four, pair[unsure], stop_early=True)
        pairs.append(pair)
        xs.append(x)
        codes.append(code)
        progress("closed forms", int(i[-1]) + 1, count)
    return _Exchanges(np.concatenate(pairs), np.concatenate(xs), np.concatenate(codes))


def _groups(cells: Cells, scale: float) -> tuple[I64, F64]:
    """Group (E,) of each cell, coplanar and near together, and the groups' outlines (G, 4, 3), rectangles in their planes."""
    middle = cells.corners.mean(axis=(0, 1))  # taken off: far from the origin planes would lose their digits
    corners = cells.corners - middle
    centre = corners.mean(axis=1)
    height = np.einsum("ec,ec->e", cells.normals, centre)
    edge = GROUP * float(np.median(np.linalg.norm(np.ptp(corners, axis=1), axis=1)))
    plane = np.column_stack([np.round(cells.normals * 1e9), np.round(height / scale * 1e9)])
    key = np.column_stack([plane, np.floor((centre - centre.min(axis=0)) / edge)])
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    first = np.unique(group, return_index=True)[1]
    along = corners[first, 1] - corners[first, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = cells.normals[first]
    across = np.cross(normal, along)
    local = np.stack([np.einsum("ekc,ec->ek", corners, axis[group]) for axis in (along, across)], axis=2)
    n = len(first)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(low, group, local.min(axis=1))
    np.maximum.at(high, group, local.max(axis=1))
    base = middle + normal * height[first][:, None]
    ring = [(low, low), (high, low), (high, high), (low, high)]
    return group, np.stack([base + along * u[:, :1] + across * v[:, 1:] for u, v in ring], axis=1)


def _group_codes(blockers: Blockers, outlines: F64) -> U32:
    """Code (G, G) of every pair of groups."""
    n = len(outlines)
    i, j = np.triu_indices(n, 1)
    codes = np.full((n, n), MIXED, dtype=np.uint32)
    found = classify(blockers, outlines, np.full(n, 4), np.stack([i, j], axis=1))
    codes[i, j] = codes[j, i] = found
    return codes


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
    owner = cells.patch[found.pairs]
    key, pair = np.unique(owner.min(axis=1) * p.count + owner.max(axis=1), return_inverse=True)
    pair = pair.reshape(-1)
    # A bent patch sees itself: both directions of such a pair are flows from it to itself.
    twice = np.where(owner[:, 0] == owner[:, 1], 2.0, 1.0) * found.x
    x = np.bincount(pair, twice * share[0], len(key)).astype(np.float64)
    spread = np.bincount(pair, (twice * share[1]) ** 2, len(key)).astype(np.float32)
    lo, hi = (key // p.count).astype(np.int32), (key % p.count).astype(np.int32)
    return rays._replace(lo=lo, hi=hi, x=x, variance=np.where(x > 0.0, spread, np.float32(0.0)), spread=spread)
