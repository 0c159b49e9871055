"""Kernels of other ways to read the probes against their specifications (reference/volume/other_ways*.py)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.other_ways import Chebyshev, FixedPoint, PerMesh, RatioL1
from lightgauge.reference.octahedral import bordered_index
from lightgauge.reference.texture_types import DistanceMaps, Samples, VirtualTexture
from lightgauge.reference.volume import other_ways as plain
from lightgauge.reference.volume.other_ways_ratio import encode, ratio_l1
from lightgauge.reference.volume.other_ways_visibility import chebyshev, served_places
from small_scenes import random_probes, random_tree, random_units, texture_of

COUNT = 20_000


@pytest.fixture(scope="module")
def device() -> OpenDevice:
    return open_device()


@pytest.fixture(scope="module")
def made() -> tuple[VirtualTexture, DistanceMaps]:
    """Levels 0 … 5 with holes, a quarter of the probes invalid, an uneven origin and voxel; walls at random in every direction."""
    tree = random_tree(5, 0.45, 11)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.25, 11))
    places, _, number = served_places(layout)
    rng = np.random.default_rng(12)
    mean = rng.uniform(0.05, 2.5, (len(places), 36))[:, bordered_index(6)]
    moments = np.stack([mean, mean**2 * rng.uniform(1.0, 1.3, (len(places), 36))[:, bordered_index(6)]], axis=-1)
    moved = dataclasses.replace(texture, origin=np.array([-3.7, 1.3, 12.9]), finest=0.37)
    return moved, DistanceMaps(moments.astype(np.float16), number)


@pytest.fixture(scope="module")
def asked(made: tuple[VirtualTexture, DistanceMaps]) -> tuple[np.ndarray, np.ndarray]:
    """Random places inside and outside, corners of the lattice, faces, and NaN."""
    texture, rng = made[0], np.random.default_rng(1)
    p = rng.uniform(texture.origin - 1, texture.origin + 33 * texture.finest, (COUNT, 3))
    lattice = rng.integers(0, 33, (COUNT // 4, 3)).astype(float)
    lattice[::2, rng.integers(0, 3)] += 0.5
    p[: len(lattice)] = texture.origin + lattice * texture.finest
    p[5], p[6, 1] = np.nan, np.nan
    return p.astype(np.float32), random_units(COUNT, 2).astype(np.float32)


def agree(got: Samples, twin: Samples, tolerance: float) -> None:
    same = got.level == twin.level
    assert (~same).mean() < 1e-4, (~same).sum()  # a weight within rounding of the least one
    np.testing.assert_array_equal(np.isnan(got.irradiance), np.isnan(twin.irradiance))
    assert np.isnan(got.irradiance[5:7]).all() and np.isnan(got.irradiance).sum() == 6
    assert np.nanmax(np.abs(got.irradiance - twin.irradiance)[same]) / np.nanmean(twin.irradiance) < tolerance
    np.testing.assert_allclose(got.weight[same], twin.weight[same], atol=3e-6)


def test_fixed_point_is_its_specification(device: OpenDevice, made: tuple, asked: tuple) -> None:
    way = FixedPoint(device, made[0], "float32")
    agree(way(*asked), plain.fixed_point(made[0], *asked), 1e-5)
    assert way.seconds > 0
    assert way.bytes == made[0].texels.shape[0] * 27 * 64 + made[0].indirection.texels.nbytes


def test_chebyshev_is_its_specification(device: OpenDevice, made: tuple, asked: tuple) -> None:
    way = Chebyshev(device, *made, "float32")
    twin = chebyshev(*made, *asked)
    agree(way(*asked), twin, 1e-5)
    assert way.bytes > made[1].bytes
    other = plain.fixed_point(made[0], *asked, bits=23)
    assert np.nanmean(np.abs(other.irradiance - twin.irradiance)) > 0.02  # the maps do decide


def test_ratios_are_their_specification(device: OpenDevice, made: tuple, asked: tuple) -> None:
    texels = encode(made[0])
    way = RatioL1(device, made[0], texels)
    agree(way(*asked), ratio_l1(made[0], texels, *asked), 1e-5)
    assert way.bytes == 16 * made[0].texels.shape[0] * 27 + made[0].indirection.texels.nbytes


def test_meshes_are_their_specification(device: OpenDevice, made: tuple, asked: tuple) -> None:
    middles, n = asked[0][100:140], asked[1]
    way = PerMesh(device, made[0], middles, "float32")
    light = way.light()
    np.testing.assert_allclose(light, plain.mesh_light(made[0], middles), atol=1e-5)
    first = way.seconds
    meshes = np.random.default_rng(3).integers(0, 40, COUNT).astype(np.int32)
    np.testing.assert_allclose(way.pixels(meshes, n), plain.per_mesh(light, meshes, n), atol=1e-5)
    assert first > 0 and way.seconds > 0


def test_halves_stay_within_their_precision(device: OpenDevice, made: tuple, asked: tuple) -> None:
    """2^-11 of each stored number; where weights are small against one, twice."""
    for way, twin in (
        (FixedPoint(device, made[0]), plain.fixed_point(made[0], *asked)),
        (Chebyshev(device, *made), chebyshev(*made, *asked)),
    ):
        got = way(*asked)
        same = got.level == twin.level
        off = np.abs(got.irradiance - twin.irradiance)[same] / np.nanmean(twin.irradiance)
        assert np.nanpercentile(off, 99.9) < 2e-3


def test_bad_input(device: OpenDevice, made: tuple) -> None:
    texture, maps = made
    one = np.zeros((1, 3), np.float32)
    with pytest.raises(ValueError, match="bits must be"):
        FixedPoint(device, texture, bits=0)
    with pytest.raises(ValueError, match="packed layout holds"):
        FixedPoint(device, texture, "half8")
    with pytest.raises(ValueError, match="expected numbers"):
        Chebyshev(device, texture, dataclasses.replace(maps, number=maps.number[:3]))
    with pytest.raises(ValueError, match="texels must name maps"):
        Chebyshev(device, texture, dataclasses.replace(maps, moments=maps.moments[:5]))
    with pytest.raises(ValueError, match="texels, got"):
        texels = encode(texture)
        RatioL1(device, texture, dataclasses.replace(texels, base=texels.base[:7]))
    way = PerMesh(device, texture, one)
    with pytest.raises(ValueError, match="numbers of meshes"):
        way.pixels(np.array([1], np.int32), one)
    with pytest.raises(ValueError, match="normals: expected shape"):
        FixedPoint(device, texture)(one, np.zeros((2, 3), np.float32))
    assert FixedPoint(device, texture)(one[:0], one[:0]).irradiance.shape == (0, 3)
