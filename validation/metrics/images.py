"""Three figures for a picture as a whole, beside the errors at points. Each is blind to something, so they stand together.

    FLIP    mean over pixels of HDR-FLIP (Andersson et al. 2021, "Visualizing errors in rendered high dynamic range images"; package
            flip-evaluator) of the reflected light, E · albedo, at PIXELS_PER_DEGREE: what alternating between both pictures would show
    SSIM    structural similarity (Wang et al. 2004, their Gaussian window; scikit-image) of log2 luminance of the irradiance, albedo
            free, within the fixed range LOG2_RANGE about the truth's mean
    relMSE  mean of (Ê - R)² / (R² + 0.01), tev's relative squared error, of both pictures divided by the truth's mean, so that 0.01
            is the square of a tenth of the mean whatever the scene's units

The exposures of FLIP are pinned: from the truth alone, at percentiles that fireflies do not move, and recorded. Left to itself the
package takes the brightest pixel, so that the scale would depend on one path. Negative light, which L1 can give, counts as 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference.datatypes import F64, Bool
from ...reference.reconstruction import LUMINANCE

PIXELS_PER_DEGREE = 67.0  # FLIP's default: a 0.7 m wide 4K display at 0.7 m
BRIGHT, MIDDLE = 99.5, 50.0  # percentiles of lit pixels that the shortest and the longest exposure are chosen for
SHOWN_AT = 0.85  # of display white, after the tone curve (Andersson et al. 2021, section 3)
MOST_EXPOSURES = 6
LOG2_RANGE = (-8.0, 4.0)  # exposure values about the truth's mean
SIGMA = 1.5  # of SSIM's window, pixels
EPSILON = 0.01
# Rational fit of the ACES tone curve (Narkowicz 2015) with the exposure bias of 0.6 that FLIP puts before it: numerator, denominator.
ACES = ((0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0), (0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14))

Picture = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Exposures:
    """FLIP's exposures: from 2^start to 2^stop in `count` even steps of the exponent."""

    start: float
    stop: float
    count: int


@dataclass(frozen=True)
class Scores:
    """The three figures of one picture; ssim is 1 where nothing differs, the others 0."""

    flip: float
    ssim: float
    relmse: float


def luminance(picture: Picture) -> F64:
    """(H, W, 3) linear RGB -> (H, W), negative light as 0."""
    return np.asarray(np.maximum(np.asarray(picture, dtype=np.float64) @ LUMINANCE, 0.0))


def exposures(truth: Picture, hit: Bool) -> Exposures:
    """From the truth (H, W, 3) alone: the shortest shows its brightest parts at SHOWN_AT of white, the longest its middle ones.

    Raises ValueError where the truth is dark everywhere.
    """
    y = luminance(truth)[hit]
    lit = y[y > 0.0]
    if not len(lit):
        raise ValueError("the truth's picture is dark everywhere: no exposure shows it")
    bright, middle = np.percentile(lit, [BRIGHT, MIDDLE])
    white = _input_shown_at(SHOWN_AT)
    start, stop = (round(math.log2(white / max(float(v), 1e-30)), 3) for v in (bright, middle))
    return Exposures(start, stop, min(max(2, math.ceil(stop - start)), MOST_EXPOSURES))


def _input_shown_at(shown: float) -> float:
    """Linear input that the tone curve maps to `shown`: the positive root of a quadratic."""
    (a, b, c), (d, e, f) = ACES
    return float(max(np.roots([a - shown * d, b - shown * e, c - shown * f]).real))


def flip_map(truth: Picture, ours: Picture, hit: Bool, e: Exposures) -> F64:
    """HDR-FLIP (H, W), 0 … 1, of two linear pictures (H, W, 3); pixels without a surface are black in both, those that are not finite
    read 1."""
    import flip_evaluator

    shown = [np.where(hit[..., None], np.maximum(np.nan_to_num(p), 0.0), 0.0).astype(np.float32) for p in (truth, ours)]
    given = {
        "ppd": PIXELS_PER_DEGREE, "startExposure": e.start, "stopExposure": e.stop, "numExposures": e.count, "tonemapper": "aces",
    }  # fmt: skip
    error, _, _ = flip_evaluator.evaluate(*shown, "HDR", applyMagma=False, computeMeanError=False, parameters=given)
    return np.where(hit & _broken(truth, ours), 1.0, np.asarray(error[..., 0], dtype=np.float64))


def ssim_map(truth: Picture, ours: Picture, hit: Bool) -> F64:
    """SSIM (H, W) of log2 luminance over the truth's mean, clipped to LOG2_RANGE and counted from its lower end: SSIM compares means
    by their ratio, so what it is given must not be negative."""
    from skimage.metrics import structural_similarity

    mean = max(float(luminance(truth)[hit].mean()), 1e-30)
    low, high = LOG2_RANGE
    images = [
        np.where(hit, np.clip(np.log2(np.maximum(luminance(np.nan_to_num(p)) / mean, 2.0**low)), low, high) - low, 0.0)
        for p in (truth, ours)
    ]
    similar: Any = structural_similarity  # its types are not complete
    _, similarity = similar(
        *images, data_range=high - low, gaussian_weights=True, sigma=SIGMA, use_sample_covariance=False, full=True
    )  # fmt: skip
    return np.where(hit & _broken(truth, ours), 0.0, np.asarray(similarity, dtype=np.float64))


def _broken(truth: Picture, ours: Picture) -> Bool:
    """Pixels (H, W) with a number that is not finite in either picture: nothing is more unlike."""
    return np.asarray(~(np.isfinite(truth) & np.isfinite(ours)).all(axis=-1))


def relmse(truth: Picture, ours: Picture, hit: Bool) -> float:
    """Mean over pixels and colours of (Ê - R)² / (R² + EPSILON), both over the truth's mean."""
    scale = max(float(np.asarray(truth, dtype=np.float64)[hit].mean()), 1e-30)
    r, e = (np.asarray(p, dtype=np.float64)[hit] / scale for p in (truth, ours))
    return float(((e - r) ** 2 / (r * r + EPSILON)).mean())


def score(truth: Picture, ours: Picture, albedo: Picture, hit: Bool, e: Exposures) -> Scores:
    """The three figures. truth, ours (H, W, 3) irradiance, W·m⁻²; albedo (H, W, 3); hit (H, W) bool: a surface is seen; e: as chosen
    for truth · albedo."""
    if truth.shape != ours.shape or truth.shape[:2] != hit.shape:
        raise ValueError(
            f"expected two pictures (H, W, 3) and hit (H, W), got {truth.shape}, {ours.shape}, {hit.shape}"
        )
    return Scores(
        float(flip_map(truth * albedo, ours * albedo, hit, e)[hit].mean()),
        float(_inner(ssim_map(truth, ours, hit), hit).mean()),
        relmse(truth, ours, hit),
    )


def _inner(values: F64, hit: Bool) -> F64:
    """Pixels whose window (3.5 σ to each side) lies within the picture, as Wang et al. average; all of a smaller picture."""
    pad = int(3.5 * SIGMA + 0.5)
    inside = np.zeros_like(hit)
    inside[pad:-pad, pad:-pad] = True
    return values[hit & inside] if (hit & inside).any() else values[hit]
