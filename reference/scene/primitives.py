"""Shapes that Mitsuba knows without a file, as triangles. Fronts face outwards (rectangle and disk: +z)."""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, I32, I64
from .document import MeshArrays

DISK_SIDES = 64
CYLINDER_SIDES = 48
SPHERE_SUBDIVISIONS = 4  # 2,048 triangles


def rectangle() -> MeshArrays:
    """[-1, 1]² at z = 0. uvs in 0..1, v up with y flipped to "row 0 at v = 1" as all uvs here."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    return MeshArrays(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), uvs)


def _ring(sides: int) -> tuple[F64, float]:
    """Points (sides, 2) of a regular polygon around the unit circle's area, and its corner radius."""
    radius = float(np.sqrt(np.pi / (0.5 * sides * np.sin(2 * np.pi / sides))))
    phi = 2 * np.pi * np.arange(sides) / sides
    return radius * np.stack([np.cos(phi), np.sin(phi)], axis=1), radius


def disk() -> MeshArrays:
    """Unit disk at z = 0 as a polygon of the same area, so that a lamp keeps its power."""
    ring, _ = _ring(DISK_SIDES)
    vertices = np.zeros((DISK_SIDES + 1, 3))
    vertices[1:, :2] = ring
    i = np.arange(DISK_SIDES)
    faces = np.stack([np.zeros_like(i), i + 1, (i + 1) % DISK_SIDES + 1], axis=1)
    return MeshArrays(vertices, faces.astype(np.int32))


# Normal, then the directions in which u and (Mitsuba's) v grow, of the six faces of Mitsuba's cube.
CUBE_FACES = (
    ((0, -1, 0), (0, 0, 1), (1, 0, 0)),
    ((0, 1, 0), (-1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 0, -1), (0, -1, 0), (1, 0, 0)),
)


def cube() -> MeshArrays:
    """[-1, 1]³, each face with its own corners and uvs in 0..1, laid out as Mitsuba lays them."""
    square = rectangle()
    vertices, faces = list[F64](), list[I32]()
    for k, (normal, du, dv) in enumerate(CUBE_FACES):
        frame = np.array([du, dv, normal], np.float64)
        # Where u, v and the normal are left-handed the corners run clockwise, and are turned.
        turn = 1 if np.linalg.det(frame) > 0 else -1
        vertices.append((square.vertices + np.array([0.0, 0.0, 1.0])) @ frame)
        faces.append(square.faces[:, ::turn] + 4 * k)
    uvs = None if square.uvs is None else np.tile(square.uvs, (6, 1))
    return MeshArrays(np.concatenate(vertices), np.concatenate(faces).astype(np.int32), uvs)


def _subdivide(vertices: F64, faces: I64) -> tuple[F64, I64]:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    a, b, c = inverse.reshape(3, -1) + len(vertices)
    i, j, k = faces.T
    split = np.concatenate([np.stack(t, axis=1) for t in ((i, a, c), (a, j, b), (c, b, k), (a, b, c))])
    return np.concatenate([vertices, middle]), split


def sphere() -> MeshArrays:
    """Unit sphere as a subdivided octahedron, scaled to the sphere's area so that a lamp keeps its power."""
    vertices = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float64)
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int64)
    for _ in range(SPHERE_SUBDIVISIONS):
        vertices, faces = _subdivide(vertices, faces)
    p = vertices[faces]
    area = 0.5 * float(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum())
    return MeshArrays(vertices * np.sqrt(4 * np.pi / area), faces.astype(np.int32))


def cylinder() -> MeshArrays:
    """Unit cylinder around z from 0 to 1, without caps, facing outwards."""
    n = CYLINDER_SIDES
    ring = _ring(n)[0]
    low, high = np.zeros((n, 3)), np.ones((n, 3))
    low[:, :2] = high[:, :2] = ring
    i = np.arange(n)
    j = (i + 1) % n
    faces = np.concatenate([np.stack([i, j, j + n], axis=1), np.stack([i, j + n, i + n], axis=1)])
    return MeshArrays(np.concatenate([low, high]), faces.astype(np.int32))


PRIMITIVES = {"rectangle": rectangle, "disk": disk, "cube": cube, "sphere": sphere, "cylinder": cylinder}
