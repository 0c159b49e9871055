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
from scipy import sparse, stats

from ...reference.datatypes import F64, I64
from ...reference.directions import sphere
from ...reference.pipeline.culling import Setting, candidates
from ...reference.placement.lightings import FAMILIES, draw_lightings, noticed
from ...reference.placement.norms import MEAN_SQUARE, NORMS, Difference
from ...reference.progress import silent
from ...reference.sh import irradiance_weights
from ...reference.transport.form_factors import FormFactors, probe_form_factors

PROBES, RAYS = 300, 8192
PER_FAMILY = 50
BOUND_LIGHTINGS = 1000
DIM = 0.01
WORST_NORMALS = 32
SEED = 900


@dataclass(frozen=True)
class Honest:
    """One norm over one family. rank: Spearman's correlation; coverage and overshoot: see above; probes: behind them."""

    norm: str
    family: str
    rank: float
    coverage: float
    overshoot: float
    probes: int


@dataclass(frozen=True)
class Bound:
    """held: share of probes × lightings where |ΔE| ≤ ‖ΔF‖₁ B_max at a normal; closest: largest ratio of the two."""

    held: float
    closest: float
    lightings: int


def some_able(s: Setting, seed: int, most: int = PROBES) -> I64:
    """Numbers of at most `most` probes that could be culled."""
    able = np.flatnonzero(s.able)
    return np.sort(np.random.default_rng([seed, 67]).choice(able, min(most, len(able)), replace=False))


def honesty(s: Setting, seed: int, rays: int = RAYS, most: int = PROBES) -> list[Honest]:
    """All norms over all families."""
    chosen = some_able(s, seed, most)
    found = []
    truth = _realised(s, chosen, seed, rays)
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


def _realised(s: Setting, chosen: I64, seed: int, rays: int) -> _Truth:
    """What becomes of probes `chosen` (n,), by rays of their own."""
    mix = s.parents[chosen]
    needed = np.unique(np.concatenate([chosen, mix.indices]))
    at, mix = np.searchsorted(needed, chosen), mix[:, needed]
    positions = s.probes.octree.positions[needed]
    halves = [
        probe_form_factors(s.surfaces.geometry, s.surfaces.patches, positions, rays, seed + SEED + h, silent)
        for h in (0, 1)
    ]
    seen = np.maximum(sum(np.asarray(h.matrix(0).sum(axis=0)).ravel() for h in halves), 0.0)
    seen[-1] = 0.0
    lightings = draw_lightings(seen, PER_FAMILY, seed + SEED)
    here = [_gathered(h, lightings) for h in halves]
    change = [h[at] - (mix @ h.reshape(len(needed), -1)).reshape(h[at].shape) for h in here]
    light = _square(here[0][at], here[1][at])
    squares = _square(change[0], change[1]) / light.mean(axis=0)
    realised = squares.reshape(len(chosen), len(FAMILIES), PER_FAMILY).mean(axis=2)
    realised[:, FAMILIES.index("patch")] = _single(halves, at, mix, seen)
    return _Truth(realised, np.sqrt(np.maximum(light, 0.0)), np.sqrt(np.maximum(_square(change[0], change[1]), 0.0)))


def _gathered(rows: FormFactors, lightings: F64) -> F64:
    return np.stack([rows.matrix(k) @ lightings for k in range(4)], axis=1)


def _square(a: F64, b: F64) -> F64:
    """Mean square irradiance over all normals (n, m) of radiance SH (n, 4, m), by two independent estimates of it."""
    return np.asarray(np.einsum("nkm,nkm,k->nm", a, b, MEAN_SQUARE))


def _single(halves: list[FormFactors], at: I64, mix: sparse.csr_array, seen: F64) -> F64:
    """Mean over single patches, drawn by the light they send, of (‖ΔE‖ / Ē)², (n,)."""
    light, change = np.zeros(len(seen)), []
    for k in range(4):
        a, b = (h.matrix(k).astype(np.float64) for h in halves)
        light += MEAN_SQUARE[k] * np.asarray(a[at].multiply(b[at]).mean(axis=0)).ravel()
        change.append(MEAN_SQUARE[k] * (a[at] - mix @ a).multiply(b[at] - mix @ b))
    known = noticed(seen) & (light > 0.0)
    weights = np.divide(seen, light, out=np.zeros(len(seen)), where=known) / seen[known].sum()
    return np.asarray(sum(part @ weights for part in change), dtype=np.float64)


def bound(s: Setting, seed: int, lightings: int = BOUND_LIGHTINGS, most: int = PROBES) -> Bound:
    """|ΔE(n)| ≤ ‖ΔF‖₁ B_max on the bake's own rows: random lightings and normals, and for each probe the lighting that comes
    nearest to it at any of WORST_NORMALS normals."""
    chosen = some_able(s, seed, most)
    c = candidates(s, NORMS["worst"])
    delta = (s.parents[chosen] @ c.rows - c.rows[chosen]).tocsr()
    most_of = NORMS["worst"].of(Difference(delta, None, c.weights))
    parts = [delta[:, k::4].tocsr() for k in range(4)]
    seen: F64 = np.asarray(abs(c.rows[:, ::4]).sum(axis=0), dtype=np.float64).ravel()
    drawn = draw_lightings(seen, -(-lightings // len(FAMILIES)), seed + SEED)
    normals = irradiance_weights(sphere(np.random.default_rng([seed, 71]).random((drawn.shape[1], 2))))
    change = np.stack([part @ drawn for part in parts], axis=1)
    ratio = np.abs(np.einsum("nkm,mk->nm", change, normals)) / drawn.max(axis=0) / most_of[:, None]
    nearest = np.stack([_adversarial(parts, weights) for weights in normals[:WORST_NORMALS]]).max(axis=0) / most_of
    every = np.concatenate([ratio.ravel(), nearest])
    return Bound(float((every <= 1.0 + 1e-6).mean()), float(every.max()), drawn.shape[1] + len(chosen))


def _adversarial(parts: list[sparse.csr_array], weights: F64) -> F64:
    """Largest |ΔE| (n,) at a normal when every patch is at B_max = 1 or dark, whichever makes it worse."""
    each = sum(w * part for w, part in zip(weights, parts, strict=True))
    return np.maximum(each.maximum(0.0).sum(axis=1), (-each).maximum(0.0).sum(axis=1))
