"""Image metrics: what they see, what they are blind to, and that noise of the truth moves no exposure."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.validation.metrics import images

H, W = 40, 48
HIT = np.ones((H, W), dtype=np.bool_)
ONE = np.ones((H, W, 3))


def picture() -> np.ndarray:
    """A smooth, coloured ramp over three stops with a dark disc."""
    y, x = np.mgrid[0:H, 0:W]
    light = 0.5 * np.exp2(3.0 * x / W)
    light[(x - 24) ** 2 + (y - 20) ** 2 < 60] *= 0.1
    return (light[..., None] * [1.0, 0.8, 0.5]).astype(np.float32)


def scored(truth: np.ndarray, ours: np.ndarray) -> images.Scores:
    return images.score(truth, ours, ONE, HIT, images.exposures(truth, HIT))


def test_equal_pictures_score_perfectly() -> None:
    assert scored(picture(), picture()) == images.Scores(0.0, pytest.approx(1.0), 0.0)


def test_relmse_is_its_formula_in_any_unit() -> None:
    """A tenth too bright over an even 2 W/m²: 0.01 / 1.01; the same in other units."""
    even = np.full((H, W, 3), 2.0)
    for unit in (1.0, 1e-6, 1e4):
        assert images.relmse(unit * even, 1.1 * unit * even, HIT) == pytest.approx(0.01 / 1.01, rel=1e-9)


def test_scores_do_not_depend_on_units() -> None:
    truth, ours = picture(), picture()[:, ::-1]
    near, far = scored(truth, ours), scored(1e4 * truth, 1e4 * ours)
    assert (far.flip, far.ssim, far.relmse) == pytest.approx((near.flip, near.ssim, near.relmse), rel=1e-3)


def test_blindness_is_as_said() -> None:
    """SSIM hardly sees a wrong brightness that relMSE and FLIP see; all three see a lost disc."""
    truth = picture()
    bright, lost = scored(truth, 1.3 * truth), scored(truth, np.where(truth < 0.3, 0.6, truth).astype(np.float32))
    assert bright.ssim > 0.99 and bright.relmse > 0.05 and bright.flip > 0.02
    assert lost.ssim < 0.97 and lost.relmse > 0.02 and lost.flip > 0.02


def test_exposures_come_from_the_truth_and_ignore_a_firefly() -> None:
    truth = picture()
    firefly = truth.copy()
    firefly[3, 3] = 1e5
    one, other = images.exposures(truth, HIT), images.exposures(firefly, HIT)
    assert other.start == pytest.approx(one.start, abs=0.01) and other.stop == pytest.approx(one.stop, abs=0.01)
    assert one.start < one.stop and 2 <= one.count <= images.MOST_EXPOSURES
    with pytest.raises(ValueError, match="dark everywhere"):
        images.exposures(0.0 * truth, HIT)


def test_exposures_are_those_of_the_package_where_it_can_be_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the brightest pixel for the percentile our exposures are those that flip-evaluator chooses for itself."""
    import flip_evaluator

    monkeypatch.setattr(images, "BRIGHT", 100.0)
    mine = images.exposures(picture(), HIT)
    _, _, chosen = flip_evaluator.evaluate(picture(), picture(), "HDR", applyMagma=False)
    assert (mine.start, mine.stop) == pytest.approx((chosen["startExposure"], chosen["stopExposure"]), abs=0.02)


def test_only_pixels_with_a_surface_count() -> None:
    truth, ours, hit = picture(), picture(), HIT.copy()
    hit[:, 24:] = False
    ours[:, 24:] = 7.0
    assert (
        images.relmse(truth, ours, hit) == 0.0
        and images.flip_map(truth, ours, hit, images.Exposures(0, 1, 2)).max() == 0.0
    )
    with pytest.raises(ValueError, match="two pictures"):
        images.score(truth, ours[:-1], ONE, hit, images.Exposures(0, 1, 2))


def test_a_pixel_that_is_not_a_number_is_as_wrong_as_can_be() -> None:
    truth, hit = picture(), np.ones(picture().shape[:2], bool)
    ours = truth.copy()
    ours[20, 20] = np.nan
    e = images.exposures(truth, hit)
    assert images.flip_map(truth, ours, hit, e)[20, 20] == 1.0 and images.ssim_map(truth, ours, hit)[20, 20] == 0.0
    assert np.isnan(images.relmse(truth, ours, hit))  # which a record leaves out, and says so
