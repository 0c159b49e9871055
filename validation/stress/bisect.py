"""The point of failure: where a curve crosses its limit, bracketed by the sweep and then halved.

A reading is on a side of the limit when it is off it by more than its noise: by the standard errors that the judge allows a case of
so many values (judge.py, Student's where repetitions are few). A reading that is no number is a side of its own, so a curve also
breaks where it stops being one. The first two readings that are on different sides, with none between them that is on any, are halved
(in the logarithm where the axis is logarithmic) until they span 5 % of the whole axis, or until noise hides the side of a reading.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from .case import Case, Reading
from .judge import said, sigmas

SHARE = 0.05
Look = Callable[[float], Reading | None]
Side = Literal["under", "over", "no number"]


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
    sides = {value: side_of(case, reading) for value, reading in sorted(known.items())}
    clear = {value: side for value, side in sides.items() if side is not None}
    brackets = [(a, b) for a, b in pairwise(clear) if clear[a] != clear[b]]
    if not brackets:
        hidden = [value for value in sides if value not in clear]
        return Breaking(None, None, _hidden(case, known, hidden) if hidden else _never(case, clear), {})
    low, high = brackets[0]
    before, after = clear[low], clear[high]
    looks: dict[float, Reading] = {}
    stopped = ""
    while span(case, low, high) > SHARE * span(case, case.values[0], case.values[-1]):
        middle = halfway(case, low, high)
        if middle in (low, high):
            stopped = ", which are neighbours"
            break
        reading = known.get(middle) or look(middle)
        if reading is None:
            stopped = f"; between them, at {middle:.4g}, there is no reading"
            break
        if middle not in known:
            looks[middle] = reading
        side = side_of(case, reading)
        if side is None:
            stopped = f"; at {middle:.4g} noise hides the limit (± {reading.se:.2g}, n = {reading.n:,})"
            break
        low, high, after = (middle, high, after) if side == before else (low, middle, side)
    more = f"; it crosses {len(brackets)} times, this is the first" if len(brackets) > 1 else ""
    said = f"{case.breaks} {_way(case, before, after)} between {low:.4g} and {high:.4g}{_unit(case)}{stopped}{more}"
    return Breaking(low, high, said, looks)


def side_of(case: Case, reading: Reading) -> Side | None:
    """The side of the limit that a reading is on; None where noise hides it. An exact one on the limit is not over it."""
    if not (math.isfinite(reading.value) and math.isfinite(reading.se)):
        return "no number"
    off, noise = reading.value - case.limit, reading.reach(sigmas(len(case.values)))
    if off > noise:
        return "over"
    return "under" if -off > noise or not reading.se else None


def _way(case: Case, before: Side, after: Side) -> str:
    """How the curve gets from one side to another."""
    if after == "no number":
        return "is no number any more (NaN or infinite) from"
    if before == "no number":
        return "is no number (NaN or infinite) up to"
    return f"{'rises over' if after == 'over' else 'falls under'} {case.limit:.4g}"


def _never(case: Case, sides: Mapping[float, Side]) -> str:
    if not sides:
        return f"no bracket: {case.breaks} was not read"
    reach = f"{case.parameter} {min(sides):.4g} to {max(sides):.4g}{_unit(case)}"
    side = next(iter(sides.values()))
    if side == "no number":
        return f"no bracket: {case.breaks} is no number (NaN or infinite) at any of {reach}"
    where = "over" if side == "over" else "not over"
    return f"no bracket: {case.breaks} never crosses {case.limit:.4g} within {reach}; it is {where} it throughout"


def _hidden(case: Case, known: Mapping[float, Reading], hidden: list[float]) -> str:
    """No two readings are clearly on different sides, and at `hidden` noise may be why."""
    first = hidden[0]
    also = f", nor at {len(hidden) - 1} more" if len(hidden) > 1 else ""
    return (
        f"below the noise: {case.breaks} at {case.parameter} {first:.4g}{_unit(case)} reads {said(known[first])} "
        f"(n = {known[first].n:,}), which noise does not tell from the limit of {case.limit:.4g}{also}"
    )


def _unit(case: Case) -> str:
    return f" {case.unit}" if case.unit else ""


def span(case: Case, low: float, high: float) -> float:
    """Length of an interval on the case's axis."""
    return math.log(high / low) if case.log else high - low


def halfway(case: Case, low: float, high: float) -> float:
    """The middle of an interval on the case's axis, a whole number where only these mean something."""
    middle = math.sqrt(low * high) if case.log else (low + high) / 2.0
    return float(min(max(round(middle), low), high)) if case.whole else middle
