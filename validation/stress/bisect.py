"""The point of failure: where a curve crosses its limit, bracketed by the sweep and then halved.

The sweep's first pair of neighbouring values with the limit between their readings is halved (in the logarithm where the axis is
logarithmic) until it spans 5 % of the whole axis, or until a reading is nearer to the limit than its noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

from .case import Case, Reading

SHARE = 0.05
SIGMAS = 3.0
Look = Callable[[float], Reading | None]


@dataclass(frozen=True)
class Breaking:
    """low, high: values of the parameter between which the curve crosses, None where it never does. said: a sentence.
    looks: further readings that it took, by value."""

    low: float | None
    high: float | None
    said: str
    looks: Mapping[float, Reading]

    @property
    def at(self) -> float | None:
        """The middle of the bracket."""
        return None if self.low is None or self.high is None else (self.low + self.high) / 2.0


def breaking(case: Case, known: Mapping[float, Reading], look: Look) -> Breaking:
    """Where `case.breaks` crosses `case.limit`. known: its readings in the sweep. look: one more reading, None where there is none."""
    finite = {v: r for v, r in sorted(known.items()) if math.isfinite(r.value)}
    over = {v: r.value > case.limit for v, r in finite.items()}
    brackets = [(a, b) for a, b in pairwise(over) if over[a] != over[b]]
    if not brackets:
        return Breaking(None, None, _never(case, over), {})
    low, high = brackets[0]
    looks: dict[float, Reading] = {}
    stopped = ""
    while span(case, low, high) > SHARE * span(case, case.values[0], case.values[-1]):
        middle = halfway(case, low, high)
        if middle in (low, high):
            stopped = ", which are neighbours"
            break
        reading = look(middle)
        if reading is None or not math.isfinite(reading.value):
            stopped = f"; between them, at {middle:.4g}, there is no reading"
            break
        looks[middle] = reading
        if reading.se and abs(reading.value - case.limit) < SIGMAS * reading.se:
            stopped = f"; at {middle:.4g} noise hides the limit (± {reading.se:.2g}, n = {reading.n:,})"
            break
        low, high = (middle, high) if (reading.value > case.limit) == over[brackets[0][0]] else (low, middle)
    more = f"; it crosses {len(brackets)} times, this is the first" if len(brackets) > 1 else ""
    way = "rises over" if not over[brackets[0][0]] else "falls under"
    unit = f" {case.unit}" if case.unit else ""
    said = f"{case.breaks} {way} {case.limit:.4g} between {low:.4g} and {high:.4g}{unit}{stopped}{more}"
    return Breaking(low, high, said, looks)


def _never(case: Case, over: Mapping[float, bool]) -> str:
    unit = f" {case.unit}" if case.unit else ""
    if not over:
        return f"no bracket: {case.breaks} was not read"
    reach = f"within {case.parameter} {min(over):.4g} to {max(over):.4g}{unit}"
    where = "over" if next(iter(over.values())) else "not over"
    return f"no bracket: {case.breaks} never crosses {case.limit:.4g} {reach}; it is {where} it throughout"


def span(case: Case, low: float, high: float) -> float:
    """Length of an interval on the case's axis."""
    return math.log(high / low) if case.log else high - low


def halfway(case: Case, low: float, high: float) -> float:
    """The middle of an interval on the case's axis, a whole number where only these mean something."""
    middle = math.sqrt(low * high) if case.log else (low + high) / 2.0
    return float(min(max(round(middle), low), high)) if case.whole else middle
