"""Voxels for samples off a surface: all that are sampled, on the side that is sampled, and hardly another."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import Grid, cells, index_of, keys
from lightgauge.reference.placement.mesh_voxels import mesh_voxels
from lightgauge.reference.placement.sampled_side import sampled_side
from small_scenes import material, quad, scene, sphere_mesh

GRID = Grid(np.array([-1.6, -1.6, -1.6]), 0.2, 4, np.full(3, 16))


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("offset", [0.0, 0.07, 0.35])
def test_every_sample_is_in_a_marked_voxel(two_sided: bool, offset: float) -> None:
    """20,000 samples of a ball: on it, up to the offset outside, and where the material has two sides inside too."""
    ball = sphere_mesh(1.0, 2, inward=False)
    s = scene([ball], [material(0.5, two_sided=two_sided)])
    corners, reach = sampled_side(s, ball, offset)
    marked = mesh_voxels(corners, GRID, GRID.level, reach)
    rng = np.random.default_rng(1)
    triangle, share = rng.integers(len(ball.faces), size=20_000), rng.dirichlet([1.0] * 3, 20_000)
    flat = ball.vertices[ball.faces][triangle]
    normal = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = offset * rng.uniform(-1.0 if two_sided else 0.0, 1.0, (len(flat), 1))
    at = np.einsum("nk,nkc->nc", share, flat) + off * normal
    sampled = np.unique(keys(((at - GRID.origin) / GRID.finest).astype(np.int64)))
    assert (index_of(marked, sampled) >= 0).all()
    assert len(marked) < 1.35 * len(sampled), "of the rest, few: what a triangle touches at a corner alone"


def test_nothing_is_marked_behind_a_one_sided_face() -> None:
    """A floor 0.02 m above a plane of the lattice, sampled up to 0.1 m off: one layer of voxels, its own; two where it is seen from
    below too."""
    floor = quad([[-1, -0.38, -1], [-1, -0.38, 1], [1, -0.38, 1], [1, -0.38, -1]])
    for two_sided, layers in ((False, {6}), (True, {5, 6})):
        corners, reach = sampled_side(scene([floor], [material(0.5, two_sided=two_sided)]), floor, 0.1)
        assert set(cells(mesh_voxels(corners, GRID, GRID.level, reach))[:, 1].tolist()) == layers
