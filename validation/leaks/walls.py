"""Walls: how thick is what lies behind a surface, and which voxels it needs.

A wall of thickness t and normal n keeps light in exactly when no voxel reaches from one side to the other,

    t ≥ h (|nx| + |ny| + |nz|)        (failure-catalogue C7),

so the voxels it needs are h = t / (|nx| + |ny| + |nz|). The thickness is measured by a ray from the surface inwards, against
its normal, up to where it leaves through a face of roughly opposite normal into the open. Rays that leave elsewhere, or never,
find no wall: thick solids, wedges, the outside of the world. A sheet that reflects on both sides has t = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64, I32, I64, Bool
from ...reference.visibility import LIFT, Geometry, cast, to_box, vectors

OPPOSITE = 0.5  # least cosine between the ray and the normal of the face that it leaves through
SKEW = np.array([[0.36, 0.48, 0.8], [-0.8, 0.36, -0.48], [0.48, -0.8, -0.36]])  # along no likely wall
MOST_FACES = 8  # that a ray passes within overlapping solids before it counts as never leaving


@dataclass(frozen=True, eq=False)
class Walls:
    """thickness (N,) m, infinite where there is no wall, 0 for sheets. need (N,) m: largest voxels that keep light in,
    infinite where there is no wall. behind (N,) i32: mesh of the face on the other side, -1 where there is none."""

    thickness: F64
    need: F64
    behind: I32


def spread(normals: F64) -> F64:
    """|nx| + |ny| + |nz| (N,) of unit normals (N, 3): how far a voxel of edge 1 reaches along them."""
    return np.asarray(np.abs(normals).sum(axis=1))


def is_sheet(g: Geometry, triangle: I64) -> Bool:
    """Whether triangles (N,) reflect on both sides and close nothing in: (N,)."""
    return np.asarray(g.two_sided[triangle] & ~g.counts_as_back[triangle])


def walls_behind(g: Geometry, positions: F64, normals: F64, triangle: I64) -> Walls:
    """Walls behind points (N, 3) m of triangles (N,), whose unit `normals` (N, 3) look into the open."""
    n = len(positions)
    thickness, behind = np.full(n, np.inf), np.full(n, -1, dtype=np.int32)
    sheet = is_sheet(g, triangle)
    thickness[sheet], behind[sheet] = 0.0, g.mesh[triangle[sheet]]
    active, beyond = np.flatnonzero(~sheet), 2.0 * LIFT * g.scale
    travelled = np.zeros(len(active))
    for _ in range(MOST_FACES):
        if len(active) == 0:
            break
        inwards = -normals[active]
        start = positions[active] + travelled[:, None] * inwards
        hits = cast(g, to_box(g, start, inwards), vectors(inwards))
        hit, face = np.array(hits.hit), np.array(hits.triangle).astype(np.int64)
        travelled = travelled + LIFT * g.scale + np.where(hit, np.array(hits.t, dtype=np.float64), 0.0)
        out = hit & ~np.array(hits.front) & g.counts_as_back[face]
        straight = np.einsum("ni,ni->n", g.normals[face], inwards) >= OPPOSITE
        done = np.flatnonzero(out & straight)
        done = done[in_the_open(g, positions[active[done]] + (travelled[done, None] + beyond) * inwards[done])]
        thickness[active[done]], behind[active[done]] = travelled[done], g.mesh[face[done]]
        go_on = hit & ~(out & ~straight)
        go_on[done] = False
        active, travelled = active[go_on], travelled[go_on]
    return Walls(thickness, thickness / spread(normals), behind)


def in_the_open(g: Geometry, positions: F64) -> Bool:
    """Whether positions (N, 3) m are not inside something: of three skew rays at most one first meets the back of a face that has
    an inside; (N,)."""
    if len(positions) < 2:  # a single lane would be compiled as a constant, in a kernel of its own
        return in_the_open(g, np.repeat(positions, 2, axis=0))[:1] if len(positions) else np.zeros(0, dtype=np.bool_)
    inside = np.zeros(len(positions), dtype=np.int64)
    for way in SKEW:
        hits = cast(g, to_box(g, positions), vectors(np.broadcast_to(way, positions.shape)))
        face = np.array(hits.triangle).astype(np.int64)
        inside += np.array(hits.hit) & ~np.array(hits.front) & g.counts_as_back[face]
    return np.asarray(inside <= 1)
