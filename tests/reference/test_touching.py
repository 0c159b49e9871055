"""What the harmonic mean is blind to, and the second criterion that finds it (failure-catalogue C6)."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.config_placement import PlacementSettings
from lightgauge.reference.datatypes import Mesh, Scene
from lightgauge.reference.lattice import Grid, Octree, cells, keys, make_grid
from lightgauge.reference.placement.distance import harmonic_mean
from lightgauge.reference.placement.mesh_voxels import mesh_voxels
from lightgauge.reference.placement.octree import build_octree
from lightgauge.reference.placement.sampled_side import sampled_side
from lightgauge.reference.placement.touching import touched_voxels
from lightgauge.reference.placement.voxel_bitmap import build_bitmap
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, quad, scene, sphere_mesh

FAR = 100.0


def pole(width: float) -> Mesh:
    """A square pole off the walls' centre lines, so that it stands in the middle of no lattice line."""
    return box((5.3, -FAR, 3.1), (5.3 + width, FAR, 3.1 + width), inward=False, name="pole")


def room(width: float) -> Scene:
    """A pole between walls 100 m away, which are not lit by probes."""
    return scene([box((-FAR,) * 3, (FAR,) * 3, name="walls", lit_by_probes=False), pole(width)])


def placed(s: Scene, touching: bool) -> tuple[Octree, Grid]:
    g = build_geometry(s)
    grid = make_grid(g.lower, g.upper, 1.6)
    marks = build_bitmap(s, grid, 0.0)
    touched = touched_voxels(s, grid, marks.occupied, 0.0, grid.level) if touching else ()
    return build_octree(g, grid, marks, PlacementSettings(), 1, touched), grid


def found_share(width: float, touching: bool) -> float:
    """Share of the finest voxels that touch the pole half-way between floor and ceiling which exist."""
    s = room(width)
    tree, grid = placed(s, touching)
    mesh = s.meshes[1]
    wanted = cells(mesh_voxels(mesh.vertices[mesh.faces], grid, grid.level))
    wanted = wanted[np.abs(grid.corner_positions(wanted)[:, 1]) < FAR / 2]
    return float(np.isin(keys(wanted), keys(tree.voxels[-1])).mean())


def test_the_harmonic_mean_is_blind_to_a_pole() -> None:
    """Radius 0.1 m at 2 m, walls at 100 m: 1/HM = w/(8 d²) + 1/R = 1/61.5 m for a pole of width w. Nothing in that number says that
    there is something at 2 m."""
    ball = sphere_mesh(FAR, 4, lit_by_probes=False)
    g = build_geometry(scene([ball, box((-0.1, -99, -0.1), (0.1, 99, 0.1), inward=False)]))
    found = harmonic_mean(g, np.tile([2.1, 0.0, 0.0], (20, 1)), np.arange(20), 4096, 1)
    assert 1 / (1 / found).mean() == pytest.approx(61.5, rel=0.03)


def test_the_smallest_feature_found() -> None:
    """Finest voxels of 1.6 m. By the harmonic mean alone nothing of a pole is found up to 1.6 m, since no coarse voxel sees
    it, part of it at 6.4 m, all from 12.8 m on. With `touching` all of it is, at any width."""
    widths = (0.01, 0.1, 1.6, 6.4, 12.8)
    alone = [found_share(w, touching=False) for w in widths]
    assert alone[:3] == [0.0, 0.0, 0.0] and 0.0 <= alone[3] < 1.0 and alone[4] == 1.0, alone
    assert [found_share(w, touching=True) for w in widths] == [1.0] * len(widths)


def test_geometry_in_the_middle_of_a_voxel() -> None:
    """A small quad half-way between all corners of its voxels, nothing else near: only touching subdivides there."""
    s = scene(
        [
            quad(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1], [0, 0, 0.1]]) + 0.4),
            quad([[-FAR, -FAR, -FAR], [-FAR, -FAR, FAR], [FAR, -FAR, FAR], [FAR, -FAR, -FAR]], lit_by_probes=False),
        ]
    )
    assert len(placed(s, touching=False)[0].voxels[-1]) == 0
    tree, grid = placed(s, touching=True)
    middle = np.floor((0.45 - grid.origin) / grid.finest).astype(int)
    assert tuple(middle) in set(map(tuple, tree.voxels[-1].tolist()))


def test_the_settings_reach_the_octree() -> None:
    """Through `pipeline.place`: touching finds the pole, plain subdivision places as many probes as the other run counted."""

    def run(**placement: object) -> Octree:
        s = room(0.1)
        s = dataclasses.replace(s, settings=scene([], placement={"min_voxel": 6.4, **placement}).settings)
        return pipeline.place(s, SimpleNamespace(geometry=build_geometry(s)), 1)

    blind, seeing = run(), run(touching=True)
    plain = run(touching=True, subdivision="plain")
    assert len(blind.voxels[-1]) < len(seeing.voxels[-1]) <= len(plain.voxels[-1])
    assert len(seeing.corners) < seeing.plain_probes == plain.plain_probes == len(plain.corners)


def test_coarse_voxels_lead_down_even_where_no_corner_is_near() -> None:
    """A small room in the corner of a large root cube, all of whose corners, down to 4 m, stand outside and far from it."""
    room_there = box((0.0,) * 3, (4.6, 2.0, 2.0))
    s = scene([room_there], placement={"min_voxel": 0.6, "rays": 256})
    tree = pipeline.place(s, SimpleNamespace(geometry=build_geometry(s)), 1, np.array([0.1, 3.0, 3.0]))
    alone = build_octree(build_geometry(s), tree.grid, build_bitmap(s, tree.grid, 0.3), s.settings.placement, 1)
    assert [len(v) for v in alone.voxels] == [1] + [0] * tree.grid.level  # what the harmonic mean alone finds
    assert len(tree.voxels[-1]) > 100


@pytest.mark.parametrize("margin", [0.0, 0.7])
def test_touched_voxels_are_those_of_the_surface_within_the_bitmap(margin: float) -> None:
    """Level by level what marking the mesh there would mark, less what the bitmap does not hold; meshes of other kinds
    count for nothing."""
    s = room(2.0)
    grid = make_grid(np.full(3, -FAR), np.full(3, FAR), 3.2)
    occupied = [k[::2] if level == grid.level else k for level, k in enumerate(build_bitmap(s, grid, margin).occupied)]
    found = touched_voxels(s, grid, occupied, margin, grid.level)
    mesh = s.meshes[1]
    for level in range(grid.level + 1):
        corners, reach = sampled_side(s, mesh, margin)
        expected = mesh_voxels(corners, grid, level, reach)
        np.testing.assert_array_equal(found[level], expected[np.isin(expected, occupied[level])])
    assert len(found[-1]) > 20 and (cells(found[-1]) >= 0).all()
    dark = scene([box((-FAR,) * 3, (FAR,) * 3, lit_by_probes=False)])
    assert all(len(k) == 0 for k in touched_voxels(dark, grid, occupied, margin, grid.level))
