"""Polygons to triangles."""

from __future__ import annotations

import numpy as np

from ..datatypes import I64


def fan(counts: I64) -> tuple[I64, I64]:
    """Triangle fans of polygons that lie one after another in a flat corner list.

    counts: (P,) corners of each polygon, all ≥ 3. Returns (T, 3) positions in the corner list and (T,) the polygon
    each triangle came from. A concave polygon may fold over, as in every reader that makes fans.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    triangles = counts - 2
    owner = np.repeat(np.arange(len(counts), dtype=np.int64), triangles)
    first = np.concatenate([[0], np.cumsum(triangles)[:-1]]).astype(np.int64)
    step = np.arange(int(triangles.sum()), dtype=np.int64) - first[owner]
    base = starts[owner]
    return np.stack([base, base + step + 1, base + step + 2], axis=1), owner
