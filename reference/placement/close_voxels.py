"""Which voxels of one level are close to surfaces: those with a corner whose harmonic mean distance is under the threshold.

One close corner is enough, so corners are asked in eight rounds, by the parity of their coordinates: every voxel has one
corner of each parity, no corner is asked twice, and voxels that are close already ask no more. A corner that is far by the threshold of
one level is far by that of all finer ones, since its distance is its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..datatypes import I64, Bool
from ..lattice import OCTANTS, distinct, finer_keys, index_of, parities, steps, union

Ask = Callable[[I64], Bool]  # whether each corner, sorted keys on the lattice of the level, is close
Watch = Callable[[int], None]  # told how many voxels are close so far; raises where they are too many
# Opposite corners follow each other: what one does not see, the other is likelier to.
ROUNDS = (0, 7, 1, 6, 2, 5, 4, 3)
PARITY = steps(OCTANTS)


@dataclass(frozen=True, eq=False)
class Asked:
    """near (N,) bool; far: sorted keys of the corners known to be far, on the level's lattice; corners: how many were asked."""

    near: Bool
    far: I64
    corners: int


def close_voxels(voxels: I64, given: Bool, far: I64, ask: Ask, watch: Watch) -> Asked:
    """Which of `voxels`, sorted keys (N,), are close.

    given (N,): those that are so without asking. far: corners known to be far, sorted keys on the lattice one level up.
    """
    near, corners, known = given.copy(), 0, finer_keys(far, 1)
    newly = [known]
    for number in ROUNDS:
        waiting = np.flatnonzero(~near)
        corner = voxels[waiting] + (parities(voxels[waiting]) ^ PARITY[number])
        asked = distinct(corner)
        if number == 0:  # the only corners that the level above has too
            asked = asked[index_of(known, asked) < 0]
        found = ask(asked) if len(asked) else np.zeros(0, dtype=np.bool_)
        at = index_of(asked, corner)
        near[waiting] = (at >= 0) & np.append(found, False)[at]
        newly.append(asked[~found])
        corners += len(asked)
        watch(int(near.sum()))
    return Asked(near, union(*newly), corners)
