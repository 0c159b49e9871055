"""Tests that accept: two one-sided t-tests show that a value lies within limits (Schuirmann 1987, "A comparison of the two one-sided
tests procedure and the power approach for assessing the equivalence of average bioavailability").

    p = max( P(t_ν > (value - low) / se),  P(t_ν > (high - value) / se) )

Small p: the value is shown to be inside. The usual test, which only fails to find a difference, accepts whatever is noisy enough. The
gate's rule, value ± 2 se within the limits, is this test at a level of 2.3 % (normal).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import stdtr

from ...reference.datatypes import F64, Bool

Numbers = npt.ArrayLike


def tost(value: Numbers, se: Numbers, df: Numbers, low: Numbers, high: Numbers) -> F64:
    """p of the two one-sided tests; all arguments broadcast. df: degrees of freedom behind `se`, may be infinite.

    Without a standard error p is 0 inside the limits (or on them) and 1 outside. Raises ValueError where low > high or se < 0.
    """
    x, s, nu, a, b = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(value, se, df, low, high))
    if (a > b).any() or (s < 0.0).any():
        raise ValueError("expected low ≤ high and se ≥ 0")
    room = np.minimum(x - a, b - x)
    exact = s == 0.0
    p = stdtr(nu, -room / np.where(exact, 1.0, s))
    return np.where(exact, (room < 0.0).astype(np.float64), p)


def equivalent(value: Numbers, se: Numbers, df: Numbers, low: Numbers, high: Numbers, alpha: float = 0.05) -> Bool:
    """Whether each value is shown to lie in [low, high], with a chance of at most `alpha` of a false yes."""
    return np.asarray(tost(value, se, df, low, high) <= alpha)
