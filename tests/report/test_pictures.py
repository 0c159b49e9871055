"""Colours: exposure, sRGB, the signed relative error and its scale."""

from __future__ import annotations

import io

import numpy as np
import pytest
from lightgauge.validation.report.pictures import (
    ERROR_CLIP,
    ERROR_STOPS,
    NO_SURFACE,
    NOT_A_NUMBER,
    WHITE_AT,
    CameraPictures,
    error_colours,
    exposure,
    luminance,
    png_bytes,
    relative_error,
    srgb_bytes,
    tonemap,
)
from PIL import Image

ALL = np.ones((4, 5), np.bool_)


def flat(value: float) -> np.ndarray:
    return np.full((4, 5, 3), value, np.float32)


@pytest.mark.parametrize(
    ("linear", "byte"), [(0.0, 0), (0.0031308, 10), (0.18, 118), (0.5, 188), (1.0, 255), (7.0, 255), (-1.0, 0)]
)
def test_srgb_against_published_values(linear: float, byte: int) -> None:
    """IEC 61966-2-1: 18 % gray is byte 118, one half is 188."""
    assert srgb_bytes(np.array([linear], np.float32))[0] == byte


def test_bright_end_of_the_truth_goes_to_white_at() -> None:
    truth = np.linspace(0.0, 10.0, 60, dtype=np.float32).reshape(4, 5, 3)
    lit = luminance(truth)
    factor = exposure(truth, flat(1e6), ALL)
    assert factor * np.percentile(lit[lit > 0], 90) == pytest.approx(WHITE_AT, rel=1e-5)


def test_exposure_falls_back_to_ours_then_to_one() -> None:
    assert exposure(flat(0.0), flat(2.0), ALL) == pytest.approx(WHITE_AT / 2.0)
    assert exposure(flat(0.0), flat(0.0), ALL) == 1.0
    assert exposure(flat(np.nan), flat(-1.0), ALL) == 1.0
    assert exposure(flat(1.0), flat(1.0), np.zeros_like(ALL)) == 1.0


def test_truth_and_ours_share_one_exposure() -> None:
    factor = exposure(flat(3.0), flat(6.0), ALL)
    truth, ours = (tonemap(flat(v), ALL, factor)[0, 0, 0] for v in (3.0, 6.0))
    assert truth == srgb_bytes(np.array([WHITE_AT], np.float32))[0]
    assert ours == 255


def test_marks_for_no_surface_and_not_a_number() -> None:
    picture, hit = flat(1.0), ALL.copy()
    picture[1, 1, 2], hit[2, 2] = np.nan, False
    shown = tonemap(picture, hit, 1.0)
    assert tuple(shown[1, 1]) == NOT_A_NUMBER and tuple(shown[2, 2]) == NO_SURFACE


def test_relative_error_is_the_formula_of_the_docstring() -> None:
    rng = np.random.default_rng(0)
    truth, ours = (rng.uniform(0.0, 4.0, (4, 5, 3)).astype(np.float32) for _ in range(2))
    y, z = (0.2126 * p[..., 0] + 0.7152 * p[..., 1] + 0.0722 * p[..., 2] for p in (truth, ours))
    np.testing.assert_allclose(relative_error(truth, ours, ALL), (z - y) / (y + 0.01 * y.mean()), rtol=1e-4, atol=1e-6)


def test_relative_error_where_all_is_black() -> None:
    ours = flat(0.0)
    ours[0, 0], ours[0, 1] = 2.0, -2.0
    error = relative_error(flat(0.0), ours, ALL)
    assert (error[0, 0], error[0, 1], error[1, 1]) == (1.0, -1.0, 0.0)


def test_relative_error_outside_is_zero_and_broken_is_nan() -> None:
    ours, hit = flat(2.0), ALL.copy()
    ours[0, 0], hit[1, 1] = np.inf, False
    error = relative_error(flat(1.0), ours, hit)
    assert not np.isfinite(error[0, 0]) and error[1, 1] == 0.0 and error[2, 2] > 0.9


def test_error_colours_hit_the_stops_and_clip() -> None:
    places = np.array([s for s, _ in ERROR_STOPS], np.float32)
    error = ((places - 0.5) * 2.0 * ERROR_CLIP)[None]
    hit = np.ones(error.shape, np.bool_)
    np.testing.assert_allclose(error_colours(error, hit)[0], [c for _, c in ERROR_STOPS], atol=1)
    far = error_colours(np.array([[-9.0, 9.0, np.nan]], np.float32), np.ones((1, 3), np.bool_))[0]
    assert [tuple(c) for c in far] == [ERROR_STOPS[0][1], ERROR_STOPS[-1][1], NOT_A_NUMBER]


def test_too_dark_is_blue_and_too_bright_red() -> None:
    dark, bright = error_colours(np.array([[-0.3, 0.3]], np.float32), np.ones((1, 2), np.bool_))[0].astype(int)
    assert dark[2] > dark[0] + 50 and bright[0] > bright[2] + 50


def test_png_round_trip() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (7, 9, 3)).astype(np.uint8)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(png_bytes(picture)))), picture)


def test_shapes_are_checked_by_name() -> None:
    with pytest.raises(ValueError, match=r"ours: expected shape \(4, 5, 3\)"):
        CameraPictures("s", "c", flat(1), flat(1)[:3], ALL, flat(1), 0.1, np.ones((4, 5), np.float32))
