"""The form factor between two meshes, with whatever stands between them.

F12 = fraction of the diffuse power leaving the front of mesh 1 that arrives directly at the front of mesh 2. Meshes and
occluders are opaque on both sides, and hide from themselves. Where nothing can hide anything (`shaft`) the answer is
the contour integral; the undecided rest is the contour integral times the share that shadow rays let through; meshes of
too many faces for pairs take cosine rays from the smaller mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...datatypes import F64, I32
from ...device_arrays import to_f32
from ...variant import ensure_variant
from ...visibility import Geometry, mitsuba_mesh, triangle_frames
from .pair_exchange import MOST_PAIRS, exchange
from .pair_rays import Estimate, hit_share, visible_exchange
from .planar_cells import cells_of
from .polygon_clip import clip_polygon
from .shaft import build_blockers

LEAST_RAYS, MOST_RAYS = 1 << 10, 1 << 28
DEFAULT_RAYS = 1 << 20
MARGIN, LARGE = 1e-3, 10.0  # of the hull's extent


class Surface(Protocol):
    """What form factors need of a mesh: vertices (V, 3) f64 m, faces (F, 3) i32 counter-clockwise from the front."""

    @property
    def vertices(self) -> F64:
        """Corners."""
        ...

    @property
    def faces(self) -> I32:
        """Triangles."""
        ...


@dataclass(frozen=True, eq=False)
class _Part:
    """Some faces of a mesh: vertices (V, 3), faces (F, 3)."""

    vertices: F64
    faces: I32


@dataclass(frozen=True)
class PairFormFactor:
    """value with standard error `se`; rays: how many were cast. method: "contour" (closed form, se 0), "contour+rays"
    (closed form where proved, shadow rays for the rest), "rays" (cosine rays). reverse: F21 = F12 · A1 / A2. areas: m².
    """

    value: float
    se: float
    rays: int
    method: str
    emitter_area: float
    receiver_area: float

    @property
    def reverse(self) -> float:
        """Form factor from the receiver to the emitter."""
        return self.value * self.emitter_area / self.receiver_area


def mesh_form_factor(
    emitter: Surface, receiver: Surface, occluders: Sequence[Surface] = (), rays: int = DEFAULT_RAYS, seed: int = 0
) -> PairFormFactor:
    """Form factor from `emitter` to `receiver`, which may be the same object.

    rays: at most so many are cast, LEAST_RAYS … MOST_RAYS. Exactly 0 with se 0 where it is proved that nothing is seen.
    Raises ValueError for a mesh without area and for rays out of range.
    """
    if not LEAST_RAYS <= rays <= MOST_RAYS:
        raise ValueError(f"rays must lie in {LEAST_RAYS} … {MOST_RAYS}, got {rays}")
    ensure_variant()
    meshes = [emitter, receiver] if receiver is not emitter else [emitter]
    areas = [_area(m) for m in (emitter, receiver)]
    hull = _hull(meshes)
    occluders = [kept for m in occluders if len((kept := _within(m, hull)).faces)]
    cells = [cells_of(m.vertices, m.faces) for m in meshes]
    cells += [_cut(cells_of(m.vertices, m.faces), hull) for m in occluders]
    sides = cells[0], cells[len(meshes) - 1]
    if len(sides[0]) * len(sides[1]) > MOST_PAIRS:
        found = _by_hits(geometry_of([*meshes, *occluders]), areas, len(meshes) - 1, rays, seed)
        return PairFormFactor(found.value, found.se, found.rays, "rays", *areas)
    blockers = build_blockers(np.concatenate(cells))
    parts = exchange(*sides, blockers, rays)
    if len(parts.weights) == 0:
        return PairFormFactor(parts.known / areas[0], 0.0, 0, "contour", *areas)
    found = visible_exchange(blockers, parts, rays, seed)
    value = (parts.known + found.value) / areas[0]
    return PairFormFactor(value, found.se / areas[0], found.rays, "contour+rays", *areas)


def _hull(meshes: Sequence[Surface]) -> tuple[F64, F64]:
    """Bounds (3,), (3,) m of all that light between the meshes can touch, and a little more."""
    used = np.concatenate([m.vertices[np.unique(m.faces)] for m in meshes])
    lower, upper = used.min(axis=0), used.max(axis=0)
    margin = MARGIN * float(np.linalg.norm(upper - lower))
    return lower - margin, upper + margin


def _within(mesh: Surface, hull: tuple[F64, F64]) -> Surface:
    """The faces of an occluder that reach into the hull: the others stop nothing, and would only coarsen tolerances, which
    go by the extent of all that is looked at."""
    corners = mesh.vertices[mesh.faces]
    inside = (corners.min(axis=1) <= hull[1]) & (corners.max(axis=1) >= hull[0])
    kept = corners[inside.all(axis=1)]
    return _Part(kept.reshape(-1, 3), np.arange(3 * len(kept), dtype=np.int32).reshape(-1, 3))


def _cut(cells: F64, hull: tuple[F64, F64]) -> F64:
    """Cells (E, 4, 3) of which those much larger than the hull are cut down to it."""
    middle, half = 0.5 * (hull[0] + hull[1]), float((hull[1] - hull[0]).max())
    large = np.ptp(cells, axis=1).max(axis=1) > LARGE * half
    parts = [cells[~large]]
    for cell in cells[large]:
        polygon = cell
        for axis in range(3):
            for side in (-1.0, 1.0):
                if len(polygon):
                    polygon = clip_polygon(polygon, half - side * (polygon[:, axis] - middle[axis]))
        fan = [polygon[[0, k, k + 1, k + 1]] for k in range(1, len(polygon) - 1)]
        parts.append(np.array(fan).reshape(-1, 4, 3))
    return np.concatenate(parts)


def _area(mesh: Surface) -> float:
    area = float(triangle_frames(mesh.vertices, mesh.faces)[1].sum())
    if not area > 0.0:
        raise ValueError(f"a mesh needs an area, got {area}")
    return area


def _by_hits(g: Geometry, areas: list[float], receiver: int, rays: int, seed: int) -> Estimate:
    """Cosine rays from the mesh of less area: its form factor is the larger one, known to a smaller share."""
    if areas[0] <= areas[1]:
        return hit_share(g, 0, receiver, rays, seed)
    found, ratio = hit_share(g, receiver, 0, rays, seed), areas[1] / areas[0]
    return Estimate(found.value * ratio, found.se * ratio, found.rays)


def geometry_of(meshes: Sequence[Surface]) -> Geometry:
    """Ray caster over all meshes; `mesh` numbers them in order."""
    import mitsuba as mi

    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    vertices = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([m.faces + o for m, o in zip(meshes, offsets[:-1], strict=True)]).astype(np.int32)
    owner = np.repeat(np.arange(len(meshes), dtype=np.int32), [len(m.faces) for m in meshes])
    normals, areas = triangle_frames(vertices, faces)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    centre, scale = 0.5 * (lower + upper), float(0.5 * np.max(upper - lower))
    mesh = mitsuba_mesh("pair", (vertices - centre) / scale, faces)
    caster = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "mesh": mesh})
    sides = np.ones(len(faces), dtype=np.bool_)
    return Geometry(vertices, faces, normals, areas, owner, ~sides, sides, centre, scale, caster, to_f32(normals))
