"""Texel values and storage formats (failure-catalogue D3, D4, E3)."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.lattice import OCTANTS
from lightgauge.reference.volume.layout import TEXEL_OFFSETS
from lightgauge.reference.volume.tiles import PARENT_WEIGHTS, fill_tiles, probe_texels, stored
from small_scenes import random_probes, random_tree, texture_of


def test_parent_weights_interpolate_linear_functions_exactly() -> None:
    """Rows sum to 1, are not negative, and reproduce position within the parent tile."""
    np.testing.assert_allclose(PARENT_WEIGHTS.sum(axis=2), 1.0)
    assert PARENT_WEIGHTS.min() >= 0
    for o, octant in enumerate(OCTANTS):
        np.testing.assert_allclose(PARENT_WEIGHTS[o] @ TEXEL_OFFSETS, octant + TEXEL_OFFSETS / 2, atol=1e-7)


def test_probe_texels_are_premultiplied() -> None:
    coefficients = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    texels = probe_texels(coefficients, np.array([True, False]))
    np.testing.assert_array_equal(texels[0], [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11, 1])
    np.testing.assert_array_equal(texels[1], 0)
    # an invalid probe's garbage must not survive as NaN × 0
    garbage = probe_texels(np.full((1, 4, 3), np.nan, np.float32), np.array([False]))
    np.testing.assert_array_equal(garbage, 0)


def test_a_mixed_virtual_probe_has_a_fractional_weight() -> None:
    tree = random_tree(4, 0.4, 2)
    texture, layout = texture_of(tree, random_probes(len(tree.corners), 0.4, 2))
    virtual = np.concatenate([p.ravel() for p in layout.probe]) < 0
    weight = texture.texels[..., 12].ravel()
    assert ((weight[virtual] > 0.01) & (weight[virtual] < 0.99)).any()
    assert set(np.unique(weight[~virtual])) == {0.0, 1.0}
    light = texture.texels.reshape(-1, 13)
    # probes' light is in 0.5 … 1.5: so is the quotient wherever there is weight
    some = weight > 1e-3
    quotient = light[some, :12] / weight[some, None]
    assert quotient.min() > 0.5 - 1e-3 and quotient.max() < 1.5 + 1e-3


def test_no_tiles_no_probes_wrongly_shared() -> None:
    """Doubling one probe's light changes exactly the texels that are it or hang on it, and linearly."""
    tree = random_tree(3, 0.5, 4)
    _, layout = texture_of(tree, random_probes(len(tree.corners), 0.0, 4))
    one = np.zeros((len(tree.corners), 13), np.float32)
    total = np.zeros((layout.tiles, 27, 13), np.float32)
    for i in range(len(one)):
        one[:] = 0
        one[i] = 1.0
        total += fill_tiles(layout, one)
    everything = fill_tiles(layout, np.ones_like(one))
    np.testing.assert_allclose(total, everything, atol=1e-5)


@pytest.mark.parametrize("storage, steps", [("half16", 65535), ("half8", 255)])
def test_storage_error_bounds(storage: str, steps: int) -> None:
    """Half after pre-exposure: relative 2^-11 over 8.4 decades below the brightest. Unorm weight: half a step. What a
    probe says, light over weight, keeps the bound of the half float however coarse the weight is."""
    rng = np.random.default_rng(0)
    texels = np.concatenate([10 ** rng.uniform(-3.5, 4.8, (5000, 12)), rng.random((5000, 1))], axis=1).astype(
        np.float32
    )
    texels[:, 12] = np.maximum(texels[:, 12], 1.0 / steps)  # under half a step both are 0
    kept = stored(texels, storage)  # type: ignore[arg-type]
    assert np.abs(kept[:, :12] / kept[:, 12:] / (texels[:, :12] / texels[:, 12:]) - 1).max() <= 2**-11 + 1e-6
    assert np.abs(kept[:, 12] - texels[:, 12]).max() <= 0.5 / steps + 2.0**-24  # and what float32 rounds
    ends = stored(np.float32([[1] * 12 + [0], [1] * 12 + [1]]), storage)  # type: ignore[arg-type]
    assert ends[:, 12].tolist() == [0.0, 1.0], "0 and 1 are exact"
    again = stored(kept, storage)  # type: ignore[arg-type]
    assert (again != kept).mean() < 1e-3, "stored again it is the same, but where the weight's rounding tips a half"
    np.testing.assert_allclose(again, kept, rtol=2**-10)


def test_eight_bits_cannot_hold_a_half() -> None:
    half = np.float32([[1.0] * 12 + [0.5]])
    e8 = abs(float(stored(half, "half8")[0, 12]) / 0.5 - 1)
    e16 = abs(float(stored(half, "half16")[0, 12]) / 0.5 - 1)
    assert e8 == pytest.approx(0.0039, abs=1e-4) and e16 < 2e-5
    assert stored(half, "float32") is half


def test_what_half_floats_lose() -> None:
    """failure-catalogue E3: what is too bright for a half must not become infinite in the cache (infinity × 0 is NaN in
    every neighbour), and what is lost is dark beside the brightest: 2^-24 / 2^15 of it and less."""
    for scale in (1e-30, 1e-9, 1.0, 1e5, 1e30):
        kept = stored(np.float32([[scale, 1e-13 * scale, *[0.5 * scale] * 10, 1.0]]), "half16")
        assert np.isfinite(kept).all()
        np.testing.assert_allclose(kept[0, :12] / scale, [1.0, 0.0, *[0.5] * 10], rtol=2**-11, atol=1e-14)
