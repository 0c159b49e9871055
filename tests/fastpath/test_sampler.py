"""The OpenCL kernel against its specification, the NumPy sampler."""

from __future__ import annotations

import dataclasses
import gc

import numpy as np
import pyopencl
import pyopencl.array
import pytest
from lightgauge.fastpath import launch
from lightgauge.fastpath import layout as layouts
from lightgauge.fastpath import sampler as samplers
from lightgauge.fastpath.arrays import is_on_device
from lightgauge.fastpath.device import OpenDevice, open_device
from lightgauge.fastpath.launch import DeviceSamples
from lightgauge.fastpath.layout import Layout
from lightgauge.fastpath.sampler import Sampler
from lightgauge.reference.texture_types import Samples, Storage, Viewer, VirtualTexture
from lightgauge.reference.volume.sampler import sample
from lightgauge.reference.volume.tiles import stored
from small_scenes import random_probes, random_tree, random_units, texture_of

FORMATS: tuple[tuple[Storage, Layout], ...] = (
    ("float32", "packed"), ("half", "packed"), ("float32", "split"), ("half", "split"), ("half16", "split"), ("half8", "split"),
)  # fmt: skip
FAR = 100_000.0  # m


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


@pytest.mark.parametrize(("storage", "layout"), FORMATS)
def test_random_positions(device: OpenDevice, texture: VirtualTexture, storage: Storage, layout: Layout) -> None:
    rng, count = np.random.default_rng(1), 1_000_000 if (storage, layout) == ("half", "packed") else 100_000
    high = texture.origin + texture.extent * texture.finest
    p = rng.uniform(texture.origin, high, (count, 3)).astype(np.float32)
    n = random_units(count, 2).astype(np.float32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n)
    assert len(np.unique(plain.level)) >= 3, "a texture with several levels"
    agree(Sampler(device, texture, storage, layout)(p, n), plain)


@pytest.mark.parametrize(("storage", "layout"), FORMATS)
def test_faces_edges_corners_and_outside(
    device: OpenDevice, texture: VirtualTexture, storage: Storage, layout: Layout
) -> None:
    p = borders(texture)
    rng = np.random.default_rng(3)
    outside = texture.origin + rng.normal(size=(50_000, 3)) * 40
    odd = np.array([[np.inf, 0, 0], [-np.inf, 2, np.inf], [1e30, -1e30, 1e38], [0, 0, 0], [-0.0, -0.0, -0.0]])
    p = np.concatenate([p, outside, odd]).astype(np.float32)
    n = random_units(len(p), 4).astype(np.float32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n)
    agree(Sampler(device, texture, storage, layout)(p, n), plain)


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


@pytest.mark.parametrize("storage", ["half", "half16", "half8"])
def test_images_read_the_same(device: OpenDevice, storage: Storage) -> None:
    """Through the device's linear filter. All probes valid and alike in size: 1e-3 of the mean is the filter's fraction."""
    tree = random_tree(5, 0.45, 12)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 12))
    p = np.random.default_rng(7).uniform(0, 32, (200_000, 3)).astype(np.float32)
    n = random_units(len(p), 8).astype(np.float32)
    got, images = Sampler(device, texture, storage, "split")(p, n), Sampler(device, texture, storage, "images")(p, n)
    np.testing.assert_array_equal(got.level, images.level)
    assert np.abs(got.irradiance - images.irradiance).max() / got.irradiance.mean() < 1e-3


@pytest.mark.parametrize(("storage", "layout"), FORMATS)
@pytest.mark.parametrize("blend", [0.0, 0.3])
@pytest.mark.parametrize("away", [0.0, FAR])
def test_levels_by_distance_here_and_100_km_away(
    device: OpenDevice, texture: VirtualTexture, storage: Storage, layout: Layout, blend: float, away: float
) -> None:
    """Failure-catalogue E5: positions count from the viewer, cells are whole numbers; so what is seen does not depend on where."""
    there = dataclasses.replace(texture, origin=texture.origin + away)
    rng = np.random.default_rng(21)
    local = rng.uniform(-1.0, 13.0, (30_000, 3))
    n = random_units(len(local), 22).astype(np.float32)
    eye = Viewer(there.origin + np.array([3.1, 2.2, 5.5]), 1.5, blend)
    p = there.origin + local
    plain = sample(dataclasses.replace(there, texels=stored(there.texels, storage)), p, n, eye, eye.position)
    got = Sampler(device, there, storage, layout)(p, n, eye, eye.position)
    agree(got, plain)
    assert len(np.unique(got.level)) >= 4
    here = sample(
        dataclasses.replace(texture, texels=stored(texture.texels, storage)), texture.origin + local, n,
        Viewer(eye.position - away, 1.5, blend), eye.position - away,
    )  # fmt: skip
    same = (
        here.level == got.level
    )  # 100 km in float64 move a position by 1e-11 m: one in a thousand may cross a ring's edge
    assert (~same).mean() < 1e-3
    assert np.abs(here.irradiance - got.irradiance)[same].max() / np.nanmean(np.abs(here.irradiance)) < 1e-5


def test_without_an_anchor_100_km_cost_precision(device: OpenDevice, texture: VirtualTexture) -> None:
    """The test above can fail: single-precision positions from the world's origin are off by 4 mm there."""
    there = dataclasses.replace(texture, origin=texture.origin + FAR)
    p = there.origin + np.random.default_rng(23).uniform(0.0, 11.0, (20_000, 3))
    n = random_units(len(p), 24).astype(np.float32)
    sampler = Sampler(device, there, "float32", "packed")
    good, rough = sampler(p, n, anchor=there.origin), sampler(p.astype(np.float32), n, anchor=there.origin)
    assert np.nanmax(np.abs(good.irradiance - rough.irradiance)) / np.nanmean(np.abs(good.irradiance)) > 1e-3


def test_nan_stays_where_it_is(device: OpenDevice, texture: VirtualTexture) -> None:
    p = np.random.default_rng(9).uniform(texture.origin, texture.origin + 5, (1000, 3)).astype(np.float32)
    n = random_units(1000, 10).astype(np.float32)
    sampler = Sampler(device, texture, "half", "packed")
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
    sampler = Sampler(device, texture, "half", "packed")
    first = sampler(p, n)
    for _ in range(3):
        np.testing.assert_array_equal(sampler(p, n).irradiance, first.irradiance)
    np.testing.assert_array_equal(Sampler(device, texture, "half", "packed")(p, n).irradiance, first.irradiance)
    assert 0 < sampler.seconds < 10


def test_shapes_are_checked(device: OpenDevice, texture: VirtualTexture) -> None:
    sampler = Sampler(device, texture, "float32", "packed")
    empty = sampler(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    assert empty.irradiance.shape == (0, 3) and empty.level.shape == (0,)
    good = np.zeros((3, 3), np.float32)
    for p, n, name in (
        (good, np.zeros((2, 3)), "normals"),
        (np.zeros((3, 4)), np.zeros((3, 4)), "positions"),
        (np.zeros(3), np.zeros(3), "positions"),
        (np.zeros((3, 3), np.int32), good, "positions"),
        (good, np.zeros((3, 3), complex), "normals"),
        ([[0.0, 1.0, 2.0]], good, "positions"),
    ):
        with pytest.raises(ValueError, match=f"{name}: expected"):
            sampler(p, n)


@pytest.mark.parametrize("lod", [-1, 6, 99])
def test_a_level_of_detail_that_is_not_there_is_refused(device: OpenDevice, texture: VirtualTexture, lod: int) -> None:
    """The kernel would read past the end of its table. (Checked on the twin: the kernel must not be tried.)"""
    p, n = np.zeros((1, 3), np.float32), np.float32([[0, 1, 0]])
    with pytest.raises(ValueError, match="lod"):
        sample(texture, p, n, lod)


def test_bytes(device: OpenDevice, texture: VirtualTexture) -> None:
    slots = int(texture.indirection.cache.prod()) * 27
    index = texture.indirection.texels.nbytes
    sizes = [Sampler(device, texture, s, "split").bytes - index for s in ("float32", "half16", "half8")]
    assert sizes == [slots * 52, slots * 26, slots * 25]


@pytest.mark.parametrize(("storage", "layout"), FORMATS)
def test_each_sample_has_its_own_level_of_detail(
    device: OpenDevice, texture: VirtualTexture, storage: Storage, layout: Layout
) -> None:
    rng = np.random.default_rng(13)
    p = rng.uniform(texture.origin, texture.origin + 32 * texture.finest, (20_000, 3)).astype(np.float32)
    n, lod = random_units(len(p), 14).astype(np.float32), rng.integers(1, 6, len(p)).astype(np.int32)
    plain = sample(dataclasses.replace(texture, texels=stored(texture.texels, storage)), p, n, lod)
    got = Sampler(device, texture, storage, layout)(p, n, lod)
    agree(got, plain)
    assert (got.level <= lod).all() and len(np.unique(got.level)) >= 4
    for level in (2, 5):
        mine = lod == level
        alone = Sampler(device, texture, storage, layout)(p[mine], n[mine], level)
        np.testing.assert_array_equal(alone.irradiance, got.irradiance[mine])


def test_images_take_a_level_of_detail_for_each_sample(device: OpenDevice) -> None:
    tree = random_tree(5, 0.45, 12)
    made, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 12))
    rng = np.random.default_rng(15)
    p, n = rng.uniform(0, 32, (20_000, 3)).astype(np.float32), random_units(20_000, 16).astype(np.float32)
    lod = rng.integers(1, 6, len(p))
    got, images = (Sampler(device, made, "half16", i)(p, n, lod) for i in ("split", "images"))  # type: ignore[arg-type]
    np.testing.assert_array_equal(got.level, images.level)
    assert np.abs(got.irradiance - images.irradiance).max() / got.irradiance.mean() < 1e-3


def test_levels_of_detail_are_checked(device: OpenDevice, texture: VirtualTexture) -> None:
    p = np.zeros((3, 3), np.float32)
    for lod in (np.array([1, 2, 6]), np.array([0, 1, 1]), np.array([1, 2]), np.array([1.0, 2.0, 3.0])):
        for call in (Sampler(device, texture, "float32"), lambda *a: sample(texture, *a)):
            with pytest.raises(ValueError, match="lod must be"):
                call(p, p, lod)  # type: ignore[operator]


def test_arrays_on_the_device_stay_there(device: OpenDevice, texture: VirtualTexture) -> None:
    """Results are the same, the caller's arrays are what the kernel reads, and they live until it is done though the caller lets go."""
    rng = np.random.default_rng(31)
    p = rng.uniform(0.0, 11.0, (30_000, 3)).astype(np.float32)  # from the anchor, the origin
    n = random_units(len(p), 32).astype(np.float32)
    sampler = Sampler(device, texture, "half", "packed")
    there = [pyopencl.array.to_device(device.queue, a) for a in (p, n)]
    found = [sampler.on_device(*there) for _ in range(20)]
    del there
    expected = sampler(p + texture.origin, n)
    for f in found:
        assert isinstance(f, DeviceSamples) and is_on_device(f.irradiance)
        got = f.host()
        assert np.array_equal(got.level, expected.level)
        np.testing.assert_allclose(got.irradiance, expected.irradiance, rtol=2e-4, atol=2e-4)
    with pytest.raises(ValueError, match="both"):
        sampler(pyopencl.array.to_device(device.queue, p), n)
    with pytest.raises(ValueError, match="on the device expected float32"):
        sampler(*[pyopencl.array.to_device(device.queue, a.astype(np.float64)) for a in (p, n)])


@pytest.mark.parametrize("anchor", [[0.0, 0.0], [np.nan, 0.0, 0.0], [1e12, 0.0, 0.0]])
def test_an_anchor_that_cannot_be(device: OpenDevice, texture: VirtualTexture, anchor: list[float]) -> None:
    p, n = np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]])
    for call in (Sampler(device, texture, "half", "packed"), lambda *a: sample(texture, *a)):
        with pytest.raises(ValueError, match="anchor"):
            call(p, n, None, np.array(anchor))  # type: ignore[operator]


@pytest.mark.parametrize(("storage", "layout"), [("half", "packed"), ("half16", "split"), ("half8", "images")])
def test_addresses_on_a_linear_ramp(device: OpenDevice, storage: Storage, layout: Layout) -> None:
    """Failure-catalogue E4: trilinear interpolation of a ramp is the ramp, at texels, at faces, one float to each side of them, and at
    negative positions, where truncation would not be the floor. Half floats hold whole numbers to 2,048 exactly."""
    tree = random_tree(5, 0.45, 12)
    flat = np.zeros((len(tree.corners), 13), np.float32)
    flat[:, 0], flat[:, 12] = tree.corners @ np.array([1, 4, 16]), 1.0
    texture, _ = texture_of(tree, flat)
    texture = dataclasses.replace(texture, origin=np.array([-16.0, -16.0, -16.0]))
    grid = np.stack(np.meshgrid(*[np.arange(-16.0, 17.0)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    up, down = np.nextafter(grid, np.float32(99)), np.nextafter(grid, np.float32(-99))
    n = np.tile(np.float32([[0, 1, 0]]), (len(grid), 1))
    sampler = Sampler(device, texture, storage, layout)
    for p in (grid, up, down):
        q = np.clip(p.astype(np.float64) + 16.0, 0.0, 32.0)
        expected = np.sqrt(np.pi) / 2 * q @ np.array([1.0, 4.0, 16.0])
        limit = 2e-4 if layout == "images" else 2e-6
        assert np.abs(sampler(p, n).irradiance[:, 0] - expected).max() < limit * expected.max()


@pytest.mark.parametrize(
    ("storage", "layout"), [("float32", "packed"), ("half", "packed"), ("half8", "split"), ("half8", "images")]
)
@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_poison_next_door_stays_there(device: OpenDevice, storage: Storage, layout: Layout, poison: float) -> None:
    """Failure-catalogue E2: a neighbour in the cache that holds NaN or infinity enters no sample here, not even with weight 0."""
    tree = random_tree(4, 0.6, 5)
    texture, layout_of = texture_of(tree, random_probes(len(tree.corners), 0.0, 5))
    slot, tiles = layout_of.tiles // 2, layout_of.tiles
    parents, first = layout_of.parents, layout_of.first_slot
    level = int(np.searchsorted(first, slot, side="right"))
    cell = parents[level - 1][slot - first[level - 1]]
    edge = 2 ** (4 - level + 1)
    at = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 3, indexing="ij"), -1).reshape(-1, 3) * edge * (1 - 1e-6)
    p, n = (cell * edge + at).astype(np.float32), random_units(len(at), 6).astype(np.float32)
    clean = Sampler(device, texture, storage, layout)(p, n, level)
    poisoned = texture.texels.copy()
    poisoned[np.arange(tiles) != slot] = poison
    sampler = poisoned_sampler(device, dataclasses.replace(texture, texels=poisoned), texture, storage, layout)
    got = sampler(p, n, level)
    mine = clean.level == level
    assert mine.any() and np.isfinite(got.irradiance[mine]).all()
    limit = 0.05 if layout == "images" else 1e-6  # images look again from 1/256 of a texel inside
    assert np.abs(got.irradiance - clean.irradiance)[mine].max() / clean.irradiance.mean() < limit


def poisoned_sampler(
    device: OpenDevice, poisoned: VirtualTexture, clean: VirtualTexture, storage: Storage, layout: Layout
) -> Sampler:
    """A sampler of poisoned texels whose exposure is that of the clean ones (no exposure suits infinity)."""
    kept = layouts.exposure(clean, storage)
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        for module in (layouts, samplers):
            patch.setattr(module, "exposure", lambda texture, storage: kept)
        return Sampler(device, poisoned, storage, layout)


@pytest.mark.parametrize("storage", ["half", "float32"])
@pytest.mark.parametrize("reconstruction", ["linear", "clamped"])
@pytest.mark.parametrize("way", ["all", "own", "distance", "blend"])
def test_a_sample_does_not_depend_on_its_neighbours(
    device: OpenDevice,
    texture: VirtualTexture,
    storage: Storage,
    reconstruction: str,
    way: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Eight at a time and one at a time give the same bits: along lines through few voxels, scattered, and where probes are invalid; in
    numbers that are no multiple of eight."""
    rng = np.random.default_rng(41)
    along = np.linspace(0.0, 1.0, 40_003)[:, None] * np.array([9.0, 3.0, 0.5]) + np.array([0.4, 5.0, 4.0])
    p = texture.origin + np.concatenate([along, rng.uniform(-0.5, 12.0, (5_000, 3))])
    p[::997, 2] = np.nan
    n = random_units(len(p), 42).astype(np.float32)
    eye = texture.origin + np.array([3.0, 4.0, 5.0])
    lods = {
        "all": None, "own": rng.integers(1, 6, len(p)).astype(np.int32), "distance": Viewer(eye, 1.5), "blend": Viewer(eye, 1.5, 0.3),
    }  # fmt: skip
    together = Sampler(device, texture, storage, "packed", reconstruction)(p, n, lods[way])
    monkeypatch.setattr(launch, "LANES_FOR", ())
    alone = Sampler(device, texture, storage, "packed", reconstruction)(p, n, lods[way])
    for a, b in (
        (together.irradiance, alone.irradiance),
        (together.level, alone.level),
        (together.weight, alone.weight),
    ):
        np.testing.assert_array_equal(a, b)
    assert len(np.unique(alone.level)) > 3 and np.isnan(alone.irradiance).any()
    assert reconstruction == "linear" or not (alone.irradiance < 0.0).any()


def test_numbers_of_samples(device: OpenDevice, texture: VirtualTexture) -> None:
    """Part of a group, of a work item's batch, and so many that results go past the caches: always the bits of the same samples."""
    many, batch = (1 << 18) + 77, 8 * launch.BATCH
    rng = np.random.default_rng(43)
    p = texture.origin + np.array([5.0, 5.0, 5.0]) + np.cumsum(rng.normal(scale=0.02, size=(many, 3)), axis=0) % 6.0
    n = random_units(many, 44).astype(np.float32)
    sampler = Sampler(device, texture, "half", "packed")
    whole = sampler(p, n)
    for count in (1, 7, 8, 9, batch - 1, batch, batch + 1, 2 * batch + 13):
        for begin in (0, many - count):
            part = sampler(p[begin : begin + count], n[begin : begin + count])
            for got, want in zip(
                (part.irradiance, part.level, part.weight), (whole.irradiance, whole.level, whole.weight), strict=True
            ):
                np.testing.assert_array_equal(got, want[begin : begin + count])
    rest = sampler(p[batch // 2 : -500], n[batch // 2 : -500])  # under the limit, and other groups of eight
    assert len(rest.level) < 1 << 18
    np.testing.assert_array_equal(rest.irradiance, whole.irradiance[batch // 2 : -500])
    assert len(np.unique(whole.level)) > 2


def test_results_may_be_written_over(device: OpenDevice, texture: VirtualTexture) -> None:
    rng = np.random.default_rng(51)
    sampler = Sampler(device, texture, "half", "packed")
    pairs = [(rng.uniform(0, 11, (999, 3)), random_units(999, i)) for i in range(2)]
    views = [[pyopencl.array.to_device(device.queue, a.astype(np.float32)) for a in pair] for pair in pairs]
    first = sampler.on_device(*views[0])
    kept = first.host()
    second = sampler.on_device(*views[1], out=first)
    assert second.irradiance is first.irradiance and not np.array_equal(second.host().irradiance, kept.irradiance)
    np.testing.assert_array_equal(sampler.on_device(*views[0], out=second).host().irradiance, kept.irradiance)
    short = pyopencl.array.to_device(device.queue, np.zeros((5, 3), np.float32))
    with pytest.raises(ValueError, match="out must be results of 5"):
        sampler(short, short, out=first)
    with pytest.raises(ValueError, match="a view perhaps"):
        sampler(views[0][0][4:], views[0][1][4:])


def test_arguments_outlive_the_sampler(device: OpenDevice, texture: VirtualTexture) -> None:
    """On PoCL an image sampler that is released while the kernel runs gives a wrong picture now and then: the device holds on to it."""
    p, n = (
        pyopencl.array.to_device(device.queue, a.astype(np.float32)) for a in (np.full((9, 3), 5.0), random_units(9, 1))
    )
    sampler = Sampler(device, texture, "half8", "images")
    expected = sampler.on_device(p, n).host()
    made = sampler.on_device(p, n)
    del sampler
    gc.collect()
    assert any(isinstance(a, pyopencl.Sampler) for event, held in device.pending if event == made.event for a in held)
    np.testing.assert_array_equal(made.host().irradiance, expected.irradiance)


def test_buffers_are_read_as_they_are(device: OpenDevice, texture: VirtualTexture) -> None:
    p, n = np.random.default_rng(3).uniform(0, 11, (100, 3)).astype(np.float32), random_units(100, 4).astype(np.float32)
    sampler = Sampler(device, texture, "half", "packed")
    flags = pyopencl.mem_flags.READ_ONLY | pyopencl.mem_flags.COPY_HOST_PTR
    buffers = [pyopencl.Buffer(device.context, flags, hostbuf=a) for a in (p, n)]
    arrays = [pyopencl.array.to_device(device.queue, a) for a in (p, n)]
    np.testing.assert_array_equal(
        sampler.on_device(*buffers).host().irradiance, sampler.on_device(*arrays).host().irradiance
    )
    with pytest.raises(ValueError, match="normals: expected a buffer of 12 × 100 bytes"):
        sampler(buffers[0], pyopencl.Buffer(device.context, flags, hostbuf=n[:50].copy()))


def test_results_of_another_shape_are_not_written_over(device: OpenDevice, texture: VirtualTexture) -> None:
    sampler = Sampler(device, texture, "half", "packed")
    p, n = (
        pyopencl.array.to_device(device.queue, a.astype(np.float32)) for a in (np.ones((50, 3)), random_units(50, 1))
    )
    good = sampler.on_device(p, n)
    bad = dataclasses.replace(good, irradiance=pyopencl.array.zeros(device.queue, (8, 3), np.float32))
    with pytest.raises(ValueError, match="out must be results of 50"):
        sampler(p, n, out=bad)


@pytest.mark.parametrize("reconstruction", ["linear", "clamped", "nonlinear", "zh3"])
def test_a_normal_that_is_no_number_gives_none(
    device: OpenDevice, texture: VirtualTexture, reconstruction: str
) -> None:
    p, n = np.random.default_rng(3).uniform(texture.origin, texture.origin + 11, (64, 3)), random_units(64, 4)
    n[::5] = np.nan
    got = Sampler(device, texture, "half", "packed", reconstruction)(p, n)
    lit = got.level > 0
    np.testing.assert_array_equal(np.isnan(got.irradiance[lit]).all(axis=1), np.isnan(n[lit]).any(axis=1))
