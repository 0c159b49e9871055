"""From readings and bands to a verdict, per point and per case.

A reading v ± s is held against a band. With z at a chance of ALPHA per case, shared out over its judged points (Bonferroni: no more
than one sound case in a thousand fails by noise), from the normal distribution, or Student's where s is estimated from few
repetitions (Reading.df); what bisection reads between the values of the sweep is shown, not judged,

    out        v lies outside the band by more than z·s
    undecided  not out, but z·s is larger than the room that the band gives, and v ± z·s is not within it
    in         else

The room is half the width of a closed band, the distance of the edge from 0 of one that is open on a side; for a reading beyond that
edge only BEYOND of it, as much noise as the edge is large would else excuse anything. An undecided reading says how many samples
it would take: s falls with the root of their number, and Student's quantile with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal

from ..statistics.plan import samples_by_student
from .case import Band, Case, Curve, Reading, Status

ALPHA = 0.001
LEAST_SIGMAS = 3.0
BEYOND = 0.25
Where = Literal["in", "out", "undecided"]
PointStatus = Literal["pass", "stated", "below noise", "fail", "shown"]
Readings = Mapping[float, Mapping[str, Reading]]


@dataclass(frozen=True)
class Point:
    """One reading, judged. status: `stated` fails for the reason that the case states, `shown` has no band to be held against.
    samples: how many it would take to tell, for `below noise` (None: no number would, the reading lies on the edge)."""

    value: float
    curve: str
    reading: Reading
    good: Band | None
    stated: Band | None
    status: PointStatus
    samples: int | None = None


@dataclass(frozen=True)
class Verdict:
    """A case, judged. as_stated: it fails, and only where and how the case says that the method must. why: one sentence."""

    status: Status
    as_stated: bool
    why: str
    points: tuple[Point, ...]

    @property
    def good(self) -> bool:
        """Whether the whole may end with exit code 0."""
        return self.status in ("pass", "out of scope") or (self.status == "fail" and self.as_stated)


def sigmas(points: int) -> float:
    """Known standard errors that a reading may lie outside its band, for a case of so many judged points."""
    return max(LEAST_SIGMAS, NormalDist().inv_cdf(1.0 - ALPHA / (2.0 * max(points, 1))))


def place(reading: Reading, band: Band, z: float) -> Where:
    """Where a reading lies. One that is not finite is out."""
    v, noise = reading.value, reading.reach(z)
    if not (math.isfinite(v) and math.isfinite(reading.se)):
        return "out"
    if v > band.high + noise or v < band.low - noise:
        return "out"
    beyond = math.isinf(band.high - band.low) and not band.low <= v <= band.high
    if band.low + noise <= v <= band.high - noise or noise <= room(band) * (BEYOND if beyond else 1.0):
        return "in"
    return "undecided"


def room(band: Band) -> float:
    """How far readings may stray in this band: see the head of this file."""
    if math.isfinite(band.low) and math.isfinite(band.high):
        return (band.high - band.low) / 2.0
    edges = [abs(edge) for edge in (band.low, band.high) if math.isfinite(edge)]
    return edges[0] if edges else math.inf


def samples_wanted(reading: Reading, band: Band, z: float) -> int | None:
    """Samples with which an undecided reading could be told from the band's edge; None where it lies on an edge without room."""
    gap = min(abs(reading.value - edge) for edge in (band.low, band.high) if math.isfinite(edge))
    beyond = not band.low <= reading.value <= band.high
    goal = max(room(band) * (BEYOND if beyond else 1.0), gap)
    return samples_by_student(reading.se, reading.n, reading.df, goal, z) if goal > 0.0 else None


def _bounded(band: Band | None) -> Band | None:
    """None for a band that holds everything: where a case says nothing of a value, its reading is shown, not passed."""
    return None if band is None or (math.isinf(band.low) and math.isinf(band.high)) else band


def judge_point(value: float, curve: Curve, reading: Reading, z: float) -> Point:
    """One reading of a curve at one value of the parameter."""
    good = _bounded(curve.good(value) if curve.good else None)
    stated = _bounded(curve.stated(value) if curve.stated else None)
    status: PointStatus = "shown"
    samples = None
    at = place(reading, good, z) if good else None
    if good and at == "in":
        status = "pass"
    elif (
        at == "undecided" and good and not (stated and place(reading, stated, z) == "in")
    ):  # either way it is as the case says
        status, samples = "below noise", samples_wanted(reading, good, z)
    elif stated:
        status, samples = _stated(reading, stated, z, shown_only=good is None)
    elif good:
        status = "fail"
    return Point(value, curve.name, reading, good, stated, status, samples)


def _stated(reading: Reading, band: Band, z: float, shown_only: bool) -> tuple[PointStatus, int | None]:
    """shown_only: the curve shows the failure without its fix, and showing it is what is wanted."""
    at = place(reading, band, z)
    if at == "out":
        return "fail", None
    if at == "undecided":
        return "below noise", samples_wanted(reading, band, z)
    return ("pass" if shown_only else "stated"), None


def judge(case: Case, readings: Readings) -> Verdict:
    """All readings of a case, by value and curve. A curve with a band that was not read everywhere where it means something fails the
    case, but for one that `needs` what this machine lacks, and so was read nowhere."""
    if case.out_of_scope:
        return Verdict("out of scope", False, case.out_of_scope, ())
    by_name = {curve.name: curve for curve in case.curves}
    swept = {value: at for value, at in readings.items() if value in case.values}
    judged = sum(1 for at in swept.values() for name in at if by_name[name].good or by_name[name].stated)
    z = sigmas(judged)
    points = tuple(
        judge_point(value, by_name[name], reading, z)
        if value in swept
        else Point(value, name, reading, None, None, "shown")
        for value, at in sorted(readings.items())
        for name, reading in at.items()
    )
    holes = {c: missing for c in case.curves if (missing := _unread(case, c, readings))}
    lacking = [c for c in holes if c.needs and not any(c.name in at for at in swept.values())]
    lost = [_hole(case, c, missing) for c, missing in holes.items() if c not in lacking]
    if lost:
        return Verdict("fail", False, "; ".join(lost), points)
    verdict = _verdict(case, points)
    left_out = "".join(f"; {c.name} was not read, for want of {c.needs}" for c in lacking)
    return replace(verdict, why=verdict.why + left_out)


def _unread(case: Case, curve: Curve, readings: Readings) -> list[float]:
    """Values of the sweep at which a curve with a band means something and has no reading."""
    if not (curve.good or curve.stated):
        return []
    return [v for v in case.values if curve.where(v) and curve.name not in readings.get(v, {})]


def _hole(case: Case, curve: Curve, missing: list[float]) -> str:
    """A sentence on a curve that was not read at the values `missing`."""
    if len(missing) == sum(map(curve.where, case.values)):
        return f"never read: {curve.name}"
    at = ", ".join(f"{v:.4g}" for v in missing)
    return f"not read: {curve.name} at {case.parameter} {at}{' ' + case.unit if case.unit else ''}"


def _verdict(case: Case, points: tuple[Point, ...]) -> Verdict:
    """The worst point decides: fail, then below noise, then what fails as stated."""
    for status, of_case in (("fail", "fail"), ("below noise", "below noise"), ("stated", "fail")):
        those = [p for p in points if p.status == status]
        if those:
            found: Status = "fail" if of_case == "fail" else "below noise"
            return Verdict(found, status == "stated", _why(case, status, those), points)
    held = [p for p in points if p.status == "pass"]
    return Verdict("pass", False, f"{len(held)} readings within their bands", points)


def _why(case: Case, status: str, those: list[Point]) -> str:
    """A sentence on the first of the points that decided."""
    p = those[0]
    curve = next(c for c in case.curves if c.name == p.curve)
    more = f", and {len(those) - 1} more" if len(those) > 1 else ""
    where = f"{p.curve} at {case.parameter} {p.value:.4g}{' ' + case.unit if case.unit else ''}"
    what = f"{where} reads {said(p.reading)}"
    if status == "stated":
        return f"{what}, good is {bounds(p.good)}{more}: {curve.reason}"
    wanted = bounds(p.good) if p.good else f"the failure, {bounds(p.stated)}"
    if status == "below noise":
        most = max((q.samples or 0 for q in those), default=0)
        need = f"{most:,} samples would tell" if all(q.samples for q in those) else "no number of samples would tell"
        return f"{what}, which noise does not tell from {wanted}{more}; {need} (now {p.reading.n:,})"
    beyond = f", nor is it {bounds(p.stated)} as stated" if p.good and p.stated else ""
    return f"{what}, wanted {wanted}{beyond}{more}"


def said(reading: Reading) -> str:
    """A reading in words."""
    return f"{reading.value:.4g} ± {reading.se:.2g}" if reading.se else f"{reading.value:.4g}"


def bounds(band: Band | None) -> str:
    """A band in words."""
    if band is None or (band.low == -math.inf and band.high == math.inf):
        return "anything"
    if band.low == band.high:
        return f"{band.low:.4g}"
    if band.low == -math.inf:
        return f"at most {band.high:.4g}"
    if band.high == math.inf:
        return f"at least {band.low:.4g}"
    return f"{band.low:.4g} to {band.high:.4g}"
