"""The light as the page carries it, read back the way `page.js` reads it."""

from __future__ import annotations

import base64
import dataclasses
import zlib
from collections.abc import Callable

import numpy as np
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.embed import HALF_MAX, broken_pixels, fallback, halves, pixels
from lightgauge.validation.report.pictures import WHITE_AT, SceneView, exposure


def half(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """IEEE 754 binary16 by hand, as in `page.js`: sign, five bits of exponent, ten of fraction."""
    bits = (high.astype(int) << 8) | low
    exponent, fraction, sign = (bits >> 10) & 31, bits & 1023, np.where(bits & 32768, -1.0, 1.0)
    normal = 2.0 ** (exponent - 15) * (1 + fraction / 1024)
    small = 2.0**-14 * fraction / 1024
    special = np.where(fraction > 0, np.nan, np.inf)
    return sign * np.where(exponent == 31, special, np.where(exponent > 0, normal, small))


def unpack(packed: JsonObject) -> dict[str, np.ndarray]:
    """truth, ours (relative to `unit`), albedo bytes and hit."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    height, width = packed["height"], packed["width"]
    n = width * height
    assert len(data) == 16 * n
    shape = (height, width, 3)
    return {
        "truth": half(data[: 3 * n], data[3 * n : 6 * n]).reshape(shape),
        "ours": half(data[6 * n : 9 * n], data[9 * n : 12 * n]).reshape(shape),
        "albedo": data[12 * n : 15 * n].reshape(shape),
        "hit": data[15 * n :].reshape(height, width),
    }


def test_light_survives_to_half_float_precision(view: Callable[..., SceneView]) -> None:
    p = view("a", "b").pictures
    packed = pixels(p)
    found = unpack(packed)
    np.testing.assert_array_equal(found["hit"].astype(bool), p.hit)
    for name in ("truth", "ours"):
        expected = np.where(p.hit[..., None], getattr(p, name), 0.0)
        np.testing.assert_allclose(found[name] * packed["unit"], expected, rtol=2.0**-11, atol=1e-6)


def test_exposure_zero_shows_what_the_fallback_shows(view: Callable[..., SceneView]) -> None:
    """A stored value times `white` is what the tone mapping of the PNG gets."""
    p = view("a", "b").pictures
    packed = pixels(p)
    assert np.isclose(packed["white"]["irradiance"] / packed["unit"], exposure(p.truth, p.ours, p.hit))
    reflected = exposure(p.truth * p.albedo, p.ours * p.albedo, p.hit)
    assert np.isclose(packed["white"]["reflected"] / packed["unit"], reflected)
    assert packed["white"]["irradiance"] == WHITE_AT


def test_dim_and_bright_scenes_pack_alike(view: Callable[..., SceneView]) -> None:
    """The unit follows the scene: a millionth of the light loses nothing, which plain half floats would."""
    p = view("a", "b").pictures
    dim = dataclasses.replace(p, truth=p.truth * np.float32(1e-7), ours=p.ours * np.float32(1e-7))
    packed = pixels(dim)
    lit = np.where(p.hit[..., None], dim.ours, 0.0)
    np.testing.assert_allclose(unpack(packed)["ours"] * packed["unit"], lit, rtol=2.0**-10, atol=1e-13)


def test_halves_of_what_is_too_large_or_broken() -> None:
    picture = np.array([[[1e9, -1e9, np.nan], [np.inf, 0.0, 6e-8]]], np.float32)
    data = np.frombuffer(halves(picture, 1.0), np.uint8)
    values = half(data[:6], data[6:])
    assert values[0] == HALF_MAX and values[1] == -HALF_MAX
    assert np.isnan(values[[2, 3]]).all() and values[4] == 0.0 and values[5] > 0.0


def test_broken_pixels_count_only_on_surfaces(view: Callable[..., SceneView]) -> None:
    p = view("a", "b").pictures
    ours = p.ours.copy()
    on, off = np.argwhere(p.hit)[:3], np.argwhere(~p.hit)[:2]
    for row, column in [*on, *off]:
        ours[row, column, 1] = np.nan
    assert broken_pixels(dataclasses.replace(p, ours=ours)) == 3


def test_fallback_is_three_small_pngs(view: Callable[..., SceneView]) -> None:
    found = fallback(view("a", "b").pictures)
    assert set(found) == {"truth", "ours", "error"}
    assert all(uri.startswith("data:image/png;base64,") and len(uri) < 150_000 for uri in found.values())
