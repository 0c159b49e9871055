"""The plain sampler against an independent look-up, and its edge cases (failure-catalogue D5, E2, E4)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from lightgauge.reference.lattice import OCTANTS, Octree
from lightgauge.reference.texture_types import VirtualTexture
from lightgauge.reference.volume.sampler import sample
from small_scenes import random_probes, random_tree, random_units, texture_of, tree_of


def affine_probes(tree: Octree) -> np.ndarray:
    """Probes whose L00 is an affine function of position (different per colour) and whose L1 is 0."""
    value = 1.0 + tree.positions @ np.array([[0.3, 0.1, 0.2], [0.05, 0.4, 0.1], [0.2, 0.1, 0.5]])
    texels = np.zeros((len(value), 13), np.float32)
    texels[:, [0, 4, 8]] = value
    texels[:, 12] = 1
    return texels


@pytest.mark.parametrize("lod", [None, 1, 2, 3, 4])
def test_affine_light_is_exact_everywhere_and_in_every_lod(lod: int | None) -> None:
    """Trilinear interpolation through all chains of virtual probes reproduces an affine function."""
    tree = random_tree(4, 0.4, 1)
    texture, _ = texture_of(tree, affine_probes(tree))
    p = np.random.default_rng(0).uniform(0, 16, (5000, 3))
    got = sample(texture, p, random_units(5000, 1), lod)
    value = 1.0 + p @ np.array([[0.3, 0.1, 0.2], [0.05, 0.4, 0.1], [0.2, 0.1, 0.5]])
    np.testing.assert_allclose(got.irradiance, math.pi * math.sqrt(1 / (4 * math.pi)) * value, rtol=2e-6)
    np.testing.assert_allclose(got.weight, 1.0, rtol=1e-6)
    assert got.level.max() == (lod or 4) and got.level.min() >= 1


def slow(tree: Octree, probes: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, int]:
    """Texel (13,) at one position inside an *existing* voxel: its 8 corner probes, no texture. Finest such voxel."""
    corner_at = {tuple(c): i for i, c in enumerate(tree.corners.tolist())}
    for level in range(tree.grid.level, 0, -1):
        scale = 1 << (tree.grid.level - level)
        voxel = np.floor(p / scale).astype(int)
        if voxel.tolist() in tree.voxels[level].tolist():
            f = p / scale - voxel
            return np.sum([np.prod(np.where(o, f, 1 - f)) * probes[corner_at[tuple(((voxel + o) * scale).tolist())]]
                           for o in OCTANTS], axis=0), level  # fmt: skip
    return np.zeros(13), 0


def test_inside_existing_voxels_it_is_the_eight_corners() -> None:
    tree = random_tree(4, 0.6, 5)
    probes = random_probes(len(tree.corners), 0.2, 5)
    texture, _ = texture_of(tree, probes)
    rng = np.random.default_rng(1)
    finest = tree.voxels[-1][rng.integers(len(tree.voxels[-1]), size=300)]
    p = finest + rng.uniform(0.01, 0.99, (300, 3))
    n = random_units(300, 2)
    got = sample(texture, p, n)
    checked = 0
    for i in range(300):
        texel, level = slow(tree, probes.astype(np.float64), p[i])
        if texel[12] < 0.01:
            continue
        sh = texel[:12].reshape(3, 4) / texel[12]
        w = np.array([math.sqrt(math.pi) / 2, *(math.sqrt(math.pi / 3) * n[i, [1, 2, 0]])])
        np.testing.assert_allclose(got.irradiance[i], sh @ w, rtol=2e-5, atol=1e-5)
        assert got.level[i] == level == 4
        checked += 1
    assert checked > 250


def uniform(levels: int, seed: int = 0, invalid: float = 0.0) -> tuple[Octree, VirtualTexture]:
    every = [
        np.stack(np.meshgrid(*[np.arange(1 << n)] * 3, indexing="ij"), -1).reshape(-1, 3) for n in range(levels + 1)
    ]
    tree = tree_of(every, finest=0.5, origin=(-1.0, 2.0, 3.0))
    return tree, texture_of(tree, random_probes(len(tree.corners), invalid, seed))[0]


def test_outside_is_clamped_to_the_border() -> None:
    _, texture = uniform(3)
    rng = np.random.default_rng(0)
    out = rng.uniform(-30, 30, (2000, 3))
    clamped = np.clip(out, texture.origin, texture.origin + 8 * 0.5)
    n = random_units(2000, 1)
    a, b = sample(texture, out, n), sample(texture, clamped, n)
    np.testing.assert_allclose(a.irradiance, b.irradiance, rtol=1e-5)
    far = sample(texture, np.array([[1e30, -1e30, 3.0], [np.inf, -np.inf, 3.0]]), n[:2])
    assert np.isfinite(far.irradiance).all()


def test_nan_stays_where_it_is() -> None:
    _, texture = uniform(3)
    p = np.random.default_rng(0).uniform(-1, 3, (100, 3)) + np.array([0, 3, 4])
    n = random_units(100, 1)
    clean = sample(texture, p, n)
    for axis in range(3):
        bad = p.copy()
        bad[37, axis] = np.nan
        got = sample(texture, bad, n)
        assert np.isnan(got.irradiance[37]).all() and got.level[37] == 0
        rest = np.delete(np.arange(100), 37)
        np.testing.assert_array_equal(got.irradiance[rest], clean.irradiance[rest])


def test_exact_corners_read_the_probe_itself() -> None:
    tree, texture = uniform(3)
    n = random_units(len(tree.corners), 1)
    got = sample(texture, tree.positions, n)
    texels = random_probes(len(tree.corners), 0.0, 0)
    w = np.concatenate([np.full((len(n), 1), math.sqrt(math.pi) / 2), math.sqrt(math.pi / 3) * n[:, [1, 2, 0]]], axis=1)
    np.testing.assert_allclose(
        got.irradiance, np.einsum("nck,nk->nc", texels[:, :12].reshape(-1, 3, 4), w), rtol=1e-5, atol=1e-5
    )


def test_invalid_probes_do_not_darken() -> None:
    """Division by the weight: with light 1 at every valid probe the answer is 1 wherever any is near."""
    tree, _ = uniform(3)
    probes = np.zeros((len(tree.corners), 13), np.float32)
    valid = np.random.default_rng(1).random(len(probes)) > 0.5
    probes[:, 0] = probes[:, 12] = valid
    texture, _ = texture_of(tree, probes)
    p = np.random.default_rng(2).uniform(texture.origin, texture.origin + 4, (3000, 3))
    got = sample(texture, p, random_units(3000, 3))
    assert (got.level > 0).mean() > 0.99
    np.testing.assert_allclose(got.irradiance[got.level > 0, 0], math.sqrt(math.pi) / 2, rtol=1e-4)


def test_where_all_are_invalid_the_parent_level_answers() -> None:
    """failure-catalogue D5. All probes of level 3 alone are invalid in a corner of the volume; those of level 2 are not."""
    tree, _ = uniform(3)
    probes = random_probes(len(tree.corners), 0.0, 3)
    low = (tree.corners < 4).all(axis=1) & (tree.corner_level == 3)
    all_odd = low & (tree.corners % 2 == 1).all(axis=1)
    probes[low] = 0
    texture, _ = texture_of(tree, probes)
    odd = tree.positions[all_odd]
    got = sample(texture, odd, random_units(len(odd), 1))
    assert (got.level == 2).all()
    coarse = sample(texture, odd, random_units(len(odd), 1), lod=2)
    np.testing.assert_allclose(got.irradiance, coarse.irradiance, rtol=1e-6)
    probes[:] = 0
    dark, _ = texture_of(tree, probes)
    got = sample(dark, odd, random_units(len(odd), 1))
    assert not got.irradiance.any() and not got.level.any() and not got.weight.any()


def test_poison_in_other_tiles_does_not_enter() -> None:
    """failure-catalogue E2: every tile but the one a sample must read holds NaN."""
    tree = random_tree(4, 0.4, 6)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.0, 6))
    p = np.random.default_rng(0).uniform(0, 16, (400, 3))
    n = random_units(400, 1)
    clean = sample(texture, p, n)
    for i in range(0, 400, 9):
        level = int(clean.level[i])
        parent = np.floor(p[i] / (1 << (4 - level + 1))).astype(int)
        at = layout.parents[level - 1].tolist().index(parent.tolist())
        slot = layout.first_slot[level - 1] + at
        poisoned = np.full_like(texture.texels, np.nan)
        poisoned[slot] = texture.texels[slot]
        got = sample(dataclasses.replace(texture, texels=poisoned), p[i : i + 1], n[i : i + 1])
        np.testing.assert_array_equal(got.irradiance[0], clean.irradiance[i])


def test_one_ulp_around_a_border_is_continuous() -> None:
    """failure-catalogue E4: floor against truncation, exact faces and ±1 ulp."""
    _, texture = uniform(4)
    q = np.arange(1, 16, dtype=np.float32)
    p = np.stack([q, q[::-1], np.full_like(q, 7.3)], axis=1) * np.float32(0.5) + texture.origin.astype(np.float32)
    n = random_units(len(p), 1)
    at = sample(texture, p, n).irradiance
    for towards in (-np.inf, np.inf):
        beside = sample(texture, np.nextafter(p, np.float32(towards)), n).irradiance
        np.testing.assert_allclose(beside, at, rtol=1e-5, atol=1e-5)
