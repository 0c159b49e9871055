"""The octahedral map: there and back, borders, and reading between texels across its folds."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.octahedral import bordered_index, read, texel_directions, to_direction, to_square
from small_scenes import random_units


def test_there_and_back() -> None:
    d = np.concatenate([random_units(5000, 1), np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(to_direction(to_square(d)), d, atol=1e-14)
    assert np.abs(to_square(d)).max() <= 1.0


@pytest.mark.parametrize("texels", [2, 6, 14])
def test_texels_cover_the_sphere_evenly(texels: int) -> None:
    d = texel_directions(texels)
    assert d.shape == (texels**2, 3)
    np.testing.assert_allclose(d.mean(axis=0), 0.0, atol=1e-14)
    assert len(np.unique(np.round(d, 9), axis=0)) == texels**2


@pytest.mark.parametrize("texels", [2, 6, 14])
def test_the_border_holds_the_texel_beyond_the_fold(texels: int) -> None:
    """Half a texel beyond the square lies, on the sphere, half a texel before the fold's other half: folded by hand."""
    step = 2.0 / texels
    middle = (np.arange(-1, texels + 1) + 0.5) * step - 1.0
    u, v = np.meshgrid(middle, middle, indexing="ij")
    for _ in range(2):
        over = np.abs(u) > 1.0
        u, v = np.where(over, np.sign(u) * 2.0 - u, u), np.where(over, -v, v)
        over = np.abs(v) > 1.0
        u, v = np.where(over, -u, u), np.where(over, np.sign(v) * 2.0 - v, v)
    expected = np.floor((u + 1.0) / step).astype(int) * texels + np.floor((v + 1.0) / step).astype(int)
    np.testing.assert_array_equal(bordered_index(texels), expected)


def test_reading_converges_to_a_smooth_function_folds_included() -> None:
    """Bilinear: second order in the texel, but at the folds, where the map has a kink; there first order."""
    q = random_units(20_000, 3).astype(np.float32)
    q[:2000, 2] *= -np.float32(1e-3)  # near the equator, and below it
    q[2000:4000, :2] *= np.array([1.0, 1e-3], np.float32)  # beside the lower folds
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    axis = np.array([[0.3, 0.9], [0.5, -0.1], [0.8, 0.2]])
    errors = []
    for texels in (8, 16, 32):
        maps = (texel_directions(texels) @ axis).astype(np.float32)[bordered_index(texels)][None]
        errors.append(np.abs(read(maps, np.zeros(len(q), np.int64), q) - q @ axis).max())
    assert errors[0] / errors[1] > 1.7 and errors[1] / errors[2] > 1.7 and errors[2] < 0.05


def test_reading_is_continuous() -> None:
    rng = np.random.default_rng(4)
    maps = rng.random((3, 36, 2)).astype(np.float32)[:, bordered_index(6)]
    q = random_units(50_000, 5)
    q[::2, rng.integers(0, 3)] = 0.0  # on the map's seams
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    number = rng.integers(0, 3, len(q))
    beside = q + 1e-6 * random_units(len(q), 6)
    jump = read(maps, number, q.astype(np.float32)) - read(maps, number, beside.astype(np.float32))
    assert np.abs(jump).max() < 1e-4
