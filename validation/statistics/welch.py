"""Tests that find bias: Welch's t-test of two means with unlike variances, and Holm's correction for asking many times.

    t = (a - b) / √(v_a + v_b)      ν = (v_a + v_b)² / (v_a²/(n_a - 1) + v_b²/(n_b - 1))      v: variance of the mean

Welch 1947, "The generalization of Student's problem when several different population variances are involved"; for renderers Jung,
Hanika and Dachsbacher 2020, "Detecting bias in Monte Carlo renderers using Welch's t-test". Holm 1979, "A simple sequentially
rejective multiple test procedure": of m tests the k-th smallest p is held against α/(m - k + 1); the chance of *any* false find is
at most α, however the tests depend on each other. A test per pixel cannot see the bias of dark pixels (failure-catalogue F5), blocks
can. Not to find bias is no proof of its absence; that is for `equivalence`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import stdtr

from ...reference.datatypes import F64, I64, Bool
from .blocks import block_sums

Numbers = npt.ArrayLike


def welch(
    mean_a: Numbers, var_of_mean_a: Numbers, n_a: Numbers, mean_b: Numbers, var_of_mean_b: Numbers, n_b: Numbers
) -> F64:
    """Two-sided p that the two means are equal; all arguments broadcast. n: independent samples behind each mean.

    A mean without variance is exact. If neither has one, p is 1 where they are equal and 0 elsewhere.
    """
    a, va, na, b, vb, nb = np.broadcast_arrays(mean_a, var_of_mean_a, n_a, mean_b, var_of_mean_b, n_b)
    a, va, b, vb = (np.asarray(x, dtype=np.float64) for x in (a, va, b, vb))
    total = va + vb
    noisy = total > 0.0
    safe = np.where(noisy, total, 1.0)
    share_a, share_b = va / safe, vb / safe  # of the variance: squares of variances would underflow where it is dark
    below = share_a**2 / np.maximum(na - 1, 1) + share_b**2 / np.maximum(nb - 1, 1)
    freedom = 1.0 / np.where(noisy, below, 1.0)
    p = 2.0 * stdtr(freedom, -np.abs(a - b) / np.sqrt(safe))
    return np.where(noisy, p, (a == b).astype(np.float64))


def holm(p: F64, alpha: float) -> Bool:
    """Which of the tests with p-values `p` (M,) are rejected so that the chance of any false one is at most `alpha`: (M,) bool."""
    order = np.argsort(p, kind="stable")
    passed = p[order] > alpha / (len(p) - np.arange(len(p)))
    rejected = np.zeros(len(p), dtype=np.bool_)
    rejected[order] = np.cumsum(passed) == 0
    return rejected


@dataclass(frozen=True, eq=False)
class Blocks:
    """What G blocks of points read. points (G,). ours, truth, se (G, 3): means and the standard error of their difference, W·m⁻².
    p (G,): of the worst colour, times three. biased (G,) bool: after Holm's correction."""

    points: I64
    ours: F64
    truth: F64
    se: F64
    p: F64
    biased: Bool


def biased_blocks(ours: F64, batches: F64, block: I64, alpha: float = 0.05) -> Blocks:
    """Which blocks of points are biased, at a chance of at most `alpha` that any is named wrongly.

    ours (N, 3), or (B, N, 3) with a noise of its own per randomisation; batches (B, N, 3), independent randomisations of the truth;
    block (N,), numbers from 0 without gaps. Raises ValueError on shapes that do not match or fewer than 4 randomisations.
    """
    if batches.ndim != 3 or len(batches) < 4 or ours.shape[-2:] != batches.shape[1:] or len(block) != batches.shape[1]:
        raise ValueError(
            f"expected ours (N, 3), batches (B ≥ 4, N, 3), block (N,), got {ours.shape}, {batches.shape}, {block.shape}"
        )
    points = np.bincount(block)
    truth = block_sums(batches, block) / points[:, None]
    own = block_sums(ours, block) / points[:, None]
    n = len(batches)
    truth_variance = truth.var(axis=0, ddof=1) / n
    own_variance = own.var(axis=0, ddof=1) / len(own) if own.ndim == 3 else np.zeros_like(own)
    own_mean = own.mean(axis=0) if own.ndim == 3 else own
    each = welch(own_mean, own_variance, len(own) if own.ndim == 3 else 2, truth.mean(axis=0), truth_variance, n)
    p = np.minimum(1.0, 3.0 * each.min(axis=1))
    return Blocks(
        points.astype(np.int64), own_mean, truth.mean(axis=0), np.sqrt(truth_variance + own_variance), p, holm(p, alpha)
    )
