"""η with an interval, from squared errors that know their placement and their points.

    log e_grid(N) = a + b log N   least squares over the grids whose error is within REACH of ours
    log η         = (log e_ours - a) / b - log N_ours

Both placements are judged at the same points, so much of what a few points do to one they do to the other: blocks of points are left
out of both at once. Placements are independent, each lattice lying where it likes: one is left out at a time, of ours and of every
size of grid. The three variances add up (delete-one jackknife of log η, whose distribution is more even than that of η).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...reference.datatypes import F64
from ..statistics.jackknife import se_of_rest

REACH = 2.0
LEAST = 3  # grids on the line
SURE = 2.0  # standard errors


@dataclass(frozen=True)
class Paired:
    """η; of log η the standard errors that points, our placements and the grids' are to blame for. grids: how many are on the line;
    slope: of log error by log cost."""

    value: float
    points: float
    ours: float
    theirs: float
    grids: int
    slope: float

    @property
    def se(self) -> float:
        """Standard error of log η."""
        return math.hypot(self.points, self.ours, self.theirs)

    @property
    def interval(self) -> tuple[float, float]:
        """η at SURE standard errors to either side."""
        return self.value * math.exp(-SURE * self.se), self.value * math.exp(SURE * self.se)


def paired_eta(own_cost: float, own: F64, costs: Sequence[float], grids: Sequence[F64]) -> Paired | None:
    """own (S, B): mean squared errors by placement and block of points, at cost `own_cost`; grids: the same (S_g, B), in the same
    blocks, of each size of grid, at `costs`. None where fewer than LEAST grids are near in error, or none on one of its sides, where
    an error is under the points' noise, or where the line through the grids does not fall for sure."""
    error = np.log([max(float(g.mean()), np.finfo(np.float64).tiny) for g in (own, *grids)]) / 2.0
    near = [i for i in range(len(grids)) if abs(error[1 + i] - error[0]) <= math.log(REACH)]
    around = [error[1 + i] for i in near]
    if len(near) < LEAST or not min(around) <= error[0] <= max(around):
        return None
    log_cost = np.log([costs[i] for i in near])
    away = log_cost - log_cost.mean()
    curve = [grids[i] for i in near]

    def line(means: Sequence[float]) -> tuple[float, float]:
        log_error = 0.5 * np.log(means)
        slope = float(away @ log_error / (away @ away))
        return slope, float(log_error.mean() - slope * log_cost.mean())

    def log_eta(mine: F64, theirs: Sequence[F64]) -> float:
        slope, at_one = line([float(g.mean()) for g in theirs])
        return (0.5 * math.log(float(mine.mean())) - at_one) / slope - math.log(own_cost)

    def rest(a: F64, i: int, axis: int) -> F64:
        return np.delete(a, i, axis=axis)

    blocks = range(own.shape[1])
    kept = [[rest(g, b, 1) for g in (own, *curve)] for b in blocks]
    if len(blocks) < 2 or min(float(g.mean()) for some in kept for g in some) <= 0.0:
        return None
    slopes = [line([float(g.mean()) for g in some[1:]])[0] for some in kept]
    if line([float(g.mean()) for g in curve])[0] + SURE * float(se_of_rest(slopes)) >= 0.0:
        return None
    points = [log_eta(some[0], some[1:]) for some in kept]
    ours = [log_eta(rest(own, s, 0), curve) for s in range(len(own))] if len(own) > 1 else []
    theirs = [
        float(se_of_rest([log_eta(own, [*curve[:g], rest(curve[g], s, 0), *curve[g + 1 :]]) for s in range(len(curve[g]))]))
        for g in range(len(curve)) if len(curve[g]) > 1
    ]  # fmt: skip
    return Paired(
        math.exp(log_eta(own, curve)),
        float(se_of_rest(points)),
        float(se_of_rest(ours)) if ours else 0.0,
        math.hypot(*theirs),
        len(near),
        line([float(g.mean()) for g in curve])[0],
    )
