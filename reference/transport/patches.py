"""Patches: pieces of the static surface with constant radiosity, and the way from a ray's hit to its patch.

Triangles longer than the patch size are cut into k² equal elements (k per edge); elements are then clustered by
place (cells of the patch size), normal and material, so that neither one huge wall nor 143 k small triangles decides
the number of patches. A two-sided patch has a twin for its back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I32, I64, Mesh, Scene
from ..visibility import Geometry, points_on_triangles
from .baked_albedo import baked_albedo
from .elements import cuts_for, points_in_elements
from .textures import element_texture

NORMAL_CELLS = 3  # per edge of a cube face: axis-aligned normals then lie in the middle of a cell, not on a border
AUTO_PATCHES = 2500
TIE = 1e-6  # what lies on a border to within rounding goes one way, so that neither scale nor place changes the patches


@dataclass(frozen=True, eq=False)
class Patches:
    """P patches, fronts first, then the backs of the two-sided ones.

    area (P,) m², centroid (P, 3) m, normal (P, 3) unit mean normal, albedo (P, 3), exitance (P, 3) W·m⁻² of emitters
    tagged `input`, engine_exitance (P, 3) of emitters tagged `engine`. front: number of front patches.
    emitter (P,) i32: mesh that the patch shines as, or -1; shine (P, 3): mean of that mesh's emissive texture, or 1.
    cuts (T,) i32: k of each triangle; first_element (T,) i64. element_patch, element_back (E,) i32: patch of an
    element's front and back, -1 where the back is black. element_triangle (E,) i32.
    order (E,) i64: elements sorted by patch; cumulative (E + 1,) f64: area sum in that order; start (P_front + 1,) i64:
    where each front patch begins in `order`. twin (P,) i32: front patch whose elements a patch uses.
    key (P_front, 6) i64: level (0 unless cut further), material or emitter, normal cell and place of each front patch.
    """

    area: F64
    centroid: F64
    normal: F64
    albedo: F64
    exitance: F64
    engine_exitance: F64
    emitter: I32
    shine: F64
    front: int
    cuts: I32
    first_element: I64
    element_triangle: I32
    element_patch: I32
    element_back: I32
    order: I64
    cumulative: F64
    start: I64
    twin: I32
    key: I64

    @property
    def count(self) -> int:
        """Number of patches, backs included."""
        return len(self.area)


def auto_patch_size(g: Geometry) -> float:
    """Patch edge, m, that cuts the scene's area into about AUTO_PATCHES pieces."""
    return math.sqrt(float(g.areas.sum()) / AUTO_PATCHES)


def build_patches(scene: Scene, g: Geometry, size: float, split: Sequence[I64] = ()) -> Patches:
    """Cut and cluster. `size`: target edge, m. split: for each level, the keys of the patches of that level that are cut
    in four once more (`Patches.key`)."""
    cuts = cuts_for(g, np.full(len(g.faces), size))
    for level in range(len(split)):  # triangles that reach into a patch to be cut need smaller elements
        pieces = _elements(g, cuts)
        deeper = _keys(scene, g, pieces, size, split[: level + 1])[:, 0] > level
        reached = np.bincount(pieces.triangle, deeper, len(g.faces)) > 0
        cuts = np.maximum(cuts, cuts_for(g, np.where(reached, size / 2 ** (level + 1), np.inf)))
    pieces = _elements(g, cuts)
    key, patch = np.unique(_keys(scene, g, pieces, size, split), axis=0, return_inverse=True)
    return _assemble(scene, g, cuts, pieces, patch.reshape(-1), key)


class _Elements(NamedTuple):
    """first (T + 1,) i64; triangle (E,) i32; centre (E, 3) m; area (E,) m²."""

    first: I64
    triangle: I32
    centre: F64
    area: F64


def _elements(g: Geometry, cuts: I32) -> _Elements:
    squared = cuts.astype(np.int64) ** 2
    first = np.concatenate([[0], np.cumsum(squared)])
    triangle = np.repeat(np.arange(len(cuts), dtype=np.int32), squared)
    uv = points_in_elements(cuts, first, triangle, np.arange(len(triangle)), np.full((len(triangle), 2), 1.0 / 3.0))
    return _Elements(first, triangle, points_on_triangles(g, triangle, uv), g.areas[triangle] / squared[triangle])


def _normal_cell(normals: F64) -> I64:
    axis = np.argmax(np.abs(normals) + np.array([2.0 * TIE, TIE, 0.0]), axis=1)
    rows = np.arange(len(normals))
    major = normals[rows, axis]
    uv = np.stack([normals[rows, (axis + 1) % 3], normals[rows, (axis + 2) % 3]], axis=1)
    uv = uv / np.maximum(np.abs(major), 1e-9)[:, None]
    cell = np.clip(((uv * 0.5 + 0.5) * NORMAL_CELLS + TIE).astype(np.int64), 0, NORMAL_CELLS - 1)
    return np.asarray(((2 * axis + (major < 0)) * NORMAL_CELLS + cell[:, 0]) * NORMAL_CELLS + cell[:, 1])


def _keys(scene: Scene, g: Geometry, e: _Elements, size: float, split: Sequence[I64]) -> I64:
    """Key (E, 6) of each element's patch: level, material or emitter, normal cell, place."""
    emits = np.array([m.emission.any() for m in scene.meshes])
    material = np.array([m.material for m in scene.meshes])
    owner = g.mesh[e.triangle]
    group = np.where(emits[owner], len(scene.materials) + owner, material[owner])
    normal = _normal_cell(g.normals)[e.triangle]

    def at(level: int) -> I64:
        place = np.floor(((e.centre - g.lower) / size + TIE) * 2**level).astype(np.int64)
        return np.column_stack([np.full(len(group), level), group, normal, place])

    key = at(0)
    for level, cut in enumerate(split):
        inside = (key[:, 0] == level) & _among(key, cut)
        key = np.where(inside[:, None], at(level + 1), key)
    return key


def _among(rows: I64, chosen: I64) -> npt.NDArray[np.bool_]:
    """Whether each of `rows` (N, 6) is one of `chosen` (M, 6)."""
    _, number = np.unique(np.concatenate([rows, chosen]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    return np.isin(number[: len(rows)], number[len(rows) :])


def _assemble(scene: Scene, g: Geometry, cuts: I32, e: _Elements, patch: I64, key: I64) -> Patches:
    triangle, weight = e.triangle, e.area
    front = len(key)
    order = np.argsort(patch, kind="stable")
    start = np.searchsorted(patch[order], np.arange(front + 1))
    area = np.bincount(patch, weight, front)

    def mean(values: F64) -> F64:
        return np.stack([np.bincount(patch, weight * values[:, c], front) for c in range(3)], axis=1) / area[:, None]

    normal = mean(g.normals[triangle])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    albedo = mean(_element_albedo(scene, g, cuts, e.first, triangle))
    shine = mean(element_texture(scene, g, cuts, e.first, triangle, "emission_texture", np.ones((len(triangle), 3))))
    emits = key[:, 1] >= len(scene.materials)
    emitter = np.where(emits, key[:, 1] - len(scene.materials), -1).astype(np.int32)
    has_back = np.bincount(patch, g.two_sided[triangle], front) > 0
    backs = np.flatnonzero(has_back)
    back_number = np.full(front, -1, dtype=np.int32)
    back_number[backs] = front + np.arange(len(backs))
    emitter = np.concatenate([emitter, np.full(len(backs), -1, dtype=np.int32)])  # emitters shine from their front only
    shine = np.concatenate([shine, shine[backs]])
    exitance, engine_exitance = exitance_of(scene.meshes, emitter, shine)
    centre = mean(e.centre)
    return Patches(
        area=np.concatenate([area, area[backs]]),
        centroid=np.concatenate([centre, centre[backs]]),
        normal=np.concatenate([normal, -normal[backs]]),
        albedo=np.concatenate([albedo, albedo[backs]]),
        exitance=exitance,
        engine_exitance=engine_exitance,
        emitter=emitter,
        shine=shine,
        front=front,
        cuts=cuts,
        first_element=e.first,
        element_triangle=triangle,
        element_patch=patch.astype(np.int32),
        element_back=np.where(g.two_sided[triangle], back_number[patch], -1).astype(np.int32),
        order=order,
        cumulative=np.concatenate([[0.0], np.cumsum(weight[order])]),
        start=start,
        twin=np.concatenate([np.arange(front), backs]).astype(np.int32),
        key=key,
    )


def exitance_of(meshes: Sequence[Mesh], emitter: I32, shine: F64) -> tuple[F64, F64]:
    """Exitance (P, 3), W·m⁻², of patches that shine as mesh `emitter` (P,): tagged `input`, and tagged `engine`."""
    emission = np.pi * np.stack([m.emission for m in meshes])[emitter] * shine
    emission[emitter < 0] = 0.0
    engine = np.array([m.engine_lit for m in meshes])[emitter][:, None]
    return np.where(engine, 0.0, emission), np.where(engine, emission, 0.0)


def _element_albedo(scene: Scene, g: Geometry, cuts: I32, first: I64, triangle: I32) -> F64:
    """Albedo (E, 3) for the radiosity: of the material, or of its texture averaged over the element."""
    owner = g.mesh[triangle]
    material = np.array([m.material for m in scene.meshes])[owner]
    plain = np.stack([m.albedo for m in scene.materials])[material]
    colour = element_texture(scene, g, cuts, first, triangle, "texture", plain)
    order = np.argsort(material, kind="stable")
    ends = np.searchsorted(material[order], np.arange(len(scene.materials) + 1))
    for number, (begin, end) in enumerate(pairwise(ends)):
        mine = order[begin:end]
        colour[mine] = baked_albedo(scene.materials[number], colour[mine])
    return colour


def surface_samples(g: Geometry, p: Patches, rows: I64, uvw: npt.NDArray[np.floating]) -> tuple[F64, F64]:
    """Area-stratified points on patches and the normals there.

    rows (R,) patch numbers; uvw (R, N, 3) uniform: the first picks the element by area, the others the point in it.
    Returns points (R, N, 3) m and unit normals (R, N, 3) on the patch's side.
    """
    n = uvw.shape[1]
    twin = p.twin[rows]
    lo, hi = p.cumulative[p.start[twin]], p.cumulative[p.start[twin + 1]]
    # Stratify over the area: stratum n of N, in an order of its own so that place and direction do not correlate.
    stratum = (np.arange(n) * _coprime(n)) % n
    target = lo[:, None] + (hi - lo)[:, None] * (stratum[None, :] + uvw[..., 0]) / n
    position = np.searchsorted(p.cumulative, target, side="right") - 1
    position = np.clip(position, p.start[twin][:, None], p.start[twin + 1][:, None] - 1)
    element = p.order[position].ravel()
    triangle = p.element_triangle[element]
    uv = points_in_elements(p.cuts, p.first_element, triangle, element, uvw[..., 1:].reshape(-1, 2))
    side = np.where(np.repeat(rows, n) >= p.front, -1.0, 1.0)[:, None]
    shape = (len(rows), n, 3)
    return points_on_triangles(g, triangle, uv).reshape(shape), (side * g.normals[triangle]).reshape(shape)


def _coprime(n: int) -> int:
    step = max(1, round(n * 0.6180339887))
    while math.gcd(step, n) != 1:
        step += 1
    return step
