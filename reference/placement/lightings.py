"""Random lightings by which culling is judged: radiosity of patches and sky, four families (failure-catalogue, "Culling honesty").

    uniform     every column uniform in [0, 1)
    lognormal   every column exp(N(0, 1))
    sparse      1 % of the columns uniform in [0, 1), the rest dark
    patch       one column 1, the rest dark

Columns that the sample points hardly see stay dark: under FAINT of the median light that they get from a column. The one patch
is drawn by the light that it sends to the points: how finely a surface is cut then does not change the odds of its being lit.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import F64, Bool

FAMILIES = ("uniform", "lognormal", "sparse", "patch")
FAINT = 0.1
SPARSE = 0.01


def noticed(seen: F64) -> Bool:
    """Columns (C,) that send enough to matter; seen (C,): light that points get from each, all being 1."""
    lit = seen > 0.0
    return seen > FAINT * np.median(seen[lit]) if lit.any() else lit


def draw_lightings(seen: F64, per_family: int, seed: int) -> F64:
    """Lightings (C, 4 · per_family), family by family; seen (C,) as in `noticed`.

    Raises ValueError if no column is seen.
    """
    chosen = np.flatnonzero(noticed(seen))
    if not len(chosen):
        raise ValueError("seen must be positive somewhere: no column sends light to the points")
    rng, n = np.random.default_rng([seed, 61]), len(chosen)
    out = np.zeros((len(seen), 4 * per_family))
    out[chosen, :per_family] = rng.random((n, per_family))
    out[chosen, per_family : 2 * per_family] = rng.lognormal(size=(n, per_family))
    few = max(1, round(SPARSE * n))
    odds = seen[chosen] / seen[chosen].sum()
    for i in range(per_family):
        out[rng.choice(chosen, few, replace=False), 2 * per_family + i] = rng.random(few)
        out[rng.choice(chosen, p=odds), 3 * per_family + i] = 1.0
    return out
