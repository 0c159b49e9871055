"""Pictures on surfaces: their texels, and their means over elements."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..datatypes import F64, I32, I64, Scene
from ..visibility import Geometry
from .elements import corners_of_elements

LEAST_POINTS = 4
POINTS_PER_TEXEL = 16
MOST_POINTS = 1 << 12  # of an element
MOST_LOOKUPS = 1 << 22  # of a mesh
LOOKUPS_AT_ONCE = 1 << 18
# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g and 1/g² of the plastic number g. Not a dyadic net:
# pictures have sizes of powers of two, and would meet it in step.
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])


def element_texture(scene: Scene, g: Geometry, cuts: I32, first: I64, triangle: I32, name: str, plain: F64) -> F64:
    """Picture `name` of the materials averaged over each element (E, 3), by POINTS_PER_TEXEL points for each texel that the element
    covers, as far as MOST_POINTS and MOST_LOOKUPS allow; `plain` (E, 3) where there is none. triangle: (E,) of each element.

    A texel finer than the points would alias: a chequerboard then counts as one of its two colours (failure-catalogue B6).
    """
    owner, colour = g.mesh[triangle], plain.copy()
    for number, mesh in enumerate(scene.meshes):
        texture = getattr(scene.materials[mesh.material], name, None)
        if texture is None or mesh.uvs is None:
            continue
        mine = np.flatnonzero(owner == number)
        if len(mine) == 0:
            continue
        own = mesh.uvs[mesh.faces[triangle[mine] - int(np.argmax(g.mesh == number))]].astype(np.float64)
        within = corners_of_elements(cuts, first, triangle[mine], mine)
        corner = own[:, None, 0] + within @ (own[:, 1:] - own[:, :1])
        colour[mine] = _means(texture, corner)
    return colour


def _means(texture: npt.NDArray[np.floating], corner: F64) -> F64:
    """Mean of the picture (E, 3) over triangles of texture coordinates (E, 3, 2)."""
    counts = _points(corner, texture)
    sequence = (0.5 + np.arange(1, int(counts.max()) + 1)[:, None] * PLASTIC) % 1.0
    ends = np.cumsum(counts)
    out = np.empty((len(corner), 3))
    begin = 0
    while begin < len(corner):
        done = ends[begin] - counts[begin]
        end = max(begin + 1, int(np.searchsorted(ends, done + LOOKUPS_AT_ONCE, side="right")))
        some, start = counts[begin:end], ends[begin:end] - counts[begin:end] - done
        of = np.repeat(np.arange(begin, end), some)
        a, b = sequence[np.arange(len(of)) - np.repeat(start, some)].T
        fold = a + b > 1.0
        a, b = np.where(fold, 1.0 - a, a)[:, None], np.where(fold, 1.0 - b, b)[:, None]
        uv = (1.0 - a - b) * corner[of, 0] + a * corner[of, 1] + b * corner[of, 2]
        out[begin:end] = np.add.reduceat(nearest_texel(texture, uv), start, axis=0) / some[:, None]
        begin = end
    return out


def _points(corner: F64, texture: npt.NDArray[np.floating]) -> I64:
    """How many points each triangle (E, 3, 2) of texture coordinates gets, (E,)."""
    edges = (corner[:, 1:] - corner[:, :1]) * np.array([texture.shape[1], texture.shape[0]])
    texels = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    wanted = np.minimum(POINTS_PER_TEXEL * texels, MOST_POINTS)
    wanted *= min(1.0, MOST_LOOKUPS / max(float(wanted.sum()), 1.0))
    return np.maximum(np.ceil(wanted), LEAST_POINTS).astype(np.int64)


def nearest_texel(texture: npt.NDArray[np.floating], uv: F64) -> F64:
    """Nearest texel (N, 3) at texture coordinates (N, 2), repeating; row 0 is v = 1."""
    height, width = texture.shape[:2]
    column = np.floor(uv[:, 0] * width).astype(int) % width
    row = np.floor((1.0 - uv[:, 1]) * height).astype(int) % height
    return np.asarray(texture[row, column, :3], dtype=np.float64)
