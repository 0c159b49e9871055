"""Pictures on surfaces: their texels, and their means over elements."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I32, I64, Scene
from ..visibility import Geometry
from .elements import points_in_elements

LEAST_POINTS = np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3], [1 / 3, 1 / 3]])
POINTS_PER_TEXEL = 16
MOST_POINTS = 1 << 12  # of an element
MOST_LOOKUPS = 1 << 24  # of a mesh
# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g and 1/g² of the plastic number g.
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])


def element_texture(scene: Scene, g: Geometry, cuts: I32, first: I64, triangle: I32, name: str, plain: F64) -> F64:
    """Picture `name` of the materials averaged over each element (E, 3), by POINTS_PER_TEXEL points for each texel that an element of
    the mesh covers at most; `plain` (E, 3) where there is none. triangle: (E,) of each element.

    A texel finer than the points would alias: a chequerboard then counts as one of its two colours (failure-catalogue B6).
    """
    owner, colour = g.mesh[triangle], plain.copy()
    for number, mesh in enumerate(scene.meshes):
        texture = getattr(scene.materials[mesh.material], name, None)
        mine = np.flatnonzero(owner == number)
        if texture is None or mesh.uvs is None or len(mine) == 0:
            continue
        corner = mesh.uvs[mesh.faces[triangle[mine] - int(np.argmax(g.mesh == number))]].astype(np.float64)
        points = _points(corner, cuts[triangle[mine]], texture)
        total = np.zeros((len(mine), 3))
        for xy in points:
            uv = points_in_elements(cuts, first, triangle[mine], mine, np.tile(xy, (len(mine), 1)))
            w = np.column_stack([1.0 - uv.sum(axis=1), uv])
            total += nearest_texel(texture, np.einsum("ni,nic->nc", w, corner))
        colour[mine] = total / len(points)
    return colour


def _points(corner: F64, cuts: I32, texture: npt.NDArray[np.floating]) -> F64:
    """Places (n, 2) in the unit square, for `points_in_elements`. corner (E, 3, 2): texture coordinates of the elements' triangles."""
    edges = (corner[:, 1:] - corner[:, :1]) * np.array([texture.shape[1], texture.shape[0]])
    texels = (
        0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / cuts.astype(np.float64) ** 2
    )
    wanted = min(POINTS_PER_TEXEL * float(texels.max()), MOST_POINTS, MOST_LOOKUPS / len(corner))
    if wanted <= len(LEAST_POINTS):
        return LEAST_POINTS
    # Not a dyadic net: pictures have sizes of powers of two, and would meet it in step.
    return np.asarray((0.5 + np.arange(1, math.ceil(wanted) + 1)[:, None] * PLASTIC) % 1.0)


def nearest_texel(texture: npt.NDArray[np.floating], uv: F64) -> F64:
    """Nearest texel (N, 3) at texture coordinates (N, 2), repeating; row 0 is v = 1."""
    height, width = texture.shape[:2]
    column = np.floor(uv[:, 0] * width).astype(int) % width
    row = np.floor((1.0 - uv[:, 1]) * height).astype(int) % height
    return np.asarray(texture[row, column, :3], dtype=np.float64)
