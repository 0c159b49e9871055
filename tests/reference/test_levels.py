"""Levels of detail by distance, and the complete set of probes of each."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import SHIFT, make_grid
from lightgauge.reference.placement.octree import uniform_octree
from lightgauge.reference.texture_types import Viewer
from lightgauge.reference.volume.layout import build_layout
from lightgauge.reference.volume.levels import complete_sets, lod_of_distance, ring_lod
from small_scenes import random_tree


def test_each_level_serves_twice_as_far_as_the_one_below() -> None:
    near = np.array([0.0, 1.0, 9.9, 10.0, 10.1, 20.0, 20.1, 40.0, 40.1, 80.0, 80.1, 1e9, np.inf])
    assert lod_of_distance(near, 10.0, 4).tolist() == [4, 4, 4, 4, 3, 3, 2, 2, 1, 1, 1, 1, 1]
    assert lod_of_distance(near, 10.0, 1).tolist() == [1] * len(near)


def test_ends_of_a_level_are_exact_and_lods_never_rise_with_distance() -> None:
    """d₀ 2^k belongs to the finer level, whatever d₀ is."""
    for d0 in (0.1, 1 / 3, 7.7, 1e4):
        ends = d0 * 2.0 ** np.arange(8)
        assert lod_of_distance(ends, d0, 9).tolist() == [9 - k for k in range(8)]
        assert lod_of_distance(np.nextafter(ends, np.inf), d0, 9).tolist() == [8 - k for k in range(8)]
        ladder = lod_of_distance(np.linspace(0, 1e3 * d0, 10_000), d0, 9)
        assert (np.diff(ladder) <= 0).all() and ladder.dtype == np.int32


def test_what_is_no_distance() -> None:
    assert lod_of_distance(np.array([np.nan]), 1.0, 5).tolist() == [1]
    assert lod_of_distance(np.zeros(0), 1.0, 5).shape == (0,)
    for distance, d0, levels in ((-1.0, 1.0, 5), (1.0, 0.0, 5), (1.0, np.nan, 5), (1.0, 1.0, 0)):
        with pytest.raises(ValueError, match="must"):
            lod_of_distance(np.array([distance]), d0, levels)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_complete_set_is_what_the_tiles_of_its_levels_read(seed: int) -> None:
    tree = random_tree(5, 0.4, seed)
    layout = build_layout(tree)
    read = [np.unique(np.concatenate([p.ravel() for p in layout.probe[: i + 1]])) for i in range(tree.grid.level)]
    assert complete_sets(tree).tolist() == [int((r >= 0).sum()) for r in read]


def test_a_uniform_grid_is_one_set() -> None:
    tree = uniform_octree(make_grid(np.zeros(3), np.ones(3), 0.25, SHIFT))
    assert complete_sets(tree).tolist() == [0] * (tree.grid.level - 1) + [len(tree.corners)]


def test_the_kernels_way_to_a_level_of_detail_is_the_distances() -> None:
    """By the exponent of the squared distance, in single precision: the same but within rounding of a ring's edge."""
    rng = np.random.default_rng(0)
    anchor = np.array([5e4, -3.0, 7e4])
    local = (rng.normal(size=(100_000, 3)) * 10.0 ** rng.uniform(-3, 4, (100_000, 1))).astype(np.float32)
    eye = Viewer(anchor + np.array([1.5, 2.5, -0.5]), 7.7)
    lod, share = ring_lod(local, eye, anchor, 9)
    away = np.linalg.norm(local.astype(np.float64) - [1.5, 2.5, -0.5], axis=1)
    edge = np.abs(np.log2(np.maximum(away, 1e-9) / 7.7) - np.round(np.log2(np.maximum(away, 1e-9) / 7.7))) < 1e-6
    np.testing.assert_array_equal(lod[~edge], lod_of_distance(away[~edge], 7.7, 9))
    assert edge.mean() < 1e-3 and not share.any() and len(np.unique(lod)) == 9


def test_the_blend_band_rises_from_nothing_to_one_at_the_end_of_each_ring() -> None:
    eye = Viewer(np.zeros(3), 4.0, 0.25)
    d = np.array([0.0, 2.9, 3.0, 3.5, 3.999, 4.001, 5.9, 6.0, 7.0, 7.999, 8.5, 31.0, 1e6])
    lod, share = ring_lod(np.column_stack([d, 0 * d, 0 * d]).astype(np.float32), eye, np.zeros(3), 4)
    assert lod.tolist() == [4, 4, 4, 4, 4, 3, 3, 3, 3, 3, 2, 1, 1]
    np.testing.assert_allclose(share[:11], [0, 0, 0, 0.5, 0.999, 0, 0, 0, 0.5, 0.9995, 0], atol=1e-6)
    assert not share[11:].any(), "no level is coarser than the first"


def test_who_cannot_be_a_viewer() -> None:
    for position, distance, blend in (
        ([0, 0], 1.0, 0.0),
        ([0, 0, np.nan], 1.0, 0.0),
        ([0, 0, 0], 0.0, 0.0),
        ([0, 0, 0], 1.0, 1.5),
    ):
        with pytest.raises(ValueError, match=r"expected a position|must be above"):
            Viewer(np.array(position, float), distance, blend)
