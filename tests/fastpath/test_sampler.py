"""The OpenCL kernel against its specification, the NumPy sampler."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.sampler import Sampler
from lightgauge.reference.datatypes import Samples, VirtualTexture
from lightgauge.reference.volume.sampler import sample
from lightgauge.reference.volume.tiles import Storage, stored
from small_scenes import random_probes, random_tree, random_units, texture_of

STORAGES: tuple[Storage, ...] = ("float32", "half16", "half8")


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@pytest.fixture(scope="module")
def texture() -> VirtualTexture:
    """Levels 0 … 5 with holes, a quarter of the probes invalid, an uneven origin and voxel size."""
    tree = random_tree(5, 0.45, 11)
    made, _ = texture_of(tree, random_probes(len(tree.corners), 0.25, 11))
    return dataclasses.replace(made, origin=np.array([-3.7, 1.3, 12.9]), finest=0.37)


def borders(texture: VirtualTexture) -> np.ndarray:
    """Every corner of the finest lattice, and random points of every face and edge, in metres."""
    n = 1 << texture.level
    grid = np.stack(np.meshgrid(*[np.arange(n + 1.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    parts = [grid]
    for free in ([0], [1], [2], [0, 1], [0, 2], [1, 2]):
        moved = grid.copy()
        moved[:, free] += rng.random((len(grid), len(free)))
        parts.append(moved)
    return np.concatenate(parts) * texture.finest + texture.origin


def agree(got: Samples, plain: Samples, tolerance: float = 1e-5) -> None:
    """Same values to `tolerance` of the mean; same levels. A point at which the weight is within rounding of the least
    one may answer one level apart on either side: at most one in 100,000."""
    scale = float(np.nanmean(np.abs(plain.irradiance)))
    same = got.level == plain.level
    assert (~same).mean() < 1e-5, (~same).sum()
    assert np.array_equal(np.isnan(got.irradiance), np.isnan(plain.irradiance))
    worst = np.nanmax(np.abs(got.irradiance - plain.irradiance)[same]) / scale
    assert worst < tolerance, worst
    np.testing.assert_allclose(got.weight[same], plain.weight[same], atol=2e-6)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_million_random_positions(device: OpenDevice, texture: VirtualTexture, storage: Storage) -> None:
    rng = np.random.default_rng(1)
    high = texture.origin + texture.extent * texture.finest
    p = rng.uniform(texture.origin, high, (1_000_000, 3)).astype(np.float32)
    n = random_units(1_000_000, 2).astype(np.float32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n)
    assert len(np.unique(plain.level)) >= 4, "a texture with several levels"
    agree(Sampler(device, texture, storage)(p, n), plain)


@pytest.mark.parametrize("storage", STORAGES)
def test_faces_edges_corners_and_outside(device: OpenDevice, texture: VirtualTexture, storage: Storage) -> None:
    p = borders(texture)
    rng = np.random.default_rng(3)
    outside = texture.origin + rng.normal(size=(50_000, 3)) * 40
    odd = np.array([[np.inf, 0, 0], [-np.inf, 2, np.inf], [1e30, -1e30, 1e38], [0, 0, 0], [-0.0, -0.0, -0.0]])
    p = np.concatenate([p, outside, odd]).astype(np.float32)
    n = random_units(len(p), 4).astype(np.float32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n)
    agree(Sampler(device, texture, storage)(p, n), plain)


@pytest.mark.parametrize("lod", [1, 2, 3, 4, 5])
def test_every_level_of_detail(device: OpenDevice, texture: VirtualTexture, lod: int) -> None:
    p = (
        np.random.default_rng(5)
        .uniform(texture.origin, texture.origin + 32 * texture.finest, (20_000, 3))
        .astype(np.float32)
    )
    n = random_units(len(p), 6).astype(np.float32)
    got = Sampler(device, texture, "float32")(p, n, lod)
    agree(got, sample(texture, p, n, lod))
    assert got.level.max() <= lod


@pytest.mark.parametrize("storage", ["half16", "half8"])
def test_images_read_the_same(device: OpenDevice, storage: Storage) -> None:
    """Through the device's linear filter. All probes valid and alike in size: 1e-3 of the mean is the filter's fraction."""
    tree = random_tree(5, 0.45, 12)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 12))
    p = np.random.default_rng(7).uniform(0, 32, (200_000, 3)).astype(np.float32)
    n = random_units(len(p), 8).astype(np.float32)
    got, images = Sampler(device, texture, storage)(p, n), Sampler(device, texture, storage, images=True)(p, n)
    np.testing.assert_array_equal(got.level, images.level)
    assert np.abs(got.irradiance - images.irradiance).max() / got.irradiance.mean() < 1e-3


def test_nan_stays_where_it_is(device: OpenDevice, texture: VirtualTexture) -> None:
    p = np.random.default_rng(9).uniform(texture.origin, texture.origin + 5, (1000, 3)).astype(np.float32)
    n = random_units(1000, 10).astype(np.float32)
    sampler = Sampler(device, texture, "half16")
    clean = sampler(p, n)
    bad = p.copy()
    bad[::7, 1] = np.nan
    got = sampler(bad, n)
    expected = clean.irradiance.copy()
    expected[::7] = np.nan
    np.testing.assert_array_equal(got.irradiance, expected)
    assert not got.level[::7].any() and not got.weight[::7].any()


def test_repeats_bit_for_bit_and_counts_time(device: OpenDevice, texture: VirtualTexture) -> None:
    p = np.random.default_rng(11).uniform(texture.origin, texture.origin + 5, (50_000, 3)).astype(np.float32)
    n = random_units(len(p), 12).astype(np.float32)
    sampler = Sampler(device, texture, "half16")
    first = sampler(p, n)
    for _ in range(3):
        np.testing.assert_array_equal(sampler(p, n).irradiance, first.irradiance)
    np.testing.assert_array_equal(Sampler(device, texture, "half16")(p, n).irradiance, first.irradiance)
    assert 0 < sampler.seconds < 10


def test_shapes_are_checked(device: OpenDevice, texture: VirtualTexture) -> None:
    sampler = Sampler(device, texture, "float32")
    empty = sampler(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    assert empty.irradiance.shape == (0, 3) and empty.level.shape == (0,)
    for p, n in (
        (np.zeros((3, 3)), np.zeros((2, 3))),
        (np.zeros((3, 4)), np.zeros((3, 4))),
        (np.zeros(3), np.zeros(3)),
    ):
        with pytest.raises(ValueError, match=r"expected positions and normals \(N, 3\)"):
            sampler(p, n)
    with pytest.raises(ValueError, match="images hold half16 or half8"):
        Sampler(device, texture, "float32", images=True)


@pytest.mark.parametrize("lod", [-1, 6, 99])
def test_a_level_of_detail_that_is_not_there_is_refused(device: OpenDevice, texture: VirtualTexture, lod: int) -> None:
    """The kernel would read past the end of its table. (Checked on the twin: the kernel must not be tried.)"""
    p, n = np.zeros((1, 3), np.float32), np.float32([[0, 1, 0]])
    with pytest.raises(ValueError, match="lod"):
        sample(texture, p, n, lod)


def test_bytes(device: OpenDevice, texture: VirtualTexture) -> None:
    slots = int(texture.indirection.cache.prod()) * 27
    index = texture.indirection.texels.nbytes
    sizes = [Sampler(device, texture, s).bytes - index for s in STORAGES]
    assert sizes == [slots * 52, slots * 26, slots * 25]


@pytest.mark.parametrize("storage", STORAGES)
def test_each_sample_has_its_own_level_of_detail(device: OpenDevice, texture: VirtualTexture, storage: Storage) -> None:
    rng = np.random.default_rng(13)
    p = rng.uniform(texture.origin, texture.origin + 32 * texture.finest, (20_000, 3)).astype(np.float32)
    n, lod = random_units(len(p), 14).astype(np.float32), rng.integers(1, 6, len(p)).astype(np.int32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n, lod)
    got = Sampler(device, texture, storage)(p, n, lod)
    agree(got, plain)
    assert (got.level <= lod).all() and len(np.unique(got.level)) >= 4
    for level in (2, 5):
        mine = lod == level
        alone = Sampler(device, texture, storage)(p[mine], n[mine], level)
        np.testing.assert_array_equal(alone.irradiance, got.irradiance[mine])


def test_images_take_a_level_of_detail_for_each_sample(device: OpenDevice) -> None:
    tree = random_tree(5, 0.45, 12)
    made, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 12))
    rng = np.random.default_rng(15)
    p, n = rng.uniform(0, 32, (20_000, 3)).astype(np.float32), random_units(20_000, 16).astype(np.float32)
    lod = rng.integers(1, 6, len(p))
    got, images = (Sampler(device, made, "half16", images=i)(p, n, lod) for i in (False, True))
    np.testing.assert_array_equal(got.level, images.level)
    assert np.abs(got.irradiance - images.irradiance).max() / got.irradiance.mean() < 1e-3


def test_levels_of_detail_are_checked(device: OpenDevice, texture: VirtualTexture) -> None:
    p = np.zeros((3, 3), np.float32)
    for lod in (np.array([1, 2, 6]), np.array([0, 1, 1]), np.array([1, 2]), np.array([1.0, 2.0, 3.0])):
        for call in (Sampler(device, texture, "float32"), lambda *a: sample(texture, *a)):
            with pytest.raises(ValueError, match="lod must be"):
                call(p, p, lod)  # type: ignore[operator]
