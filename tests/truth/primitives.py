"""Tessellations of the primitives in published view-factor cases, and the meshes among them, as (vertices, faces).

Circles become polygons of the same area, so what flows through them changes only in the fourth order of the segment
angle; balls become icospheres of the same surface, so their mean silhouette is right (Cauchy's formula).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh
from lightgauge.reference.datatypes import F64, I32


@dataclass(frozen=True, eq=False)
class Shape:
    """vertices (V, 3) f64, faces (F, 3) i32, counter-clockwise from the side that takes part."""

    vertices: F64
    faces: I32

    @property
    def area(self) -> float:
        """Of all faces."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def polygons(vertices: Any, faces: Sequence[Sequence[int]]) -> Shape:
    """Convex polygon faces cut into fans."""
    triangles = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    return Shape(np.asarray(vertices, np.float64), np.asarray(triangles, np.int32))


def frame(axis: Any) -> tuple[F64, F64, F64]:
    """Two unit vectors across `axis`, and it as a unit vector; right-handed in this order."""
    n = np.asarray(axis, np.float64)
    n = n / np.linalg.norm(n)
    across = np.eye(3)[int(np.argmin(np.abs(n)))]
    u = np.cross(across, n)
    u /= np.linalg.norm(u)
    return u, np.cross(n, u), n


def equal_area(segments: int) -> float:
    """Circumradius of the regular polygon with the area of the unit disc."""
    return math.sqrt(2.0 * math.pi / (segments * math.sin(2.0 * math.pi / segments)))


def ring(centre: Any, axis: Any, radius: float, segments: int) -> F64:
    """Corners (segments, 3) of a polygon with the area of the circle, counter-clockwise about `axis`."""
    u, v, _ = frame(axis)
    angle = 2.0 * math.pi * np.arange(segments) / segments
    r = radius * equal_area(segments)
    return np.asarray(np.asarray(centre, np.float64) + r * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v)))


def between(lower: F64, upper: F64) -> Shape:
    """Quadrilaterals between two rings; the front is to the right of the way from lower to upper, seen along the ring."""
    n = len(lower)
    faces = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    return polygons(np.concatenate([lower, upper]), faces)


def flipped(shape: Shape) -> Shape:
    """The other side."""
    return Shape(shape.vertices, np.ascontiguousarray(shape.faces[:, ::-1]))


def disc(centre: Any, normal: Any, radius: float, segments: int) -> Shape:
    corners = np.vstack([ring(centre, normal, radius, segments), [centre]])
    return polygons(corners, [(segments, k, (k + 1) % segments) for k in range(segments)])


def annulus(centre: Any, normal: Any, inner: float, outer: float, segments: int) -> Shape:
    return flipped(between(ring(centre, normal, inner, segments), ring(centre, normal, outer, segments)))


def cylinder(p0: Any, p1: Any, radius: float, segments: int, inside: bool) -> Shape:
    axis = np.asarray(p1, np.float64) - np.asarray(p0, np.float64)
    wall = between(ring(p0, axis, radius, segments), ring(p1, axis, radius, segments))
    return flipped(wall) if inside else wall


def sphere(centre: Any, radius: float, subdivisions: int) -> Shape:
    """Seen from outside."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    scale = radius * math.sqrt(4.0 * math.pi / ball.area)
    return Shape(np.asarray(ball.vertices) * scale + np.asarray(centre), np.asarray(ball.faces, np.int32))


def cap(centre: Any, radius: float, axis: Any, half_angle: float, rings: int, segments: int) -> Shape:
    """Seen from inside; its rim is the polygon that `disc` makes of the rim's circle, and its surface the cap's.

    The surface is reached by stretching the mesh along the axis, by less than a hundredth.
    """
    low, high, goal = 0.9, 1.5, 2.0 * math.pi * radius**2 * (1.0 - math.cos(half_angle))
    for _ in range(60):
        stretch = 0.5 * (low + high)
        shape = _stretched_cap(centre, radius, axis, half_angle, rings, segments, stretch)
        low, high = (stretch, high) if shape.area < goal else (low, stretch)
    return shape


def _stretched_cap(
    centre: Any, radius: float, axis: Any, half_angle: float, rings: int, segments: int, stretch: float
) -> Shape:
    n = frame(axis)[2]
    rim = radius * math.cos(half_angle)
    angles = half_angle * np.arange(rings + 1) / rings
    centres = [np.asarray(centre) + (rim + stretch * (radius * math.cos(a) - rim)) * n for a in angles]
    rows = [ring(c, n, radius * math.sin(a), segments) for c, a in zip(centres[1:], angles[1:], strict=True)]
    bands = [between(lower, upper) for upper, lower in pairwise(rows)]
    pole = np.vstack([rows[0], centres[0]])
    bands.append(polygons(pole, [(segments, k, (k + 1) % segments) for k in range(segments)]))
    return flipped(joined(bands))


def joined(shapes: Sequence[Shape]) -> Shape:
    offsets = np.cumsum([0] + [len(s.vertices) for s in shapes])
    faces = [s.faces + o for s, o in zip(shapes, offsets[:-1], strict=True)]
    return Shape(np.concatenate([s.vertices for s in shapes]), np.concatenate(faces).astype(np.int32))


def extruded(a: Sequence[float], b: Sequence[float], length: float) -> Shape:
    """A segment of the x, y plane as a strip −length/2 ≤ z ≤ length/2; the front is to the left of the way from a to b."""
    corners = [(*a, -0.5 * length), (*a, 0.5 * length), (*b, 0.5 * length), (*b, -0.5 * length)]
    return polygons(corners, [(0, 1, 2, 3)])


def tube(centre: Sequence[float], radius: float, segments: int, length: float) -> Shape:
    """A circle of the x, y plane as a cylinder −length/2 ≤ z ≤ length/2, seen from outside."""
    return cylinder((*centre, -0.5 * length), (*centre, 0.5 * length), radius, segments, inside=False)


def shape_of(entry: Mapping[str, Any], fineness: int) -> Shape:
    """A published primitive. fineness: segments of a circle are 32 · 2^fineness, subdivisions of a sphere 2 + fineness."""
    segments, kind = 32 << fineness, entry["type"]
    if kind == "mesh":
        return polygons(entry["vertices"], entry["faces"])
    if kind == "disc":
        return disc(entry["center"], entry["normal"], entry["radius"], segments)
    if kind == "annulus":
        radii = entry["inner_radius"], entry["outer_radius"]
        return annulus(entry["center"], entry["normal"], *radii, segments)
    if kind == "sphere":
        ball = sphere(entry["center"], entry["radius"], 2 + fineness)
        return flipped(ball) if entry["side"] == "inside" else ball
    if kind == "cylinder":
        return cylinder(entry["p0"], entry["p1"], entry["radius"], segments, entry["side"] == "inside")
    if kind == "sphere_cap":
        half = math.radians(entry["half_angle_deg"])
        inside = cap(entry["center"], entry["radius"], entry["axis"], half, 4 << fineness, segments)
        return inside if entry["side"] == "inside" else flipped(inside)
    raise ValueError(f"no tessellation for {kind!r}")
