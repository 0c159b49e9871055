"""Who may be culled, what stands in for it through chains, and the random lightings and clusters by which that is judged."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.pipeline.culling import Setting, candidates, setting, training_points, without
from lightgauge.reference.placement.clusters import cluster_columns
from lightgauge.reference.placement.culling import damage, replaced
from lightgauge.reference.placement.lightings import FAMILIES, draw_lightings
from lightgauge.reference.placement.norms import MEAN_SQUARE, NORMS
from lightgauge.reference.sh import irradiance, irradiance_weights
from lightgauge.reference.volume.linear import read, texel_matrix
from lightgauge.reference.volume.sampler import sample
from lightgauge.validation.culling.bounds import bound
from lightgauge.validation.culling.retraced import retrace
from small_scenes import box, material, scene

SEED = 3
Baked = tuple[Scene, pipeline.Surfaces, pipeline.Probes, Setting]


def room() -> Scene:
    """A lit box with a small block in a corner, so that chains of parents are open, with probes of several levels."""
    return scene(
        [box([0, 0, 0], [2, 2, 2], emission=[1.0, 0.5, 0.2]), box([0.1, 0, 0.1], [0.4, 0.3, 0.4], inward=False)],
        [material(0.5)],
        placement={"min_voxel": 0.14, "cull_error": 0.05, "probe_rays": 256},
        radiosity={"patch_size": 0.5, "rays": 256},
        volumes={"all": {"min": [0.1, 0.1, 0.1], "max": [1.9, 1.9, 1.9]}},
    )


@pytest.fixture(scope="module")
def baked() -> Baked:
    made = room()
    surfaces = pipeline.bake_surfaces(made, SEED)
    probes = pipeline.trace_probes(made, surfaces, pipeline.place(made, surfaces, SEED), SEED)
    points = training_points(made, surfaces, SEED)
    assert points is not None
    return made, surfaces, probes, setting(made, surfaces, probes, points, SEED)


def test_matrix_form_is_the_sampler(baked: Baked) -> None:
    _, _, probes, _ = baked
    rng = np.random.default_rng(1)
    light = rng.random((len(probes.valid), 4, 3)).astype(np.float32)
    texture = pipeline.virtual_texture(probes, pipeline.tile_texels(probes, light, probes.light_from))
    positions = rng.uniform(0.1, 1.9, (200, 3))
    normals = np.tile([0.0, 1.0, 0.0], (200, 1))
    reading = read(texture, texel_matrix(probes.layout, probes.light_from), positions)
    ours = reading.irradiance(irradiance_weights(normals), light.astype(np.float64))
    np.testing.assert_allclose(ours, sample(texture, positions, normals).irradiance, atol=2e-5)


def test_only_probes_with_eight_valid_parents_may_go(
    baked: Baked,
) -> None:
    _, _, probes, s = baked
    assert 0 < s.able.sum() < probes.valid.sum() and not (s.able & ~probes.valid).any()
    rows = s.parents[np.flatnonzero(s.able)]
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-6)
    assert probes.valid[rows.indices].all()
    level = np.repeat(probes.octree.corner_level[s.able], np.diff(rows.indptr))
    assert (probes.octree.corner_level[rows.indices] < level).all(), "parents are coarser"
    assert (probes.octree.corner_level[s.able] >= 2).all()


def test_what_replaces_a_probe_is_what_the_layout_puts_there(
    baked: Baked,
) -> None:
    """All that may go go, chains included: the culled texture's own value at each culled corner is G's mixture of those that stay."""
    _, _, probes, s = baked
    mix, culled = replaced(candidates(s, NORMS["relative"]), s.able)
    assert (s.parents @ s.able.astype(float) > 0.0).any(), "some have parents that go too"
    np.testing.assert_array_equal(culled, s.able)
    assert not culled[mix.indices].any(), "only probes that stay are left"
    after = without(probes, culled)
    texture = pipeline.virtual_texture(after, np.zeros((0, 27, 13), dtype=np.float32))
    where = probes.octree.positions[culled]
    found = read(texture, texel_matrix(after.layout, after.light_from), where).weights.toarray()
    np.testing.assert_allclose(found, mix[np.flatnonzero(culled)].toarray()[:, ~culled], atol=1e-5)


def test_chains_are_judged_against_reconstructed_parents(
    baked: Baked,
) -> None:
    s = baked[3]
    c = candidates(s, NORMS["relative"])
    chained = np.flatnonzero(s.able & (s.parents @ s.able.astype(float) > 0.0))
    assert len(chained), "the room has chains"
    mix, _ = replaced(c, s.able)
    plain, rebuilt = damage(c, s.parents[chained], chained), damage(c, mix[chained], chained)
    assert not np.allclose(plain, rebuilt)
    threshold = float(np.median(rebuilt))
    _, culled = replaced(c, s.able, threshold)
    assert not culled[chained].all() and culled[chained].any(), "some go, some do not"


def test_the_bound_holds_for_a_thousand_lightings_by_fresh_rays(
    baked: Baked,
) -> None:
    """And would not if the bake's rows told less than there is: at a tenth of their size the same rays break it. It is far from sharp:
    row by row, noise of the bake's 256 rays adds up in the norm."""
    s = baked[3]
    fresh = retrace(s, SEED, 1024, 60)
    found = bound(s, fresh, SEED)
    assert found.held == 1.0 and found.lightings >= 1000
    assert 0.1 < found.closest <= 1.0
    rows = dataclasses.replace(s.probes.rows, values=0.1 * s.probes.rows.values)
    short = dataclasses.replace(s, probes=dataclasses.replace(s.probes, rows=rows))
    assert bound(short, fresh, SEED).held < 1.0


def test_mean_square_over_normals() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(200_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    c = rng.normal(size=(4, 1))
    assert (c[:, 0] ** 2 @ MEAN_SQUARE) == pytest.approx(np.mean(irradiance(c, normals) ** 2), rel=0.01)


def test_lightings_of_four_families() -> None:
    seen = np.ones(300)
    seen[-1] = 0.0
    drawn = draw_lightings(seen, 5, 1)
    assert drawn.shape == (300, 20) and len(FAMILIES) == 4 and not drawn[-1].any()
    lit = (drawn > 0.0).sum(axis=0)
    assert (lit[:10] >= 298).all() and (lit[10:15] == 3).all() and (lit[15:] == 1).all()
    np.testing.assert_array_equal(drawn, draw_lightings(seen, 5, 1))
    with pytest.raises(ValueError, match="seen must be positive"):
        draw_lightings(np.zeros(3), 1, 0)


def test_clusters_keep_places_and_sides_apart() -> None:
    rng = np.random.default_rng(2)
    places = np.concatenate([rng.random((400, 3)), rng.random((400, 3)) + np.array([5.0, 0.0, 0.0])])
    up = np.tile([0.0, 1.0, 0.0], (800, 1))
    found = cluster_columns(places, up, 384)
    assert len(found) == 800 + 384 + 1 and found[-1] == found.max()
    assert not set(found[:400]) & set(found[400:800]), "no cluster reaches over the gap"
    assert np.bincount(found[:800]).max() <= 4
    assert len(set(found[800:-1])) == 24
