"""What two meshes exchange, split into what is known exactly and what only rays can tell.

Pairs of planar cells, one of each mesh, are classified by their shafts. Clear pairs have closed forms, blocked ones
exchange nothing, and the rest is cut in four, the larger cell of each pair, and classified again: what is left of it
lies along the edges of shadows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...datatypes import F64, I64
from .contour_batch import pair_form_factors
from .planar_cells import cell_areas, quarters
from .shaft import Blockers, classify
from .shaft_walk import BLOCKED, CLEAR

# Pairs of cells to begin with, above which the meshes are left to cosine rays.
MOST_PAIRS = 1 << 20
# Pairs are cut while each that comes out gets about this many rays.
RAYS_PER_PAIR = 64


@dataclass(frozen=True, eq=False)
class Exchange:
    """known: area times form factor of all clear pairs, m². first, second (K, 4, 3): cells, first of the one mesh, then of
    the other, that may be partly hidden from each other. weights (K,): their area times form factor if they were not, > 0.
    """

    known: float
    first: F64
    second: F64
    weights: F64


def exchange(emitter: F64, receiver: F64, blockers: Blockers, rays: int) -> Exchange:
    """Between the fronts of cells (E, 4, 3) and (R, 4, 3). rays: how many there will be for what stays unknown."""
    i, j = (x.ravel() for x in np.indices((len(emitter), len(receiver))))
    table = np.concatenate([emitter, receiver])
    known, mixed = _classified(table, np.stack([i, j + len(emitter)], axis=1), blockers)
    first, second = (table[mixed[:, k]] for k in (0, 1))
    while len(first) and 4 * RAYS_PER_PAIR * len(first) <= rays:
        first, second = _cut(first, second)
        more, mixed = _classified(np.concatenate([first, second]), _twins(len(first)), blockers)
        known += more
        first, second = first[mixed[:, 0]], second[mixed[:, 0]]
    weights = _form_factors(np.concatenate([first, second]), _twins(len(first)))
    some = weights > 0.0
    return Exchange(known, first[some], second[some], weights[some])


def _classified(table: F64, pairs: I64, blockers: Blockers) -> tuple[float, I64]:
    """What the clear pairs exchange, m², and the pairs whose visibility is not known."""
    found = classify(blockers, table, np.full(len(table), 4), pairs)
    clear = _form_factors(table, pairs[found == CLEAR])
    return math.fsum(clear), pairs[(found != CLEAR) & (found != BLOCKED)]


def _form_factors(table: F64, pairs: I64) -> F64:
    return pair_form_factors(table, np.full(len(table), 4), pairs)


def _twins(count: int) -> I64:
    return np.stack([np.arange(count), np.arange(count, 2 * count)], axis=1)


def _cut(first: F64, second: F64) -> tuple[F64, F64]:
    """Four pairs for each: the larger cell in quarters, neighbours in the list being neighbours in space."""
    larger = (cell_areas(first) >= cell_areas(second))[:, None, None, None]
    whole_1, whole_2 = (np.broadcast_to(x[:, None], (len(x), 4, 4, 3)) for x in (first, second))
    parts_1, parts_2 = np.where(larger, quarters(first), whole_1), np.where(larger, whole_2, quarters(second))
    return parts_1.reshape(-1, 4, 3), parts_2.reshape(-1, 4, 3)
