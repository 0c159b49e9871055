"""Probes with SH of order 2 through the whole chain: the same rays, five more numbers a colour, the rest bit for bit as before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.placement.judge import stacked
from lightgauge.reference.reconstruction import irradiance
from small_scenes import box, material, random_units, scene

TARGET = 0.05
Bake = tuple[Scene, pipeline.Surfaces, pipeline.PatchLight, pipeline.Probes]


@pytest.fixture(scope="module")
def bakes() -> tuple[Bake, Bake]:
    """One scene with probes of order 1, then 2, not culled; a sun that is `input` reaches probes without rays."""
    first = scene(
        [box([0, 0, 0], [2, 2, 2], emission=[1.0, 0.5, 0.2]), box([0.6, 0, 0.7], [1.2, 0.8, 1.5], inward=False)],
        [material(0.5)],
        placement={"min_voxel": 0.25, "cull_error": TARGET, "probe_rays": 1024},
        radiosity={"patch_size": 0.4},
        volumes={"all": {"min": [0.1, 0.1, 0.1], "max": [1.9, 1.9, 1.9]}},
        lights={"lamp": {"type": "point", "position": [1.0, 1.5, 0.4], "intensity": [0.1, 0.2, 0.3], "tag": "input"}},
    )
    sampling = first.settings.sampling.model_copy(update={"reconstruction": "l2"})
    second = dataclasses.replace(first, settings=first.settings.model_copy(update={"sampling": sampling}))
    surfaces = pipeline.bake_surfaces(first, 0)
    light = pipeline.light_patches(first, surfaces, 0)
    tree = pipeline.place(first, surfaces, 0)
    one, two = ((s, surfaces, light, pipeline.trace_probes(s, surfaces, tree, 0)) for s in (first, second))
    return one, two


def test_linear_part_is_that_of_order_1(bakes: tuple[Bake, Bake]) -> None:
    (*_, one), (*_, two) = bakes
    assert one.rows.values.shape[1] == 4 and two.rows.values.shape[1] == 9
    for name in ("indptr", "columns", "back_share", "rays"):
        np.testing.assert_array_equal(getattr(two.rows, name), getattr(one.rows, name))
    np.testing.assert_array_equal(two.rows.values[:, :4], one.rows.values)
    np.testing.assert_array_equal(two.rows.se[:, :4], one.rows.se)
    assert np.array_equal(one.valid, two.valid) and np.array_equal(one.light_from, two.light_from)
    entries = len(one.rows.columns)
    assert (one.rows.bytes - one.rows.indptr.nbytes, two.rows.bytes - two.rows.indptr.nbytes) == (
        20 * entries,
        40 * entries,
    )


def test_update_fills_five_more_channels_a_colour(bakes: tuple[Bake, Bake]) -> None:
    one, two = (pipeline.update(s, surfaces, probes, light) for s, surfaces, light, probes in bakes)
    assert two.coefficients.shape[1:] == (9, 3) and two.texels.shape[1:] == (27, 28)
    np.testing.assert_array_equal(two.coefficients[:, :4], one.coefficients)
    np.testing.assert_array_equal(two.texels[..., :13], one.texels)
    probes = bakes[1][3]
    plain = np.stack([probes.rows.matrix(k) @ bakes[1][2].radiosity.light for k in range(9)], axis=1)
    plain += pipeline.punctual_input(bakes[1][0], bakes[1][1].geometry, probes.octree.positions, 2)
    np.testing.assert_allclose(two.coefficients, plain, atol=2e-6 * np.abs(plain).max())
    finest = np.concatenate(probes.layout.probe)
    tile, texel = np.nonzero(finest >= 0)
    source = probes.light_from[finest[tile, texel]]
    band2 = np.where((source >= 0)[:, None, None], two.coefficients[source, 4:], 0.0)
    np.testing.assert_array_equal(two.texels[tile, texel, 13:], band2.transpose(0, 2, 1).reshape(-1, 15))


def test_it_is_nearer_to_what_points_gather(bakes: tuple[Bake, Bake]) -> None:
    """At places in the open, against rays straight from the patches: order 2 holds most of what order 1 misses."""
    s, surfaces, light, probes = bakes[1]
    seen = np.flatnonzero(probes.valid)[:: max(1, int(probes.valid.sum()) // 200)]
    found = pipeline.update(s, surfaces, probes, light).coefficients[seen]
    found = found - pipeline.punctual_input(s, surfaces.geometry, probes.octree.positions[seen], 2)
    normals = random_units(len(seen), 5)
    unlit = dataclasses.replace(s, settings=s.settings.model_copy(update={"lights": {}}))
    truth = pipeline.gather_at_points(unlit, surfaces, light, probes.octree.positions[seen], normals, 9)
    error = {m: np.sqrt(np.mean((irradiance(m, found, normals) - truth) ** 2)) for m in ("linear", "l2")}
    assert error["l2"] < 0.5 * error["linear"]


def test_culling_judges_all_nine(bakes: tuple[Bake, Bake]) -> None:
    s, surfaces, _, probes = bakes[1]
    after = pipeline.cull_probes(s, surfaces, probes, 0)
    assert after.culled is not None and after.culled.probes > 0
    assert after.rows.values.shape[1] == 9 and after.culled.raise_expected <= TARGET
    assert after.culled.bytes == probes.rows.bytes - after.rows.bytes


@pytest.mark.parametrize("k", [4, 9])
def test_stacked_rows(k: int) -> None:
    values = np.arange(3 * k, dtype=np.float32).reshape(3, k) + 1.0
    made = stacked(values, np.array([0, 2, 3]), np.array([0, 3, 1]), 5).toarray()
    assert made.shape == (2 * k, 5)
    for i in range(k):
        np.testing.assert_array_equal(made[2 * i], [values[0, i], 0.0, 0.0, values[1, i], 0.0])
        np.testing.assert_array_equal(made[2 * i + 1], [0.0, values[2, i], 0.0, 0.0, 0.0])
