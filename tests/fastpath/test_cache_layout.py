"""The virtual texture in the order a device holds it."""

from __future__ import annotations

import struct

import numpy as np
from lightgauge.fastpath.layout import cache_textures, grid_words, lod_table
from lightgauge.reference.datatypes import pre_exposure
from small_scenes import random_probes, random_tree, texture_of


def test_every_texel_is_where_its_address_says() -> None:
    tree = random_tree(4, 0.5, 1)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.2, 1))
    cache = cache_textures(texture, "float32")
    cx, cy, cz = texture.indirection.cache
    assert cache.light.shape == (3, 3 * cz, 3 * cy, 3 * cx, 4) and cache.weight.shape == (3 * cz, 3 * cy, 3 * cx)
    for slot in range(0, layout.tiles, 5):
        x, y, z = slot % cx, slot // cx % cy, slot // (cx * cy)
        for t in range(27):
            at = (3 * z + t % 3, 3 * y + t // 3 % 3, 3 * x + t // 9)
            for colour in range(3):
                np.testing.assert_array_equal(
                    cache.light[(colour, *at)], texture.texels[slot, t, 4 * colour : 4 * colour + 4]
                )
            assert cache.weight[at] == texture.texels[slot, t, 12]


def test_unused_slots_are_zero() -> None:
    tree = random_tree(4, 0.3, 2)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.0, 2))
    cache = cache_textures(texture, "half16")
    used = layout.tiles * 27
    assert np.count_nonzero(cache.weight) <= used < cache.weight.size
    assert cache.weight.dtype == np.uint16 and cache.light.dtype == np.float16


def test_weights_are_rounded_not_cut() -> None:
    tree = random_tree(4, 0.4, 3)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.5, 3))
    for storage, steps in (("half16", 65535), ("half8", 255)):
        got = cache_textures(texture, storage).weight.astype(np.float64) / steps  # type: ignore[arg-type]
        exact = cache_textures(texture, "float32").weight
        assert np.abs(got - exact).max() <= 0.5 / steps * (1 + 1e-4)


def test_tables_of_the_kernel() -> None:
    tree = random_tree(4, 0.4, 4)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 4))
    table = lod_table(texture)
    assert table[:, 0].tolist() == texture.indirection.first[:-1].tolist()
    assert table[:, 1:].tolist() == [[1] * 3, [2] * 3, [4] * 3, [8] * 3]
    words = grid_words(texture, "half16")
    scale = pre_exposure(texture.texels)
    assert len(words) == 48
    assert struct.unpack("8f4i", words) == (0, 0, 0, 1, 16, 16, 16, scale, *texture.indirection.cache, 4)


def test_bytes_of_a_texel() -> None:
    """What the arrays really hold: the talk's 25 bytes (12 halves and an 8-bit weight), 26 with 16 bits, 52 in float32."""
    tree = random_tree(4, 0.4, 4)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 4))
    texels = 27 * int(np.prod(texture.indirection.cache))
    for storage, size in (("float32", 52), ("half16", 26), ("half8", 25)):
        assert cache_textures(texture, storage).bytes == size * texels  # type: ignore[arg-type]
