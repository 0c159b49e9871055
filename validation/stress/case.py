"""What a case of the failure catalogue is: a swept parameter, curves, and what each curve should read.

A curve has two bands at every value of the parameter. `good` is the catalogue's good value. Where the *method* cannot be good there,
`stated` is what the catalogue says is read instead, and why; a reading outside `good` and inside `stated` fails for the stated reason.
Curves without `good` show what the failure looks like without its fix; with `stated` they must show it, else the provocation is a dud.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..statistics.plan import student_bound

Status = Literal["pass", "below noise", "fail", "crashed", "out of scope"]


@dataclass(frozen=True)
class Reading:
    """One measured number with its standard error (0: exact) and the count behind it. df: degrees of freedom of a
    standard error that is estimated from few repetitions; None for one that is known, or from so many that it makes no difference."""

    value: float
    se: float = 0.0
    n: int = 1
    df: float | None = None

    def reach(self, sigmas: float) -> float:
        """As many standard errors as leave the chance that `sigmas` of a known one would (Student's quantile)."""
        return student_bound(sigmas, self.df) * self.se if self.se > 0.0 else self.se


@dataclass(frozen=True)
class Band:
    """Closed interval; an open side is infinite."""

    low: float = -math.inf
    high: float = math.inf


Wanted = Callable[[float], Band]
Measure = Callable[[float, int], Mapping[str, Reading]]


def everywhere(_: float) -> bool:
    """For a curve that means something at every value."""
    return True


def at_most(high: float) -> Wanted:
    """The same upper limit at every value."""
    return lambda _: Band(high=high)


def at_least(low: float) -> Wanted:
    """The same lower limit at every value."""
    return lambda _: Band(low=low)


def within(low: float, high: float) -> Wanted:
    """The same interval at every value."""
    return lambda _: Band(low, high)


@dataclass(frozen=True)
class Curve:
    """One line of a case. name: as in what `measure` returns. good, stated: see the head of this file. reason: why the good value
    is that, or why it cannot be reached; one sentence with its source. needs: what not every machine has; without it the curve may be
    absent everywhere, and the verdict says so. where: values of the sweep at which it means something; there it must be read."""

    name: str
    good: Wanted | None
    reason: str
    stated: Wanted | None = None
    needs: str = ""
    where: Callable[[float], bool] = everywhere


@dataclass(frozen=True)
class Case:
    """One row of the catalogue.

    id: as there (A1 … G10), or "R1" … for rates. title: the failure, in a few words. scene: what provokes it. parameter, unit: what
    is swept over `values`, in rising order; `log`: its axis. metric: what the curves are, with unit. measure(value, seed): readings
    by curve name. breaks: curve whose crossing of `limit` is bisected
    between the two neighbouring values that lie on both sides, None where there is no such point. out_of_scope: why the case is not
    run at all, else "". minutes: time limit. whole: only whole values of the parameter mean something.
    """

    id: str
    title: str
    scene: str
    parameter: str
    unit: str
    values: tuple[float, ...]
    metric: str
    curves: tuple[Curve, ...]
    measure: Measure
    log: bool = False
    breaks: str | None = None
    limit: float = 0.0
    out_of_scope: str = ""
    minutes: float = 3.0
    notes: tuple[str, ...] = field(default_factory=tuple)
    whole: bool = False
