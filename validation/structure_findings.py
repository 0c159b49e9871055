"""Whether voxels are as fine as surfaces ask, and whether the indirection texture finds their tiles."""

from __future__ import annotations

import numpy as np

from ..reference import pipeline
from ..reference.lattice import keys
from ..reference.placement.touching import leading_level
from .bake import Baked
from .metrics.coarse import measure_coarse, places_on
from .metrics.error import Measured
from .metrics.pointers import measure_pointers


def structure(baked: Baked, seed: int) -> dict[str, Measured]:
    """wrong_pointers, coarse_share and unmet_share of a baked scene; the last two not where no mesh is lit by probes."""
    scene, grid = baked.scene, baked.probes.octree.grid
    marks = pipeline.bitmap(scene, grid)
    lit = np.array([m.lit_by_probes for m in scene.meshes])
    touched = grid.level if scene.settings.placement.touching else leading_level(scene, grid)
    voxels = [keys(v) for v in baked.probes.octree.voxels]
    places = places_on(baked.surfaces.geometry, lit, seed)
    found = measure_pointers(baked.texture, baked.probes.layout, seed)
    return found | measure_coarse(grid, voxels, marks.occupied, marks.placed, touched, places)
