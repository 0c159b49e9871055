"""Weights of probes against the sampler that they take apart."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import Octree
from lightgauge.reference.volume.sampler import lattice_position, resolve
from lightgauge.validation.leaks.weights import probe_weights, voxel_weights
from small_scenes import masked_tree, random_probes, random_tree, texture_of


@pytest.mark.parametrize("tree", [random_tree(4, 0.4, 1), random_tree(5, 0.3, 2), masked_tree(0b10010110)])
@pytest.mark.parametrize("invalid", [0.0, 0.4])
@pytest.mark.parametrize("lod", [None, 2])
def test_weights_make_what_the_sampler_reads(tree: Octree, invalid: float, lod: int | None) -> None:
    """Through chains of virtual probes, past invalid ones, where a coarser level answers and where no finer one may: light and weight
    of every sample are the sums of probes' light and weights."""
    probes = random_probes(len(tree.corners), invalid, 3)
    texture, layout = texture_of(tree, probes)
    source = np.where(probes[:, 12] > 0, np.arange(len(probes)), -1).astype(np.int32)
    where = np.random.default_rng(4).uniform(0.0, 1 << tree.grid.level, (3000, 3))
    q = lattice_position(texture, where)
    light, weight, level = resolve(texture, q, q, lod or texture.level)
    found = probe_weights(texture, layout, source, where, lod)
    assert np.array_equal(found.level, level) and level.max() == (lod or texture.level)
    made = np.zeros((len(where), 13))
    np.add.at(made, found.sample, found.weight[:, None] * probes[found.probe])
    np.testing.assert_allclose(made[:, 12], weight, atol=2e-5)
    np.testing.assert_allclose(made[:, :12], light, atol=5e-5)
    assert (np.diff(found.sample) >= 0).all() and (found.weight > 0).all() and (source[found.probe] >= 0).all()


def test_a_voxel_alone_says_what_the_sampler_reads_where_it_answers() -> None:
    tree = random_tree(4, 0.4, 1)
    probes = random_probes(len(tree.corners), 0.4, 3)
    texture, layout = texture_of(tree, probes)
    source = np.where(probes[:, 12] > 0, np.arange(len(probes)), -1).astype(np.int32)
    where = np.random.default_rng(4).uniform(0.0, 1 << tree.grid.level, (3000, 3))
    found = probe_weights(texture, layout, source, where)
    compared = 0
    for level in range(1, tree.grid.level + 1):
        alone, corners = voxel_weights(tree, texture, source, where, level)
        both = (alone.level == level) & (found.level == level) & (corners >= 0).all(axis=1)
        compared += int(both.sum())
        made = np.zeros((2, len(where), 13))
        for k, w in enumerate((alone, found)):
            np.add.at(made[k], w.sample, w.weight[:, None] * probes[w.probe])
        np.testing.assert_allclose(made[0][both], made[1][both], atol=1e-5)
    assert compared > 50


def test_a_copy_counts_as_the_probe_whose_light_it_is() -> None:
    tree = random_tree(3, 0.6, 5)
    probes = random_probes(len(tree.corners), 0.0, 6)
    source = np.arange(len(probes), dtype=np.int32)
    source[::3] = 1  # a third of all probes uses the light of number 1
    texture, layout = texture_of(tree, probes[source])
    where = np.random.default_rng(7).uniform(0.0, 8.0, (500, 3))
    found = probe_weights(texture, layout, source, where)
    q = lattice_position(texture, where)
    made = np.zeros((len(where), 13))
    np.add.at(made, found.sample, found.weight[:, None] * probes[found.probe])
    np.testing.assert_allclose(made[:, :12], resolve(texture, q, q, texture.level)[0], atol=5e-5)
    assert set(found.probe.tolist()) <= set(source.tolist())
