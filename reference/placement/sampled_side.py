"""Where surfaces are sampled: on the side that light leaves, up to the sample offset along the normal.

A face of a one-sided material is never sampled from behind, where a room's lattice would otherwise spend a layer of voxels beyond its
walls, most of their probes invalid ("model no more than a scene needs").
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, Mesh, Scene


def sampled_side(scene: Scene, mesh: Mesh, offset: float) -> tuple[F64, F64]:
    """Triangles (F, 3, 3) m and reaches (F, 3) m: every sample up to `offset` m off the mesh is that near, per axis, to one of them.

    {p + t n, 0 ≤ t ≤ o} lies within o/2 |n| of the triangle moved to its middle; of two-sided material, |t| ≤ o within o |n| of it.
    """
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    if scene.materials[mesh.material].two_sided:
        return corners, offset * np.abs(normals)
    return corners + 0.5 * offset * normals[:, None], 0.5 * offset * np.abs(normals)
