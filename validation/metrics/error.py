"""Error of probe lighting against a noisy reference.

    MSE     = mean over points and colours of (Ê - R_a)(Ê - R_b), over all pairs a ≠ b of independent randomisations
    relRMSE = √max(MSE, 0) / mean(R)

The cross-half estimator, averaged over all ways to halve: the reference's noise cancels. With d_b = Ê - R_b it is
((Σ d_b)² - Σ d_b²) / (B (B - 1)). Standard errors by jackknife over blocks of points: the reference's noise is independent from
point to point, so they hold it too. An MSE under twice its standard error is below the noise floor: `noise` is the relRMSE that
would stand just there. Percentiles have a bootstrap interval over points, and as `noise` what they would read of exact light: the
percentile of half the difference of the reference's two halves, which is distributed like the error of its mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student_t

from ...reference.datatypes import F64
from ..statistics.bootstrap import bootstrap
from ..statistics.jackknife import jackknife_se, mixed_blocks


@dataclass(frozen=True)
class Measured:
    """A number with its standard error, the count of points behind it, and whether it is below the noise floor.

    noise: what the reference's noise alone would read (or the least that could be told from it), None where that has no meaning.
    interval: 95 %, where it is not symmetric.
    """

    value: float
    se: float
    n: int
    below_noise: bool = False
    noise: float | None = None
    interval: tuple[float, float] | None = None


def cross_half_mse(ours: F64, batches: F64) -> float:
    """`ours` (N, 3), or (B, N, 3) with a noise of its own per randomisation; `batches` (B, N, 3)."""
    d = ours - batches
    pairs = d.sum(axis=0) ** 2 - (d**2).sum(axis=0)
    return float(pairs.mean()) / (len(batches) * (len(batches) - 1))


def rel_rmse(ours: F64, batches: F64) -> float:
    """Relative RMSE by the cross-half estimator; `ours` as in `cross_half_mse`."""
    return math.sqrt(max(cross_half_mse(ours, batches), 0.0)) / float(batches.mean())


def signed_bias(ours: F64, batches: F64) -> float:
    """(mean(Ê) - mean(R)) / mean(R)."""
    reference = float(batches.mean())
    return (float(ours.mean()) - reference) / reference


def worst_case(ours: F64, batches: F64, percentile: float = 99.0) -> float:
    """Percentile over points of |Ê - R| / mean(R), averaged over colours."""
    reference = batches.mean(axis=0)
    values = ours if ours.ndim == 2 else ours.mean(axis=0)
    return float(np.percentile(np.abs(values - reference).mean(axis=1), percentile) / reference.mean())


def jackknife(statistic: Callable[[F64, F64], float], ours: F64, batches: F64) -> float:
    """Standard error of `statistic(ours, batches)`: leave out one block of points at a time."""
    return float(
        jackknife_se(lambda keep: statistic(ours[..., keep, :], batches[:, keep]), mixed_blocks(batches.shape[1]))
    )


def measure_worst_case(ours: F64, batches: F64, percentile: float = 99.0) -> Measured:
    """`worst_case` with its bootstrap interval and what the reference's noise alone would read."""
    n, reference = batches.shape[1], batches.mean(axis=0)
    error = np.abs((ours if ours.ndim == 2 else ours.mean(axis=0)) - reference).mean(axis=1)
    mean = reference.mean(axis=1)
    spread = bootstrap(lambda d: np.percentile(error[d], percentile, axis=1) / mean[d].mean(axis=1), n)
    half = 0.5 * np.abs(batches[0::2].mean(axis=0) - batches[1::2].mean(axis=0)).mean(axis=1)
    noise = float(np.percentile(half, percentile) / batches.mean())
    return Measured(
        worst_case(ours, batches, percentile), spread.se, n, noise=noise, interval=(spread.low, spread.high)
    )


def measure_error(ours: F64, batches: F64) -> dict[str, Measured]:
    """relrmse, bias and p99 of `ours` (N, 3) or (B, N, 3) against `batches` (B, N, 3).

    Raises ValueError on shapes that do not match, fewer than 4 batches, or an all-dark reference.
    """
    if batches.ndim != 3 or len(batches) < 4 or ours.shape[-2:] != batches.shape[1:]:
        raise ValueError(f"expected ours (N, 3) and batches (B ≥ 4, N, 3), got {ours.shape} and {batches.shape}")
    if float(batches.mean()) <= 0.0:
        raise ValueError("the reference is dark everywhere: a relative error has no meaning")
    n = batches.shape[1]
    return {
        "relrmse": measure_rel_rmse(ours, batches),
        "bias": Measured(signed_bias(ours, batches), jackknife(signed_bias, ours, batches), n),
        "p99": measure_worst_case(ours, batches),
    }


def reference_noise(batches: F64) -> Measured:
    """RMS standard error of the reference's own mean over its mean, from `batches` (B, N, 3). Noise is uneven, a few points hold much
    of it: the standard error is from blocks of points."""

    def noise(values: F64) -> float:
        return math.sqrt(float(values.var(axis=0, ddof=1).mean()) / len(values)) / float(values.mean())

    n = batches.shape[1]
    se = jackknife_se(lambda keep: noise(batches[:, keep]), mixed_blocks(n))
    return Measured(noise(batches), float(se), n)


def measure_rel_rmse(ours: F64, batches: F64) -> Measured:
    """relrmse alone, shapes as for `measure_error`, which checks them."""
    mse, mse_se = cross_half_mse(ours, batches), jackknife(cross_half_mse, ours, batches)
    mean = float(batches.mean())
    below = mse < 2.0 * mse_se
    root = math.sqrt(max(mse, 0.0))
    # d√x = dx / 2√x; below the noise floor the linearisation fails and √(2 se) bounds the root.
    root_se = math.sqrt(2.0 * mse_se) / 2.0 if below else mse_se / (2.0 * root)
    return Measured(root / mean, root_se / mean, batches.shape[1], below, math.sqrt(2.0 * mse_se) / mean)


def worst_points(ours: F64, batches: F64, count: int = 5) -> npt.NDArray[np.intp]:
    """Indices of the points with the largest error beyond what the reference's noise explains, largest first.

    A point counts if a t-test of its error, corrected for the number of points and colours (Bonferroni), is significant
    at 5 % in all.
    """
    reference = batches.mean(axis=0)
    noise = batches.std(axis=0, ddof=1) / math.sqrt(len(batches))
    quantile = float(student_t.ppf(1.0 - 0.025 / reference.size, len(batches) - 1))
    excess = np.maximum(np.abs(ours - reference) - quantile * noise, 0.0).mean(axis=1)
    order = np.argsort(-excess, kind="stable")[:count]
    return order[excess[order] > 0.0]
