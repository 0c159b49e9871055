"""How much each link makes of the error: mean, RMS, cross terms, correlation with the whole, and share of the squared error.

With d_k (B, N, 3) link k by batch, and pairs of different batches a ≠ b,

    M_kl  = mean over points and colours of Σ_(a≠b) (d_k^a d_l^b + d_l^a d_k^b) / (2 B (B - 1))        noise cancels
    MSE   = Σ_kl M_kl                                  exactly the cross-half error of the whole (metrics/error.py)
    S     = mean of (mean_b Σ_k d_k)²                  the squared error as it is seen, noise of the reference included
    share_k = Σ_l M_kl / S,   remainder = (S - MSE) / S,   Σ share + remainder = 1

A share may be negative: that link cancels others. Standard errors by jackknife over blocks of points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...reference.datatypes import F64, Bool
from ..statistics.jackknife import mixed_blocks, se_of_rest


@dataclass(frozen=True, eq=False)
class Waterfall:
    """All relative to the reference's mean light (W·m⁻², `reference`), or its square; K links. signed, rms, correlation, share (K,),
    each with `_se` (K,); cross (K, K): M over the mean squared. total_rms, total_signed: of the whole. explained: share of S that the
    links make; seen: S. closure: |Σ of the signed means - the whole's| of the mean. noisy (K,): M_kk below twice its standard error."""

    reference: float
    points: int
    signed: F64
    signed_se: F64
    rms: F64
    rms_se: F64
    correlation: F64
    correlation_se: F64
    share: F64
    share_se: F64
    cross: F64
    noisy: Bool
    total_signed: float
    total_signed_se: float
    total_rms: float
    total_rms_se: float
    explained: float
    explained_se: float
    seen: float
    closure: float


def links_of(stages: list[F64]) -> F64:
    """Links (K, B, N, 3) from K + 1 stages (B or 1, N, 3)."""
    batches = max(len(s) for s in stages)
    shape = (batches, *stages[0].shape[1:])
    return np.stack([np.broadcast_to(b, shape) - np.broadcast_to(a, shape) for a, b in pairwise(stages)])


def waterfall(stages: list[F64], scale: float | None = None) -> Waterfall:
    """The statistics of K + 1 stages, the reference first. scale: W·m⁻² that figures are relative to, the mean of the first stage if
    None.

    Raises ValueError where the reference is dark or comes in fewer than four batches.
    """
    reference = float(stages[0].mean()) if scale is None else scale
    if reference <= 0.0 or len(stages[0]) < 4:
        raise ValueError("a waterfall needs a reference that is not dark, in at least 4 batches")
    d = links_of(stages) / reference
    whole = (stages[-1].mean(axis=0) - stages[0].mean(axis=0)) / reference
    table = _point_table(d)
    blocks = mixed_blocks(d.shape[2])
    summed = np.stack([table[blocks == b].sum(axis=0) for b in range(int(blocks.max()) + 1)])
    counts = np.bincount(blocks).astype(np.float64)
    value = _statistics(summed.sum(axis=0) / counts.sum(), len(d))
    left = zip(summed.sum(axis=0) - summed, counts.sum() - counts, strict=True)
    se = se_of_rest([_statistics(part / n, len(d)) for part, n in left]) if len(counts) > 1 else np.zeros_like(value)
    k = len(d)
    v, e = _named(value, k), _named(se, k)
    square, square_se = np.maximum(v["diagonal"], 0.0), e["diagonal"]
    rms = np.sqrt(square)
    total = max(float(v["mse"][0]), 0.0)
    return Waterfall(
        reference, d.shape[2], v["signed"], e["signed"], rms, _root_se(square, square_se), v["correlation"], e["correlation"],
        v["share"], e["share"], v["cross"].reshape(k, k), np.asarray(v["diagonal"] < 2.0 * square_se), float(v["signed"].sum()),
        float(e["total"][0]), float(np.sqrt(total)), float(_root_se(np.array([total]), e["mse"])[0]), float(v["explained"][0]),
        float(e["explained"][0]), float(v["seen"][0]), abs(float(v["signed"].sum()) - float(whole.mean())),
    )  # fmt: skip


def _root_se(square: F64, se: F64) -> F64:
    """Standard error of a root: d√x = dx / 2√x; below the noise floor that fails and √(2 se) bounds the root."""
    below = square <= 2.0 * se  # nothing at all is below too
    return np.where(below, np.sqrt(2.0 * se) / 2.0, se / (2.0 * np.sqrt(np.where(below, 1.0, square))))


def _point_table(d: F64) -> F64:
    """Per point, averaged over colours: signed means (K), cross terms (K · K), squared whole (1); (N, K + K² + 1)."""
    batches, n = d.shape[1], d.shape[2]
    total = d.sum(axis=1)  # (K, N, 3)
    same = np.einsum("kbnc,lbnc->nkl", d, d)
    pairs = (np.einsum("knc,lnc->nkl", total, total) - same) / (3.0 * batches * (batches - 1))
    seen = ((total.sum(axis=0) / batches) ** 2).mean(axis=1)
    return np.column_stack([total.mean(axis=2).T / batches, pairs.reshape(n, -1), seen])


def _statistics(mean: F64, k: int) -> F64:
    """All figures, one after the other, from the mean row of the table."""
    signed, cross, seen = mean[:k], mean[k : k + k * k].reshape(k, k), mean[-1]
    with_all, mse = cross.sum(axis=1), cross.sum()
    diagonal = np.diag(cross)
    below = np.sqrt(np.maximum(diagonal, 0.0) * max(mse, 0.0))
    correlation = np.divide(with_all, below, out=np.zeros(k), where=below > 0.0)
    seen = max(seen, np.finfo(np.float64).tiny)
    return np.concatenate(
        [
            signed,
            diagonal,
            np.clip(correlation, -1.0, 1.0),
            with_all / seen,
            cross.ravel(),
            [signed.sum(), mse, mse / seen, seen],
        ]
    )


def _named(values: F64, k: int) -> dict[str, F64]:
    """The parts of `_statistics` by name."""
    names = {
        "signed": k,
        "diagonal": k,
        "correlation": k,
        "share": k,
        "cross": k * k,
        "total": 1,
        "mse": 1,
        "explained": 1,
        "seen": 1,
    }
    ends = np.cumsum(list(names.values()))
    return {name: values[end - size : end] for (name, size), end in zip(names.items(), ends, strict=True)}
