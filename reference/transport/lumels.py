"""Lumels: the pieces of a lightmapped mesh that each hold one irradiance. Triangles longer than the lumel's edge are cut
into k² equal elements, and every element is a lumel of its own: no unwrap is needed to bake, and none is implied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..datatypes import F64, I32, Scene
from ..visibility import Geometry
from .elements import cuts_for
from .receivers import AreaReceivers, area_receivers, element_corners


@dataclass(frozen=True, eq=False)
class Lumels:
    """corners (N, 3, 3) m, front side counter-clockwise; normals (N, 3); mesh (N,) i32: index into Scene.meshes."""

    corners: F64
    normals: F64
    mesh: I32

    @property
    def count(self) -> int:
        """Number of lumels."""
        return len(self.mesh)

    @property
    def centres(self) -> F64:
        """Centroids (N, 3) m."""
        return np.asarray(self.corners.mean(axis=1))


def build_lumels(scene: Scene, g: Geometry) -> Lumels:
    """Lumels of all static meshes whose settings give a `lumel_size`."""
    sizes = [s.lumel_size if (s := scene.settings.meshes.get(m.name)) else None for m in scene.meshes]
    size = np.array([np.inf if s is None else s for s in sizes])[g.mesh]
    wanted = np.isfinite(size)
    cuts = np.where(wanted, cuts_for(g, size), 0).astype(np.int32)
    squared = cuts.astype(np.int64) ** 2
    first = np.concatenate([[0], np.cumsum(squared)])
    triangle = np.repeat(np.arange(len(cuts), dtype=np.int32), squared)
    corners = element_corners(g, cuts, first, triangle, np.arange(len(triangle)))
    return Lumels(corners, g.normals[triangle], g.mesh[triangle])


def lumel_receivers(g: Geometry, lumels: Lumels) -> AreaReceivers:
    """Lumels as receivers of light on their front."""
    begin = np.arange(lumels.count)
    return area_receivers(g, lumels.corners, lumels.normals, begin, begin + 1)
