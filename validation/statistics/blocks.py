"""Points in blocks of neighbours: bias that no single point shows stands out in the mean of a block."""

from __future__ import annotations

import numpy as np

from ...reference.datatypes import F64, I32, I64


def near_blocks(positions: F64, most: int, group: I64 | I32 | None = None) -> I64:
    """Block (N,) of each point: halved at the median along the longest side until at most `most` points are left.

    positions (N, 3) m. group (N,): points of different groups (cameras, say) never share a block. Blocks of one group differ by a
    factor of at most about two in size. Raises ValueError if `most` is under 1.
    """
    if most < 1:
        raise ValueError(f"expected at least 1 point a block, got {most}")
    block = np.zeros(len(positions), dtype=np.int64)
    groups = np.zeros(len(positions), dtype=np.int64) if group is None else group
    todo = [np.flatnonzero(groups == g) for g in np.unique(groups)]
    made = 0
    while todo:
        mine = todo.pop()
        if len(mine) <= most:
            block[mine] = made
            made += 1
            continue
        axis = int(np.argmax(np.ptp(positions[mine], axis=0)))
        order = mine[np.argsort(positions[mine, axis], kind="stable")]
        todo += [order[len(order) // 2 :], order[: len(order) // 2]]
    return block


def block_sums(values: F64, block: I64) -> F64:
    """Sums (..., G, 3) of values (..., N, 3) over the points of each block."""
    count = int(block.max()) + 1 if len(block) else 0
    order = np.argsort(block, kind="stable")
    starts = np.searchsorted(block[order], np.arange(count))
    return np.add.reduceat(values[..., order, :], starts, axis=-2)
