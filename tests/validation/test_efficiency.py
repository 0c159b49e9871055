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
from lightgauge.validation.efficiency.paired import paired_eta
from small_scenes import box, material, scene

KEY = ("camera", "total")
BLOCKS = 20
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
        GridRow(
            1.0 / c,
            {"probes": c, "valid_probes": c / 2, "bytes": c, "entries": c},
            {KEY: c ** (-1 / 3)},
            spread,
            {KEY: np.full((2, BLOCKS), c ** (-2 / 3))},
        )
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
    curve, even = power_law(np.array([10.0, 80.0, 640.0])), np.full(BLOCKS, 0.04)
    found = eta(curve, KEY, "probes", 5.0, 0.2, even, 0.01)
    assert found.value == pytest.approx(0.2**-3 / 5.0) and found.bound == ""
    assert found.se == pytest.approx((0.2**-3 - 0.21**-3) / 5.0)
    assert found.interval == pytest.approx((0.2196**-3 / 5.0, 0.1804**-3 / 5.0))
    noisy = [dataclasses.replace(row, se={KEY: 0.03}) for row in curve]
    worse = 0.2 + np.hypot(0.01, 0.03)
    assert eta(noisy, KEY, "probes", 5.0, 0.2, even, 0.01).se == pytest.approx((0.2**-3 - worse**-3) / 5.0)
    blurred = eta(curve, KEY, "probes", 5.0, 0.2, even, 0.06)
    assert blurred.interval == pytest.approx((0.3176**-3 / 5.0, 640.0 / 5.0))


def test_points_that_are_hard_for_both_do_not_blur_eta() -> None:
    """Blocks whose error differs tenfold: where the grid finds the same ones hard nothing is open, where it finds others hard it is."""
    hard = np.linspace(0.1, 1.9, BLOCKS)
    curve = [
        dataclasses.replace(row, blocks={KEY: row.blocks[KEY] * hard})
        for row in power_law(np.array([40.0, 125.0, 400.0]))
    ]
    same, other = (eta(curve, KEY, "probes", 5.0, 0.2, 0.04 * by) for by in (hard, hard[::-1]))
    assert same.value == other.value and same.se == pytest.approx(0.0, abs=1e-12)
    # twice the standard error of one: sd of the mean of `hard` is 0.124, and the error goes with its root
    assert other.interval[0] == pytest.approx((0.2 + 1.96 * 2 * 0.2 * 0.124 / 2.0) ** -3 / 5.0, rel=0.02)


def noisy_grids(rng: np.random.Generator, placements: int, common: F64) -> tuple[F64, list[float], list[F64]]:
    """Ours and grids whose mean squared errors are those of `power_law`, ours as good as three times its 80 probes, times noise of each
    placement (30 %) and of each block of points, the same for all (`common` (B,))."""
    costs = [80.0, 160.0, 320.0, 640.0, 1280.0]

    def squares(cost: float) -> F64:
        each = np.exp(0.3 * rng.normal(size=(placements, 1)) + 0.05 * rng.normal(size=(placements, len(common))))
        return np.asarray(cost ** (-2 / 3) * each * common)

    return squares(240.0), costs, [squares(cost) for cost in costs]


def test_paired_eta_is_exact_on_a_power_law() -> None:
    ones = np.ones((2, 4))
    costs = [60.0, 120.0, 240.0, 480.0]
    found = paired_eta(50.0, 150.0 ** (-2 / 3) * ones, costs, [c ** (-2 / 3) * ones for c in costs])
    assert found is not None and found.value == pytest.approx(3.0) and found.slope == pytest.approx(-1 / 3)
    assert found.se == pytest.approx(0.0, abs=1e-9) and found.grids == 4


def test_paired_eta_is_not_given_beyond_the_grids() -> None:
    ones = np.ones((2, 4))
    costs = [60.0, 120.0, 240.0, 480.0]
    grids = [c ** (-2 / 3) * ones for c in costs]
    assert paired_eta(50.0, 1000.0 ** (-2 / 3) * ones, costs, grids) is None
    assert paired_eta(50.0, 150.0 ** (-2 / 3) * ones, costs[:2], grids[:2]) is None


def test_paired_eta_has_honest_intervals() -> None:
    """What points do to both placements alike does not count, what lattices do does: nine in ten intervals of two standard errors
    hold η, and those are what η scatters by."""
    rng = np.random.default_rng(5)
    held, widths, spread = [], [], []
    for _ in range(40):
        own, costs, grids = noisy_grids(rng, 8, np.exp(rng.normal(size=20)))
        found = paired_eta(80.0, own, costs, grids)
        assert found is not None
        held.append(found.interval[0] <= 3.0 <= found.interval[1])
        widths.append(found.se)
        spread.append(np.log(found.value / 3.0))
    assert np.mean(held) >= 0.72  # 0.924 ± 0.042 are held
    assert 0.47 < np.median(widths) / np.std(spread) < 2.1  # its logarithm is 0.00 ± 0.15
