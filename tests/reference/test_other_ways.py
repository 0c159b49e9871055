"""Other ways to read the probes, as specified: limits in which they are the plain sampler, bounds, and what they are for."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import OCTANTS
from lightgauge.reference.octahedral import bordered_index
from lightgauge.reference.texture_types import DistanceMaps, VirtualTexture
from lightgauge.reference.transport.distance_moments import REACH, distance_moments
from lightgauge.reference.visibility import build_geometry
from lightgauge.reference.volume.layout import TileLayout
from lightgauge.reference.volume.other_ways import answering, fixed_point, mesh_light, per_mesh
from lightgauge.reference.volume.other_ways_ratio import encode, ratio_l1, unrounded
from lightgauge.reference.volume.other_ways_visibility import chebyshev, served_places, visibility
from lightgauge.reference.volume.sampler import sample
from small_scenes import box, random_probes, random_tree, random_units, scene, texture_of, tree_of

Texture = tuple[VirtualTexture, TileLayout]


def made(invalid: float, seed: int = 11) -> Texture:
    """Four levels with holes; L1 within what radiance that is not negative has."""
    tree = random_tree(4, 0.45, seed)
    probes = random_probes(len(tree.corners), invalid, seed)
    probes[:, [1, 2, 3, 5, 6, 7, 9, 10, 11]] -= probes[:, 12:]
    return texture_of(tree, probes)


def asked(count: int, seed: int, side: float = 16.0) -> tuple[np.ndarray, np.ndarray]:
    p = np.random.default_rng(seed).uniform(-0.5, side + 0.5, (count, 3)).astype(np.float32)
    p[7] = np.nan
    return p, random_units(count, seed + 1).astype(np.float32)


@pytest.mark.parametrize("invalid", [0.0, 0.25])
def test_with_fine_fractions_it_is_the_plain_sampler(invalid: float) -> None:
    texture, _ = made(invalid)
    p, n = asked(20_000, 1)
    plain, found = sample(texture, p, n), fixed_point(texture, p, n, bits=23)
    np.testing.assert_array_equal(plain.level, found.level)
    np.testing.assert_allclose(found.irradiance, plain.irradiance, atol=3e-6)
    assert np.isnan(found.irradiance[7]).all() and not np.isnan(np.delete(found.irradiance, 7, axis=0)).any()


def test_eight_bits_stay_within_their_bound_where_all_are_valid() -> None:
    """failure-catalogue E1: a fraction is off by 2^-9 at most, so a value by 3 · 2^-9 of what the corners span."""
    texture, _ = made(0.0)
    p, n = asked(50_000, 2)
    plain, found, at = sample(texture, p, n), fixed_point(texture, p, n), answering(texture, p)
    off = np.delete(np.abs(found.irradiance - plain.irradiance), 7, axis=0)
    light = texture.texels[..., :12].reshape(-1, 3, 4)[at.corners]
    w = np.concatenate([np.full((len(n), 1), np.sqrt(np.pi) / 2), np.sqrt(np.pi / 3) * n[:, [1, 2, 0]]], axis=1)
    span = np.ptp(np.einsum("nick,nk->nic", light, w), axis=1)
    assert (off <= np.delete(span, 7, axis=0) * 3 / 512 + 1e-5).all()
    assert np.percentile(off, 99) / np.nanmean(plain.irradiance) < 0.007


def test_with_weights_eight_bits_err_more_where_little_is_valid() -> None:
    """failure-catalogue E1: light over weight, both small: a fraction's last bit decides."""
    texture, _ = made(0.25)
    p, n = asked(100_000, 3)
    plain, found = sample(texture, p, n), fixed_point(texture, p, n)
    same = (plain.level == found.level) & (plain.level > 0)
    off = np.abs(found.irradiance - plain.irradiance).mean(axis=1) / plain.irradiance[same].mean()
    assert np.percentile(off[same], 99) < 0.012 and 0.02 < off[same].max() < 0.6
    worst = off[same] > 0.02
    assert plain.weight[same][worst].max() < 0.25


def test_light_of_one_mesh_is_what_is_at_its_middle() -> None:
    texture, _ = made(0.25)
    p, _ = asked(40, 4)
    p = np.delete(p, 7, axis=0)
    n, mesh = (
        random_units(500, 5).astype(np.float32),
        np.random.default_rng(6).integers(0, len(p), 500).astype(np.int32),
    )
    got = per_mesh(mesh_light(texture, p), mesh, n)
    np.testing.assert_allclose(got, sample(texture, p[mesh], n).irradiance, atol=3e-6)


def test_ratios_alike_everywhere_filter_exactly_and_others_do_not() -> None:
    tree = random_tree(4, 0.45, 11)
    rng = np.random.default_rng(7)
    base, shape = rng.random((len(tree.corners), 1)) + 0.2, np.array([1.0, 0.7, -0.5, 0.9])
    probes = np.concatenate([np.tile(base * shape, 3), np.ones_like(base)], axis=1).astype(np.float32)
    alike, _ = texture_of(tree, probes)
    p, n = asked(20_000, 8)
    plain = sample(alike, p, n).irradiance
    np.testing.assert_allclose(unrounded(alike, p, n).irradiance, plain, atol=2e-6)
    rounded = np.abs(ratio_l1(alike, encode(alike), p, n).irradiance - plain)
    first = np.sqrt(np.pi) / 2 * 1.2
    step = np.sqrt(np.pi / 3) * np.sqrt(3) * np.sqrt(3) / 255 * 1.2  # half a step of three ratios, twice for range
    assert 1e-4 < np.nanmax(rounded) < step + first * 2.0**-10
    other, _ = made(0.0)
    assert np.nanmax(np.abs(unrounded(other, p, n).irradiance - sample(other, p, n).irradiance)) > 0.02


def test_ratio_texels_are_sixteen_bytes() -> None:
    texture, _ = made(0.25)
    texels = encode(texture)
    assert texels.bytes == 16 * texture.texels.shape[0] * 27
    assert not texels.base[texels.weight == 0].any()


def open_maps(layout: TileLayout, value: float = REACH) -> DistanceMaps:
    """Nothing nearer than `value` voxels, in any direction."""
    places, _, number = served_places(layout)
    side = len(bordered_index(4))
    moments = np.empty((len(places), side, side, 2), np.float16)
    moments[..., 0], moments[..., 1] = value, value * value
    return DistanceMaps(moments, number)


def test_served_places_are_the_texels() -> None:
    texture, layout = made(0.0)
    places, voxel, number = served_places(layout)
    assert number.shape == texture.texels.shape[:2] and len(np.unique(number)) == len(places)
    real = np.concatenate(layout.probe) >= 0
    tree = random_tree(4, 0.45, 11)
    np.testing.assert_array_equal(places[number[real]], tree.positions[np.concatenate(layout.probe)[real]])
    assert set(np.unique(voxel)) == {1.0, 2.0, 4.0, 8.0}
    nothing = np.zeros((0, 3), np.int64)
    bare = tree_of([np.zeros((1, 3), np.int64), OCTANTS, nothing])
    _, layout = texture_of(bare, random_probes(len(bare.corners), 0.0, 1))
    places, voxel, number = served_places(layout)  # a level without tiles
    assert len(places) == 27 and set(voxel) == {2.0} and number.shape == (1, 27)


def test_seen_probes_count_by_where_they_lie_alone() -> None:
    """v = 1: the weight is ((1 + cos) / 2)² + 0.2; straight behind 0.2, which is not crushed yet; a probe at the sample counts 0.45."""
    moments = np.full((1, 6, 6, 2), REACH, np.float16)
    moments[..., 1] = REACH**2
    towards = np.float32([[0, 1, 0], [0, -1, 0], [0.5, 0, 0], [0, 0, 0]])
    up = np.tile(np.float32([[0, 1, 0]]), (4, 1))
    np.testing.assert_allclose(
        visibility(moments, np.zeros(4, np.int64), towards, up), [1.2, 0.2, 0.45, 0.45], rtol=1e-6
    )


def test_hidden_probes_are_bounded_and_crushed() -> None:
    """Surfaces at 0.5 ± 0.1 voxels, the sample at 1: v = 0.01 / (0.01 + 0.25), u = 1.2 · 0.05 = 0.06, crushed to 0.06³ / 0.04."""
    moments = np.empty((1, 6, 6, 2), np.float16)
    moments[..., 0], moments[..., 1] = 0.5, 0.26
    one, up = np.zeros(1, np.int64), np.float32([[0, 1, 0]])
    np.testing.assert_allclose(visibility(moments, one, np.float32([[0, 1, 0]]), up), 0.06**3 / 0.04, rtol=1e-4)
    assert visibility(moments, one, np.float32([[0, 0.49, 0]]), up)[0] == pytest.approx(1.2)


def test_the_same_light_everywhere_stays_the_same() -> None:
    tree = random_tree(4, 0.45, 11)
    probes = random_probes(len(tree.corners), 0.25, 11)
    probes[:, :12] = np.tile([1.0, 0.2, 0.1, -0.3], 3) * probes[:, 12:]
    texture, layout = texture_of(tree, probes)
    p, n = asked(5000, 9)
    plain = sample(texture, p, n)
    for value in (0.2, REACH):
        found = chebyshev(texture, open_maps(layout, value), p, n)
        np.testing.assert_array_equal(found.level, plain.level)
        np.testing.assert_allclose(found.irradiance, plain.irradiance, rtol=1e-4, atol=1e-5)


def test_no_light_through_a_wall_between_two_rooms() -> None:
    """Probes left of a wall are lit, those right of it dark; the wall is far thinner than a voxel. Plain interpolation leaks."""
    every = [np.stack(np.meshgrid(*[np.arange(1 << n)] * 3, indexing="ij"), -1).reshape(-1, 3) for n in range(4)]
    tree = tree_of(every)
    probes = np.zeros((len(tree.corners), 13), np.float32)
    probes[:, 12], probes[tree.corners[:, 0] <= 3, :12] = 1.0, np.tile([1.0, 0, 0, 0], 3)
    texture, layout = texture_of(tree, probes)
    g = build_geometry(scene([box((-1, -1, -1), (3.45, 9, 9)), box((3.55, -1, -1), (9, 9, 9))]))
    places, voxel, number = served_places(layout)
    maps = DistanceMaps(distance_moments(g, places, voxel), number)
    n = np.tile([1.0, 0.0, 0.0], (2000, 1))
    for low, share in (
        (3.56, 0.1),
        (3.6, 0.02),
        (3.7, 1e-3),
    ):  # at the wall itself, distances of its two sides are too alike
        p = np.random.default_rng(1).uniform((low, 1, 1), (4, 7, 7), (2000, 3))
        leak, kept = sample(texture, p, n).irradiance.mean(), chebyshev(texture, maps, p, n).irradiance.mean()
        assert leak > 0.1 and kept < share * leak
    p[:, 0] = np.random.default_rng(2).uniform(3, 3.35, 2000)
    np.testing.assert_allclose(chebyshev(texture, maps, p, -n).irradiance[:, 0], np.sqrt(np.pi) / 2, rtol=0.01)
