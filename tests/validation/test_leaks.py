"""Leak and overdark on made-up data."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.turned import TurnedBox
from lightgauge.validation.metrics.leaks import in_boxes, measure_band, measure_leak

DARK = np.arange(10) < 4


def reference() -> np.ndarray:
    r = np.full((10, 3), 2.0)
    r[DARK] = 0
    return r


def batches(of: np.ndarray) -> np.ndarray:
    """Four randomisations without noise."""
    return np.repeat(of[None], 4, axis=0)


def test_the_truth_neither_leaks_nor_darkens() -> None:
    found = measure_leak(reference(), batches(reference()), DARK)
    assert all(m.value == 0.0 for m in found.values())
    assert found["leak"].n == 4 and found["overdark"].n == 6


def test_a_leak_is_its_share_of_the_lit_mean() -> None:
    ours = reference()
    ours[0] = 0.02
    found = measure_leak(ours, batches(reference()), DARK)
    assert found["leak"].value == pytest.approx(0.01 / 4)
    assert found["leak_worst"].value == pytest.approx(0.01)
    assert found["leak_area"].value == 0.25 and found["overdark"].value == 0


def test_black_everywhere_does_not_win() -> None:
    found = measure_leak(np.zeros((10, 3)), batches(reference()), DARK)
    assert found["leak"].value == 0 and found["overdark"].value == 1.0


def test_too_bright_is_not_overdark_and_negative_light_is_a_leak() -> None:
    ours = reference() * 3
    ours[1] = -0.2
    found = measure_leak(ours, batches(reference()), DARK)
    assert found["overdark"].value == 0 and found["leak"].value == pytest.approx(0.1 / 4)


def test_colours_do_not_cancel() -> None:
    ours = reference()
    ours[0] = (0.2, -0.2, 0.0)
    assert measure_leak(ours, batches(reference()), DARK)["leak"].value > 0.01


def test_sets_are_checked() -> None:
    for dark in (DARK | True, DARK & False):
        with pytest.raises(ValueError, match="needs dark and lit points"):
            measure_leak(reference(), batches(reference()), dark)
    lit = reference()
    lit[2, 1] = 1e-9
    with pytest.raises(ValueError, match="not 0 in the dark set"):
        measure_leak(lit, batches(lit), DARK)


@pytest.mark.parametrize("noise", [0.03, 0.3])
@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_noise_of_the_reference_does_not_darken(noise: float, missing: float) -> None:
    """Of 4,000 lit points, half have lost `missing` of their light. Cut off at 0, a mean of noisy differences would read 0.4 of
    their noise too much; what half a reference sees as missing by chance, the other half does not."""
    rng = np.random.default_rng(5)
    truth, dark = np.repeat(rng.uniform(1.0, 3.0, (4400, 1)), 3, axis=1), np.arange(4400) >= 4000
    truth[dark] = 0.0
    seen = truth * (1.0 + np.sqrt(8.0) * noise * rng.normal(size=(8, 4400, 1)))
    ours = truth * np.where(np.arange(4400) < 2000, 1.0 - missing, 1.0)[:, None]
    found = measure_leak(ours, seen, dark)["overdark"]
    assert found.se < 0.01
    # with noise as large as the loss some losses are taken for noise, and the relative loss has noise below the line too
    assert abs(found.value - 0.5 * missing) < 5.0 * found.se + 0.2 * noise * missing


def test_in_boxes() -> None:
    p = np.array([[0, 0, 0], [0.5, 0.5, 2], [5, 5, 5], [1, 1, 1.0]])
    boxes = [TurnedBox(np.zeros(3), np.ones(3), np.eye(3)), TurnedBox(np.full(3, 4.0), np.full(3, 6.0), np.eye(3))]
    assert in_boxes(p, boxes).tolist() == [True, False, True, True]
    assert in_boxes(p, []).tolist() == [False] * 4


def test_the_band_is_signed() -> None:
    ours, band = reference(), np.arange(10) >= 8
    assert measure_band(ours, reference(), band).value == 0.0  # type: ignore[union-attr]
    ours[8] *= 0.5
    found = measure_band(ours, reference(), band)
    assert found is not None and found.value == pytest.approx(-0.25) and found.n == 2
    ours[9] *= 1.5
    assert measure_band(ours, reference(), band).value == pytest.approx(0.0)  # type: ignore[union-attr]
    assert measure_band(ours, reference(), DARK) is None and measure_band(ours, reference(), band & False) is None
