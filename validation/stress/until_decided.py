"""Samples until a case is decided: equally many new ones before each look, and no more once every band is told from its reading.

A band is told when its reading is so far in or out that judge.py's rule would say so after any further look: by a group-sequential
stop (statistics/plan.py) at the chance that the judge allows a point. Its bounds are never under the judge's, so what is decided here
is decided there. A band that is wide beside the noise needs no telling: how wide does not depend on the reading, so stopping there
favours no answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..statistics.plan import Sequential
from .case import Band, Case, Curve, Reading, at_most
from .judge import ALPHA, LEAST_SIGMAS, place, room

Look = Callable[[int], Mapping[str, Reading]]


def until_decided(case: Case, value: float, look: Look, looks: int, least: int = 1) -> dict[str, Reading]:
    """What `look(k)` reads at the first k of `least` … `looks` that decides the case at `value`, else at the last.

    look: adds the k-th batch of samples to those before and reads all of them. At a value of the sweep all bands are decided, at one
    that bisection asks for only on which side of `case.limit` the curve `case.breaks` is.
    """
    if not 1 <= least <= looks:
        raise ValueError(f"expected 1 ≤ least ≤ looks, got {least} and {looks}")
    curves = {curve.name: curve for curve in case.curves}
    judged = [curve for curve in case.curves if curve.good or curve.stated]
    alpha = ALPHA / (len(case.values) * max(len(judged), 1))
    limit = at_most(case.limit)(value)
    readings: dict[str, Reading] = {}
    for k in range(1, looks + 1):
        readings = dict(look(k))
        if value in case.values:
            told = all(_told(curves[name], value, r, k, looks, alpha) for name, r in readings.items())
        else:
            told = case.breaks not in readings or _on_a_side(
                readings[case.breaks], limit, k, looks, ALPHA / len(case.values)
            )
        if told and k >= least:
            break
    return readings


def _told(curve: Curve, value: float, reading: Reading, k: int, looks: int, alpha: float) -> bool:
    """Whether the judge can say where the reading lies: in the good band, else in the stated one."""
    if reading.se == 0.0 or not math.isfinite(reading.value + reading.se):
        return True
    for wanted in (curve.good, curve.stated):
        if wanted is None:
            continue
        band = wanted(value)
        if not settled(reading, band, k, looks, alpha):
            return False
        if place(reading, band, LEAST_SIGMAS) != "out":
            return True
    return True


def settled(reading: Reading, band: Band, k: int, looks: int, alpha: float) -> bool:
    """Whether a reading from look `k` of `looks` is clearly in or out of a band, or its noise is small beside it."""
    return reading.reach(Sequential(0.0, looks, alpha).bounds[-1]) <= room(band) or _on_a_side(
        reading, band, k, looks, alpha
    )


def _on_a_side(reading: Reading, band: Band, k: int, looks: int, alpha: float) -> bool:
    """Whether a reading is clearly in or out of a band."""
    if reading.se == 0.0 or not math.isfinite(reading.value + reading.se):
        return True
    edges = [edge for edge in (band.low, band.high) if math.isfinite(edge)]
    stops = [Sequential(edge, looks, alpha) for edge in edges]
    sides = [
        stop.decide(reading.value, reading.se, k, math.inf if reading.df is None else reading.df) for stop in stops
    ]
    beyond = any(s == ("under" if e == band.low else "over") for s, e in zip(sides, edges, strict=True))
    return beyond or all(sides)


def mean_of(values: Sequence[float], each: Sequence[float] = ()) -> Reading:
    """Mean of independent values. each: their own standard errors, where known: the mean's is then not under what these say, however
    close a few values happen to lie. The degrees of freedom are those of the spread either way: chance may have made it the larger."""
    n = len(values)
    spread = float(np.std(values, ddof=1)) / math.sqrt(n) if n > 1 else 0.0
    own = math.sqrt(float(np.square(each).sum())) / n if len(each) else 0.0
    return Reading(float(np.mean(values)), max(spread, own), n, n - 1)


def share_of(hits: int, count: int) -> Reading:
    """A share with its binomial error; none or all of `count` has the error of one in `count`, not none."""
    share = hits / count
    near = min(max(hits, 1), count - 1) / count if count > 1 else 0.5
    return Reading(share, math.sqrt(near * (1.0 - near) / count), count)
