"""The record of a stress run, `stress.json`: its shape, and how a judged case becomes part of it.

The models are the one description of the file; `stress.schema.json` is generated from them
(`python -m lightgauge.validation.stress.record`) and a test holds the two together.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from ..record import dumps, write_json_atomic
from ..record_models import Count, JsonObject, NonNegative, Open
from .case import Band, Case, Reading, Status
from .judge import Point, Readings, Verdict, judge
from .runner import Outcome

SCHEMA_VERSION = 1
SCHEMA_FILE = Path(__file__).with_name("stress.schema.json")


class BandRecord(Open):
    """A closed interval; an open side is absent."""

    low: float | None = None
    high: float | None = None


class PointRecord(Open):
    """A reading, judged. parameter: of the sweep or the bisection. value: None where it is not finite. samples: how many would tell.
    df: degrees of freedom of `se`, absent where it is as good as known."""

    parameter: float
    value: float | None
    se: NonNegative | None = None
    df: NonNegative | None = None
    n: Count
    good: BandRecord | None = None
    stated: BandRecord | None = None
    status: Literal["pass", "stated", "below noise", "fail", "shown"]
    samples: Count | None = None


class CurveRecord(Open):
    """A curve: why its band is what it is, and its points in rising order of the parameter."""

    name: str
    reason: str
    judged: bool
    points: list[PointRecord]


class BreakingRecord(Open):
    """The point of failure of a curve. low, high: the bracket, absent where it never crosses; `said` says so."""

    curve: str
    limit: float
    low: float | None = None
    high: float | None = None
    at: float | None = None
    said: str


class Crash(Open):
    """How a worker ended before it was done. parameter: what it was at. stderr: the last it said."""

    parameter: float | None = None
    why: str
    stderr: str = ""


class CaseRecord(Open):
    """One row of the failure catalogue. as_stated: it fails, and only where and how the case says that the method must."""

    id: str
    title: str
    scene: str
    parameter: str
    unit: str
    log: bool
    metric: str
    status: Status
    as_stated: bool
    why: str
    curves: list[CurveRecord] = Field(default_factory=list)
    breaking: BreakingRecord | None = None
    crash: Crash | None = None
    seconds: NonNegative = 0.0
    cpu_s: NonNegative = 0.0
    peak_mib: NonNegative = 0.0
    recalled: bool = False
    notes: list[str] = Field(default_factory=list)


class Cell(Open):
    """A scene's figure for one failure. ratio: value over limit, or limit over value where more is better; over 1 is a failure.
    better: which way is. what: the figure in words."""

    value: float
    se: NonNegative | None = None
    limit: float
    better: Literal["lower", "higher"]
    ratio: NonNegative
    what: str


class SceneRow(Open):
    """A bundled scene in the heat map: what can be read off it, by id. error: why nothing could be."""

    name: str
    cells: dict[str, Cell] = Field(default_factory=dict)
    error: str = ""
    seconds: NonNegative = 0.0


class StressRecord(Open):
    """`stress.json`. summary: cases by status, those that fail as stated under `fails as stated`."""

    schema_: Literal[1] = Field(alias="schema")
    kind: Literal["stress"]
    provenance: JsonObject
    summary: dict[str, Count]
    good: bool
    cases: list[CaseRecord]
    scenes: list[SceneRow] = Field(default_factory=list)


def case_record(case: Case, outcome: Outcome) -> JsonObject:
    """A case with its outcome, judged."""
    readings = readings_of(outcome)
    crash = outcome["crash"]
    verdict = judge(case, readings)
    if crash is not None:
        where = "" if crash["value"] is None else f" (at {case.parameter} {crash['value']:.4g})"
        verdict = Verdict("crashed", False, f"{crash['why']}{where}", verdict.points)
    made: JsonObject = {
        **{name: getattr(case, name) for name in ("id", "title", "scene", "parameter", "unit", "log", "metric")},
        "status": verdict.status,
        "as_stated": verdict.as_stated,
        "why": verdict.why,
        "curves": [_curve(c.name, c.reason, bool(c.good or c.stated), verdict.points) for c in case.curves],
        **{name: outcome[name] for name in ("seconds", "cpu_s", "peak_mib", "recalled")},
        "notes": list(case.notes),
    }
    if outcome["breaking"] is not None:
        found = {k: v for k, v in outcome["breaking"].items() if k != "looks" and v is not None}
        made["breaking"] = {"curve": case.breaks, "limit": case.limit, **found}
    if crash is not None:
        at = {} if crash["value"] is None else {"parameter": crash["value"]}
        made["crash"] = {**at, "why": crash["why"], "stderr": crash["stderr"]}
    return made


def readings_of(outcome: Outcome) -> Readings:
    """The worker's answers as readings; what was not finite is NaN again."""

    def number(sent: float | None) -> float:
        return math.nan if sent is None else sent

    return {
        at["value"]: {name: Reading(number(r["value"]), number(r["se"]), r["n"], r.get("df")) for name, r in at["readings"].items()}
        for at in outcome["readings"]
    }  # fmt: skip


def _curve(name: str, reason: str, judged: bool, points: Sequence[Point]) -> JsonObject:
    return {"name": name, "reason": reason, "judged": judged, "points": [_point(p) for p in points if p.curve == name]}


def _point(p: Point) -> JsonObject:
    finite = math.isfinite(p.reading.value) and math.isfinite(p.reading.se)
    made: JsonObject = {
        "parameter": p.value,
        "value": p.reading.value if finite else None,
        "n": p.reading.n,
        "status": p.status,
    }
    if finite and p.reading.se:
        made["se"] = p.reading.se
        if p.reading.df is not None:
            made["df"] = p.reading.df
    for name, band in (("good", p.good), ("stated", p.stated)):
        if band is not None:
            made[name] = _band(band)
    return made if p.samples is None else {**made, "samples": p.samples}


def _band(band: Band) -> JsonObject:
    return {side: edge for side, edge in (("low", band.low), ("high", band.high)) if math.isfinite(edge)}


def is_good(case: Mapping[str, Any]) -> bool:
    """Whether a case record lets the whole end with exit code 0."""
    return case["status"] in ("pass", "out of scope") or (case["status"] == "fail" and case["as_stated"])


def status_words(case: Mapping[str, Any]) -> str:
    """`fails as stated` apart from `fail`."""
    return "fails as stated" if case["status"] == "fail" and case["as_stated"] else str(case["status"])


def stress_record(provenance: JsonObject, cases: Sequence[JsonObject], scenes: Sequence[JsonObject]) -> JsonObject:
    """The whole record, checked."""
    record: JsonObject = {
        "schema": SCHEMA_VERSION,
        "kind": "stress",
        "provenance": provenance,
        "summary": dict(Counter(status_words(case) for case in cases)),
        "good": all(is_good(case) for case in cases),
        "cases": list(cases),
        "scenes": list(scenes),
    }
    validate_stress(record)
    return record


def validate_stress(record: Any) -> None:
    """ValueError that names the path of the first thing wrong."""
    try:
        StressRecord.model_validate_json(dumps(record))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ValueError(f"{where}: {first['msg']}") from None


def stress_json_schema() -> JsonObject:
    """JSON Schema of `stress.json`."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **StressRecord.model_json_schema(by_alias=True)}


if __name__ == "__main__":
    write_json_atomic(SCHEMA_FILE, stress_json_schema())
