"""Prediction against what happens: does a norm of form factors tell which probes may go (failure-catalogue, "Culling honesty")?

Predicted is the norm of the bake's own rows. Realised is the change of the probe's light when it is mixed from its parents, with
rays that are independent of the bake's and more of them, under lightings of four families:

    realised_i² = mean over lightings of (‖ΔE_i‖ / Ē)²      ‖·‖: root mean square over all normals; Ē: mean of ‖E‖ over probes

from two independent sets of rays, ‖ΔE‖² = ΔE_a · ΔE_b, so that their noise cancels; of the family `patch` not some patches but all
of them, each with its odds. The rank correlation (Spearman) is between the two over probes. As shares, p = norm(ΔF) / norm(F)
and r = ‖ΔE‖ / ‖E‖, for every probe and lighting where the probe gets DIM of the mean light: coverage is P(r ≤ p), overshoot
the 99th percentile of r / p where p is not lost in noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from ...reference.datatypes import F64
from ...reference.pipeline.culling import Setting, candidates
from ...reference.placement.lightings import FAMILIES, draw_lightings, noticed
from ...reference.placement.norms import MEAN_SQUARE, NORMS, Difference
from .retraced import SEED, Retraced

PER_FAMILY = 50
DIM = 0.01


@dataclass(frozen=True)
class Honest:
    """One norm over one family. rank: Spearman's correlation; coverage and overshoot: see above; probes: behind them."""

    norm: str
    family: str
    rank: float
    coverage: float
    overshoot: float
    probes: int


def honesty(s: Setting, fresh: Retraced, seed: int) -> list[Honest]:
    """All norms over all families."""
    chosen, found = fresh.chosen, []
    truth = _realised(fresh, seed)
    for name, norm in NORMS.items():
        c = candidates(s, norm)
        mix, rows = s.parents[chosen], c.rows
        delta = (mix @ rows - rows[chosen]).tocsr()
        spread = None if c.variance is None else (mix.power(2) @ c.variance + c.variance[chosen]).tocsr()
        own = None if c.variance is None else c.variance[chosen]
        size = norm.of(Difference(delta, spread, c.weights))
        share = size / np.maximum(norm.of(Difference(rows[chosen], own, c.weights)), np.finfo(np.float64).tiny)
        for f, family in enumerate(FAMILIES):
            rank = float(stats.spearmanr(size, truth.realised[:, f]).statistic)
            coverage, overshoot = truth.compared(share, f)
            found.append(Honest(name, family, rank, coverage, overshoot, len(chosen)))
    return found


@dataclass(frozen=True, eq=False)
class _Truth:
    """realised (n, 4) squared, by family; light, change (n, 4 · PER_FAMILY): ‖E‖ and ‖ΔE‖ under each lighting."""

    realised: F64
    light: F64
    change: F64

    def compared(self, share: F64, family: int) -> tuple[float, float]:
        """Coverage and overshoot of predicted shares (n,)."""
        part = slice(family * PER_FAMILY, (family + 1) * PER_FAMILY)
        light, change = self.light[:, part], self.change[:, part]
        lit = light > DIM * light.mean(axis=0)
        ratio = np.full(light.shape, np.inf)
        np.divide(
            change / np.maximum(light, np.finfo(np.float64).tiny), share[:, None], out=ratio, where=share[:, None] > 0.0
        )
        known = lit & np.isfinite(ratio)
        return float((ratio[lit] <= 1.0).mean()), float(np.quantile(ratio[known], 0.99)) if known.any() else 0.0


def _realised(fresh: Retraced, seed: int) -> _Truth:
    """What becomes of the probes, by rays of their own."""
    lightings = draw_lightings(fresh.seen, PER_FAMILY, seed + SEED)
    here = [fresh.gathered(half, lightings) for half in (0, 1)]
    change = [fresh.changed(gathered) for gathered in here]
    light = _square(here[0][fresh.at], here[1][fresh.at])
    squares = _square(change[0], change[1])
    realised = (squares / light.mean(axis=0)).reshape(len(fresh.chosen), len(FAMILIES), PER_FAMILY).mean(axis=2)
    realised[:, FAMILIES.index("patch")] = _single(fresh)
    return _Truth(realised, np.sqrt(np.maximum(light, 0.0)), np.sqrt(np.maximum(squares, 0.0)))


def _square(a: F64, b: F64) -> F64:
    """Mean square irradiance over all normals (n, m) of radiance SH (n, 4, m), by two independent estimates of it."""
    return np.asarray(np.einsum("nkm,nkm,k->nm", a, b, MEAN_SQUARE))


def _single(fresh: Retraced) -> F64:
    """Mean over single patches, drawn by the light they send, of (‖ΔE‖ / Ē)², (n,)."""
    light, change = np.zeros(len(fresh.seen)), []
    for k in range(4):
        a, b = (half.matrix(k).astype(np.float64)[fresh.at] for half in fresh.halves)
        light += MEAN_SQUARE[k] * np.asarray(a.multiply(b).mean(axis=0)).ravel()
        change.append(MEAN_SQUARE[k] * fresh.difference(0, k).multiply(fresh.difference(1, k)))
    known = noticed(fresh.seen) & (light > 0.0)
    weights = np.divide(fresh.seen, light, out=np.zeros(len(fresh.seen)), where=known) / fresh.seen[known].sum()
    return np.asarray(sum(part @ weights for part in change), dtype=np.float64)
