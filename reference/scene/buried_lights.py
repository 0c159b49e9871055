"""Point and spot lights that stand inside a wall, where they light nothing, or on a surface, where rays cannot tell.

The solid angle of a triangle (a, b, c) seen from the light follows van Oosterom and Strackee (1983),

    tan(Ω/2) = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|),

and ΣΩ / 4π over a closed surface that faces outwards is 1 inside and 0 outside: the winding number. A room faces inwards
and counts -1, the walls around its rooms 1. Meshes may close a surface together: what counts is that every edge is
run through as often one way as the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..config import Light, PointLight, SpotLight
from ..datatypes import F64, I32, I64, Material, Mesh
from ..errors import InputError
from ..visibility import merge
from .checks import weld
from .mesh_faults import connected, edges_of

# Nearer than this to a surface, in lengths of the scene's longest side: the ray tracer's own epsilon is 1e-6 of it.
NEAR = 1e-5
SHOWN = 3


@dataclass(frozen=True, eq=False)
class _Surface:
    """corners (3, F, 3) m of the opaque static triangles; low, high (F, 3) their bounds; owner (F,) their mesh. closed
    (C,) i64: those of surfaces that are closed and have an inside; piece (C,) the surface each belongs to."""

    corners: F64
    low: F64
    high: F64
    owner: I32
    closed: I64
    piece: I64


def refuse_buried(
    lights: Mapping[str, Light], meshes: Sequence[Mesh], materials: Sequence[Material], source: str
) -> None:
    """Raises InputError naming `source`, the light, its position and the mesh if one stands in or on a static mesh."""
    placed = {name: light for name, light in lights.items() if isinstance(light, PointLight | SpotLight)}
    opaque = [m for m in meshes if m.static and not materials[m.material].passes_light]
    if not placed or not opaque:
        return
    surface = _surface(opaque, materials)
    low, high = surface.low.min(axis=0), surface.high.max(axis=0)
    near = NEAR * float(np.max(high - low))
    for name, light in placed.items():
        position = np.array(light.position)
        if np.any(position < low - near) or np.any(position > high + near):
            continue
        where = f"{source}: lights.{name}.position: {list(light.position)}"
        touched = _touching(surface, position, near)
        if len(touched):
            raise InputError(
                f"{where} lies on mesh {_names(opaque, touched)} (within {near:.2g} m); move it off the surface"
            )
        around = _around(surface, position)
        if len(around):
            raise InputError(
                f"{where} lies inside mesh {_names(opaque, around)}, where it lights nothing; move it out, or turn the "
                "faces of the mesh if it is a room"
            )


def _names(meshes: Sequence[Mesh], owners: I32) -> str:
    names = [repr(meshes[k].name) for k in np.unique(owners)]
    return " and ".join(names[:SHOWN]) + (" and others" if len(names) > SHOWN else "")


def _surface(meshes: Sequence[Mesh], materials: Sequence[Material]) -> _Surface:
    vertices, faces, owner = merge(meshes, range(len(meshes)))
    # A sheet that reflects on both sides is a wall without an inside, unless its own mesh is closed.
    sided = np.array([m.closed or not materials[m.material].two_sided for m in meshes])
    solid = np.flatnonzero(sided[owner])
    corner = np.stack([vertices[faces[:, k]] for k in range(3)])
    low, high = corner.min(axis=0), corner.max(axis=0)
    if len(solid) == 0:
        return _Surface(corner, low, high, owner, solid, solid)
    corners = weld(vertices)[faces[solid]]
    edges = edges_of(corners)
    piece = connected(np.stack([edges.half[:-1], edges.half[1:]], axis=1)[np.diff(edges.edge) == 0] // 3, len(solid))
    start, end = corners.ravel()[edges.half], np.roll(corners, -1, axis=1).ravel()[edges.half]
    balance = np.bincount(edges.edge, np.where(start < end, 1, -1))
    leaking = np.unique(piece[edges.half[(balance != 0)[edges.edge]] // 3])
    closed = ~np.isin(piece, leaking)
    return _Surface(corner, low, high, owner, solid[closed], piece[closed])


def _around(surface: _Surface, position: F64) -> I32:
    """Meshes (owner numbers) of the closed surface that the position is inside of; none if it is outside."""
    if len(surface.closed) == 0:
        return np.zeros(0, np.int32)
    a, b, c = surface.corners[:, surface.closed] - position
    la, lb, lc = (np.sqrt(np.einsum("nc,nc->n", v, v)) for v in (a, b, c))
    volume = np.einsum("nc,nc->n", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("nc,nc->n", x, y) for x, y in ((a, b), (b, c), (c, a)))
    angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    winding = np.bincount(surface.piece, angle) / (4.0 * np.pi)
    size = np.abs(np.bincount(surface.piece, volume))  # 6 × the volume within the piece
    holding = np.flatnonzero(np.abs(winding) > 0.5)
    if len(holding) == 0:
        return np.zeros(0, np.int32)
    innermost = holding[size[holding].argmin()]  # a block in a room is solid, a room in a wall is not
    if winding[innermost] < 0.0:
        return np.zeros(0, np.int32)
    return surface.owner[surface.closed[surface.piece == int(innermost)]]


def _touching(surface: _Surface, position: F64, near: float) -> I32:
    """Meshes (owner numbers) with a triangle nearer than `near`."""
    close = np.flatnonzero(np.all((surface.low <= position + near) & (surface.high >= position - near), axis=1))
    distance = triangle_distance(surface.corners[:, close].swapaxes(0, 1), position)
    return surface.owner[close[distance <= near]]


def triangle_distance(corners: F64, position: F64) -> F64:
    """(N,) distance, m, of a point (3,) from triangles (N, 3, 3): to the plane where its foot lies inside, else to the
    nearest edge."""
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal, to = np.cross(ab, ac), position - a
    squared = np.maximum((normal * normal).sum(axis=1), np.finfo(np.float64).tiny)
    u = (np.cross(to, ac) * normal).sum(axis=1) / squared
    v = (np.cross(ab, to) * normal).sum(axis=1) / squared
    inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    to_plane = np.abs((to * normal).sum(axis=1)) / np.sqrt(squared)
    start, along = corners, np.roll(corners, -1, axis=1) - corners
    length = np.maximum((along * along).sum(axis=2), np.finfo(np.float64).tiny)
    t = np.clip(((position - start) * along).sum(axis=2) / length, 0.0, 1.0)
    to_edge = np.linalg.norm(position - start - t[..., None] * along, axis=2).min(axis=1, initial=np.inf)
    return np.where(inside, to_plane, to_edge)
