"""The virtual texture in the order a device holds it."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.fastpath.layout import cache_textures, texel_bytes
from lightgauge.fastpath.sampler import lod_table
from small_scenes import random_probes, random_tree, texture_of


def test_every_texel_is_where_its_address_says() -> None:
    tree = random_tree(4, 0.5, 1)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.2, 1))
    cache = cache_textures(texture, "float32")
    assert cache.weight is not None
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
    assert cache.weight is not None
    used = layout.tiles * 27
    assert np.count_nonzero(cache.weight) <= used <= cache.weight.size
    assert cache.weight.dtype == np.uint16 and cache.light.dtype == np.float16


def test_weights_are_rounded_not_cut() -> None:
    tree = random_tree(4, 0.4, 3)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.5, 3))
    for storage, steps in (("half16", 65535), ("half8", 255)):
        weight, exact = cache_textures(texture, storage).weight, cache_textures(texture, "float32").weight  # type: ignore[arg-type]
        assert weight is not None and exact is not None
        got = weight.astype(np.float64) / steps
        assert np.abs(got - exact).max() <= 0.5 / steps * (1 + 1e-4)


def test_tables_of_the_kernel() -> None:
    tree = random_tree(4, 0.4, 4)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.0, 4))
    table = lod_table(texture)
    assert table[:, 0].tolist() == texture.indirection.first[:-1].tolist()
    assert table[:, 1:].tolist() == [[1] * 3, [2] * 3, [4] * 3, [8] * 3]


def test_bytes_of_a_texel() -> None:
    """What the arrays really hold: the talk's 25 bytes (12 halves and an 8-bit weight), 26 with 16 bits, 52 in float32."""
    tree = random_tree(4, 0.4, 4)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.0, 4))
    texels = 27 * int(np.prod(texture.indirection.cache))
    for storage, size in (("float32", 52), ("half", 26), ("half16", 26), ("half8", 25)):
        assert cache_textures(texture, storage).bytes == size * texels  # type: ignore[arg-type]
        assert texel_bytes(storage, "split") == size  # type: ignore[arg-type]
    for storage, size in (("float32", 64), ("half", 32)):
        assert cache_textures(texture, storage, "packed").bytes == size * 27 * layout.tiles  # type: ignore[arg-type]
        assert texel_bytes(storage, "packed") == size  # type: ignore[arg-type]


def test_packed_texels_follow_one_another() -> None:
    tree = random_tree(4, 0.5, 1)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.2, 1))
    cache = cache_textures(texture, "float32", "packed")
    assert cache.weight is None and cache.light.shape == (27 * layout.tiles, 16)
    np.testing.assert_array_equal(cache.light[:, :13], texture.texels.reshape(-1, 13))
    assert not cache.light[:, 13:].any()


@pytest.mark.parametrize(
    ("storage", "layout"), [("half8", "packed"), ("half16", "packed"), ("float32", "images"), ("half9", "split")]
)
def test_formats_that_do_not_exist_are_refused(storage: str, layout: str) -> None:
    tree = random_tree(3, 0.5, 1)
    texture, _ = texture_of(tree, random_probes(len(tree.corners), 0.2, 1))
    with pytest.raises(ValueError, match="storage"):
        cache_textures(texture, storage, layout)  # type: ignore[arg-type]
