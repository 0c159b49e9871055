"""Giving culled probes back where a single lit patch would get worse than asked.

Few probes are to blame: those between which that patch comes into sight. So many more probes can go than a threshold alone allows,
which stops at the first patches that it spoils.
"""

from __future__ import annotations

import numpy as np

from ..datatypes import Bool
from .judge import Blame


def given_back(blame: Blame, culled: Bool) -> Bool:
    """Which of `culled` (R,) bool must be real again, (R,) bool: for one patch after the other, the worst first, those with the
    largest parts, until the parts of all that were given back outweigh its excess."""
    back = np.zeros(len(culled), dtype=np.bool_)
    parts = blame.parts
    for patch in np.argsort(-blame.excess, kind="stable"):
        mine = slice(parts.indptr[patch], parts.indptr[patch + 1])
        probes, shares = parts.indices[mine], parts.data[mine]
        left = blame.excess[patch] - shares[back[probes]].sum()
        guilty = np.flatnonzero(culled[probes] & ~back[probes] & (shares > 0.0))
        guilty = guilty[np.argsort(-shares[guilty], kind="stable")]
        before = np.cumsum(shares[guilty]) - shares[guilty]  # what the worse ones give already
        back[probes[guilty[before < left]]] = True
    return back
