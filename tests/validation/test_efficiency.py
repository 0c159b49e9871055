"""Placement efficiency: lazy uniform grids against whole ones, and the cost of an error along a known curve."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.datatypes import F64, Scene
from lightgauge.reference.progress import silent
from lightgauge.reference.truth.points import Points
from lightgauge.reference.variant import ensure_variant
from lightgauge.reference.volume.sampler import sample
from lightgauge.validation.efficiency.curve import GridRow, cost_at
from lightgauge.validation.efficiency.eta import eta
from lightgauge.validation.efficiency.lazy_grid import census, sample_grid
from lightgauge.validation.metrics.error import Measured
from small_scenes import box, material, scene

KEY = ("camera", "total")
Room = tuple[Scene, pipeline.Surfaces, pipeline.PatchLight]


@pytest.fixture(scope="module")
def room() -> Room:
    ensure_variant()
    made = scene(
        [box([0, 0, 0], [2, 2, 2], emission=[1.0, 0.5, 0.2]), box([0.6, 0, 0.7], [1.2, 1.1, 1.5], inward=False)],
        [material(0.5)],
        placement={"probe_noise": 0.005},
        radiosity={"patch_size": 0.4},
    )
    surfaces = pipeline.bake_surfaces(made, 0)
    return made, surfaces, pipeline.light_patches(made, surfaces, 0)


def on_surfaces(count: int) -> Points:
    """Points on the floor and on the block's sides, and free ones above and inside of it."""
    rng = np.random.default_rng(1)
    positions = rng.random((count, 3)) * [2, 0, 0.6]
    normals = np.tile([0.0, 1.0, 0.0], (count, 1))
    side = np.arange(count) % 2 == 0
    positions[side] = [0.6, 0.0, 0.7] + rng.random((int(side.sum()), 3)) * [0.0, 1.0, 0.8]
    normals[side] = [-1.0, 0.0, 0.0]
    mesh = np.where(np.arange(count) % 5 == 0, -1, 0).astype(np.int32)
    positions[mesh < 0] = [0.7, 0.1, 0.8] + rng.random((int((mesh < 0).sum()), 3)) * [0.4, 1.6, 0.6]
    return Points(positions, normals, mesh)


def test_a_lazy_grid_is_the_whole_grid_where_it_is_read(room: Room) -> None:
    made, surfaces, light, voxel = *room, 0.23
    points = on_surfaces(300)
    octree = pipeline.place_uniform(made, surfaces, voxel)
    probes = pipeline.bake_probes(made, surfaces, octree, 0, silent)
    texels = pipeline.tile_texels(
        probes,
        pipeline.update(made, surfaces, probes, light).coefficients,
        np.where(probes.valid, np.arange(len(probes.valid)), -1).astype(np.int32),
    )
    lift = np.where(points.mesh >= 0, 0.5 * voxel, 0.0)[:, None] * points.normals
    whole = sample(pipeline.virtual_texture(probes, texels), points.positions + lift, points.normals)
    lazy = sample_grid(made, surfaces, light, octree.grid, points, (0.0, 0.5), 0)[1]
    assert (whole.level > 0).all()
    assert (whole.level < octree.grid.level).any()  # some ask the grid of twice the spacing
    # Their rays differ: a row's light is known to 0.5 %, and the two are independent.
    difference = np.abs(lazy - whole.irradiance).mean(axis=1) / lazy.mean()
    assert np.sqrt((difference**2).mean()) < 0.01
    counted = census(made, surfaces, light, octree.grid, 0)
    assert counted.probes == len(probes.valid)
    assert counted.valid_share == pytest.approx(probes.valid.mean(), abs=4 * 0.5 / np.sqrt(len(probes.valid)))


def power_law(cost: F64) -> list[GridRow]:
    """Error = cost^(-1/3)."""
    spread = {KEY: 0.0}
    return [
        GridRow(1.0 / c, {"probes": c, "valid_probes": c / 2, "bytes": c, "entries": c}, {KEY: c ** (-1 / 3)}, spread)
        for c in cost
    ]


def test_the_cost_of_an_error_follows_the_curve() -> None:
    curve = power_law(np.array([10.0, 80.0, 640.0]))
    for error in (0.45, 0.3, 0.12):
        assert cost_at(curve, KEY, "probes", error).cost == pytest.approx(error**-3)
        assert cost_at(curve, KEY, "valid_probes", error).cost == pytest.approx(error**-3 / 2)
    assert cost_at(curve, KEY, "probes", 0.9).bound == "at most"
    assert cost_at(curve, KEY, "probes", 0.01).bound == "at least"
    assert cost_at(curve, KEY, "probes", 0.01).cost == 640.0


def test_a_finer_grid_never_counts_as_worse() -> None:
    rows = power_law(np.array([10.0, 80.0, 640.0]))
    rows[1].error[KEY] = 0.9
    assert cost_at(rows, KEY, "probes", 0.3).cost == pytest.approx(
        np.exp(np.interp(np.log(0.3), np.log([640 ** (-1 / 3), 10 ** (-1 / 3)]), np.log([640.0, 80.0])))
    )


def test_eta_loses_what_a_larger_error_would_save_a_grid() -> None:
    curve = power_law(np.array([10.0, 80.0, 640.0]))
    found = eta(curve, KEY, "probes", 5.0, Measured(0.2, 0.01, 100))
    assert found.value == pytest.approx(0.2**-3 / 5.0)
    assert found.se == pytest.approx((0.2**-3 - 0.21**-3) / 5.0)
    noisy = [dataclasses.replace(row, se={KEY: 0.03}) for row in curve]
    worse = 0.2 + np.hypot(0.01, 0.03)
    assert eta(noisy, KEY, "probes", 5.0, Measured(0.2, 0.01, 100)).se == pytest.approx((0.2**-3 - worse**-3) / 5.0)
    assert found.bound == ""
