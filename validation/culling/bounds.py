"""Does the worst-case bound hold where it is a prediction, not an identity?

    |ΔE(n)| ≤ ‖ΔF‖₁ · B_max          for every lighting 0 ≤ B ≤ B_max and every normal n

On one set of rows that is Hölder's inequality, which cannot fail. Here the right side comes from the bake's own rows and the left side
from rows traced anew, with other rays and more of them, at the same probes and parents. A bake whose rows miss part of the
difference between a probe and what replaces it would then be caught. Noise of the bake's rays makes the right side larger in the mean
(the mean of a norm is no less than the norm of the mean) and could make it smaller by chance; noise of the fresh rays is not
subtracted from the left side: what holds, holds with it.

Lightings: four families at random normals; and for each probe the one that is worst for it at a normal, chosen by one half of the
fresh rays and measured by the other, so that no noise is picked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ...reference.datatypes import F64
from ...reference.directions import sphere
from ...reference.pipeline.culling import Setting, candidates
from ...reference.placement.lightings import FAMILIES, draw_lightings
from ...reference.placement.norms import NORMS, Difference
from ...reference.sh import irradiance_weights
from .retraced import SEED, Retraced

LIGHTINGS = 1000
WORST_NORMALS = 32


@dataclass(frozen=True)
class Bound:
    """held: share of probes × lightings where the fresh |ΔE| is within the bake's ‖ΔF‖₁ B_max. closest: largest ratio of the two;
    noise: root mean square of the standard error of the fresh |ΔE| under the random lightings, as a share of the bound. lightings:
    random ones, and one for each probe."""

    held: float
    closest: float
    noise: float
    lightings: int


def bound(s: Setting, fresh: Retraced, seed: int, lightings: int = LIGHTINGS) -> Bound:
    """The bake's bound against fresh rays, under at least `lightings` lightings."""
    c = candidates(s, NORMS["worst"])
    foreseen = NORMS["worst"].of(
        Difference((s.parents[fresh.chosen] @ c.rows - c.rows[fresh.chosen]).tocsr(), None, c.weights)
    )
    drawn = draw_lightings(fresh.seen, -(-lightings // len(FAMILIES)), seed + SEED)
    directions = sphere(np.random.default_rng([seed, 71]).random((max(drawn.shape[1], WORST_NORMALS), 2)))
    normals = irradiance_weights(directions)
    random = [
        np.einsum(
            "nkl,lk->nl", fresh.changed(fresh.gathered(half, drawn / drawn.max(axis=0))), normals[: drawn.shape[1]]
        )
        for half in (0, 1)
    ]
    worst = _worst(fresh, normals[:WORST_NORMALS])
    foreseen = np.maximum(
        foreseen, np.finfo(np.float64).tiny
    )  # a probe that its parents equal: held only if nothing changes
    # The halves are independent and alike: half their difference is one draw of the noise of their mean.
    mean, noise = 0.5 * (random[0] + random[1]) / foreseen[:, None], 0.5 * (random[0] - random[1]) / foreseen[:, None]
    size = np.concatenate([np.abs(mean), worst / foreseen[:, None]], axis=1)
    return Bound(
        float((size <= 1.0).mean()),
        float(size.max()),
        float(np.sqrt((noise**2).mean())),
        drawn.shape[1] + len(fresh.chosen),
    )


def _worst(fresh: Retraced, normals: F64) -> F64:
    """|ΔE| (n, normals) where every patch is at B_max = 1 or dark, whichever one half says is worse, measured by the other."""
    a, b = ([fresh.difference(half, k) for k in range(4)] for half in (0, 1))
    found = []
    for weights in normals:
        chooses, measures = _at(a, weights), _at(b, weights)
        up, down = (measures.multiply(side).sum(axis=1) for side in ((chooses > 0.0), (chooses < 0.0)))
        positive = chooses.maximum(0.0).sum(axis=1) >= (-chooses).maximum(0.0).sum(axis=1)
        found.append(np.abs(np.where(positive, up, down)))
    return np.stack(found, axis=1)


def _at(parts: list[sparse.csr_array], weights: F64) -> sparse.csr_array:
    """ΔE (n, C) at a normal by each column at 1."""
    return sum((w * part for w, part in zip(weights[1:], parts[1:], strict=True)), weights[0] * parts[0]).tocsr()
