"""What a streamed cache holds beside what it should: every texel of every resident tile, the virtual ones among them.

    deviation = max over texels of  |Δc| / (|c| + C)  for each coefficient c of the light,  and  |Δw|  of the weight

C is the mean of |L00| over the texels that have light. Samples along a path read few virtual texels, and few of tiles that
were evicted and came again; here none is left out. A half float that is rounded the other way reads 2^-11 or less.
"""

from __future__ import annotations

import numpy as np

from ...reference.datatypes import F32
from ...reference.texture_types import WEIGHT

ZEROTH = (0, 4, 8)  # the channels of L00, by colour


def texel_deviation(held: F32, plain: F32) -> float:
    """How far texels `held` (n, 27, C) are from the plain filling `plain` (n, 27, C); what is not finite counts as 1. 0 for none."""
    if not held.size:
        return 0.0
    lit = plain[..., WEIGHT] > 0.0
    mean = float(np.abs(plain[lit][:, ZEROTH]).mean(dtype=np.float64)) if lit.any() else 0.0
    apart = np.abs(held.astype(np.float64) - plain)
    over = np.abs(plain) + max(mean, 1e-30)
    over[..., WEIGHT] = 1.0
    found = apart / over
    return float(np.where(np.isfinite(found), found, 1.0).max())
