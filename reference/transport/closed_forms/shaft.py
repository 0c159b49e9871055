"""Which pairs of patches provably see each other whole, and which provably not at all.

Every ray between two convex patches runs inside their shaft, the convex hull of both (Haines and Wallace 1991, "Shaft
culling for efficient ray-traced radiosity", here with the hull's own faces in place of those of bounding boxes). If no
surface enters the shaft in front of both patches, nothing stands between them. A surface stays out when it lies behind
either patch, beyond a face of the shaft, with the whole shaft on one side of its plane, or when an edge of it
separates it, within its own plane, from the shaft's section. If one convex surface covers the whole section, it blocks
every ray. `shaft_walk` does this on the device, a lane per pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...datatypes import F64, I32, I64, U32, Bool
from ...device_arrays import to_f64, to_lanes, to_u32
from ...variant import ensure_variant
from .bounding_tree import build_tree
from .joined_cells import joined_cells
from .planar_cells import cell_areas, cells_of
from .polygon_clip import padded, unit_normals
from .shaft_walk import CLEAR, MIXED, NEVER, Scene, classes

# What reaches into a shaft by less than this share of the scene's diagonal counts as touching it from outside.
TOLERANCE = 1e-10
PAIRS_PER_LAUNCH = 1 << 19
LARGE = 512


@dataclass(frozen=True, eq=False)
class Blockers:
    """What may stand between patches: convex cells and the tree over them, in device memory.

    large: the same for the LARGE cells of most area, among which one that covers a whole shaft is looked for.
    centre (3,) m: subtracted from all coordinates, so that far origins cost no digits. diagonal: of the bounds, m.
    """

    scene: Scene
    large: Scene
    centre: F64
    diagonal: float

    @property
    def tolerance(self) -> float:
        """What counts as touching, m."""
        return TOLERANCE * self.diagonal


def build_blockers(cells: F64) -> Blockers:
    """Upload convex planar cells (E, 4, 3) m, as `planar_cells.cells_of` makes them, joined where that is exact. They block
    from both sides.

    Raises ValueError without cells.
    """
    ensure_variant()
    cells = joined_cells(cells)
    lower, upper = (getattr(cells, end)(axis=(0, 1)) for end in ("min", "max"))
    centre = 0.5 * (lower + upper)
    scene = large = _scene(cells - centre)
    if len(cells) > LARGE:
        most = np.argsort(-cell_areas(cells), kind="stable")[:LARGE]
        large = _scene(cells[most] - centre)
    return Blockers(scene, large, centre, float(np.linalg.norm(upper - lower)))


def _scene(cells: F64) -> Scene:
    """Cells (E, 4, 3) about the centre, with the tree over them."""
    tree = build_tree(cells.min(axis=1), cells.max(axis=1))
    normals = unit_normals(cells)
    edges = np.roll(cells, -1, axis=1) - cells
    length = np.linalg.norm(edges, axis=2)
    outward = np.cross(edges, normals[:, None, :]) / np.maximum(length, np.finfo(np.float64).tiny)[..., None]
    offset = np.where(length > 0.0, np.einsum("ekc,ekc->ek", outward, cells), NEVER)
    planes = np.concatenate([outward, offset[..., None]], axis=2).reshape(len(cells), 16)
    height = np.einsum("ec,ec->e", normals, cells[:, 0])[:, None]
    rows = np.concatenate([cells.reshape(-1, 12), normals, height, planes], axis=1)
    # One more place: Dr.Jit takes arrays of one number for constants and compiles another kernel.
    skip, primitive = np.append(tree.skip, 0), np.append(tree.primitive, -1).astype(np.uint32)
    boxes = to_f64(tree.lower), to_f64(tree.upper)
    return Scene(to_f64(rows), *boxes, to_u32(skip), to_u32(primitive), len(tree.skip))


def unoccluded(vertices: F64, faces: I32, polygons: F64, sizes: I64, pairs: I64) -> Bool:
    """(N,) true where nothing of the mesh (V, 3), (T, 3) stands between the fronts of patches i and j of `pairs` (N, 2).

    polygons (P, C, 3) m, of which the first sizes (P,) corners count: planar, convex outlines, counter-clockwise from
    the front; a larger outline than the patch's is allowed and only makes fewer pairs provable. False means: not
    proved. Surfaces in or behind a patch's plane, the patch itself among them, do not count.
    """
    blockers = build_blockers(cells_of(vertices, faces))
    return classify(blockers, polygons, sizes, pairs, stop_early=True) == CLEAR


def classify(blockers: Blockers, polygons: F64, sizes: I64, pairs: I64, stop_early: bool = False) -> U32:
    """CLEAR, BLOCKED (one surface stands in every ray's way) or MIXED (not known), (N,), for pairs as in `unoccluded`.

    stop_early: leave a pair as MIXED at the first surface in its way. Pairs that see nothing of each other are CLEAR.
    Neighbours in `pairs` should be neighbours in space: they are judged together.
    """
    ensure_variant()
    host = padded(polygons, np.asarray(sizes)) - blockers.centre
    span = float(np.linalg.norm(np.ptp(host.reshape(-1, 3), axis=0))) if len(host) else 0.0
    tolerance = TOLERANCE * max(blockers.diagonal, span)
    patches = to_f64(host), to_f64(unit_normals(host)), host.shape[1]
    if stop_early or blockers.large is blockers.scene:
        return _found(blockers.scene, patches, pairs, tolerance, stop_early)
    out = _found(blockers.scene, patches, pairs, tolerance, stop_early=True)
    mixed = np.flatnonzero(out == MIXED)
    out[mixed] = np.maximum(MIXED, _found(blockers.large, patches, pairs[mixed], tolerance, stop_early=False))
    return out


def _found(scene: Scene, patches: tuple[Any, Any, int], pairs: I64, tolerance: float, stop_early: bool) -> U32:
    """Class (N,) of pairs (N, 2). patches: flat corners and unit normals in device memory, corners of each."""
    import drjit as dr
    import mitsuba as mi

    out = np.zeros(len(pairs), dtype=np.uint32)
    slack = dr.opaque(mi.Float64, tolerance)
    for begin in range(0, len(pairs), PAIRS_PER_LAUNCH):
        part = pairs[begin : begin + PAIRS_PER_LAUNCH]
        i, j = (to_lanes(part[:, k]) for k in (0, 1))
        found = classes(scene, *patches, i, j, slack, stop_early)
        out[begin : begin + len(part)] = np.array(found)[: len(part)]
    return out
