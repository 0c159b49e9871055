"""Pass or fail against absolute limits, judged with each metric's interval.

The rule: a metric passes `max` only when value + 2·se ≤ max, and `min` only when value - 2·se ≥ min. It must be *shown*
to be inside; when the interval straddles the limit the answer is "not shown", a failure that more samples can turn into
a pass. A metric without a standard error (a maximum over all places, say) is judged by its value. A missing scene, a
scene that failed, a missing metric, and a metric below the noise floor of its reference all fail.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, RootModel, ValidationError, model_validator

from ..reference.errors import InputError
from .options import read_toml
from .record import load_results
from .record_models import Metric, Results, SceneResult
from .statistics.plan import UNDECIDABLE, samples_needed, samples_to_decide

SIGMAS = 2.0
MISSING = "metric is missing"
Verdict = Literal["pass", "fail"]


class Limit(BaseModel):
    """One metric's limits, in the metric's unit. only_with: judged only for scenes whose result has this table, which a run makes on
    request; where it is there, the metric must be too."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    min: float | None = None
    max: float | None = None
    allow_below_noise: bool = False
    only_with: Literal["fly", "leaks", "waterfall"] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("neither min nor max is given")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min {self.min} exceeds max {self.max}")
        return self


class Gates(RootModel[dict[str, dict[str, Limit]]]):
    """gates.toml: scene -> metric -> limit."""

    model_config = ConfigDict(frozen=True)


@dataclass(frozen=True)
class Judgement:
    """One limit judged. reason: why it failed, empty on a pass. value, se, n: None where nothing was measured."""

    scene: str
    metric: str
    verdict: Verdict
    reason: str
    limit: str
    value: float | None = None
    se: float | None = None
    n: int | None = None


@dataclass(frozen=True)
class GateReport:
    """All judgements, in the order of the gates file."""

    judgements: tuple[Judgement, ...]

    @property
    def failures(self) -> tuple[Judgement, ...]:
        """Those that failed."""
        return tuple(item for item in self.judgements if item.verdict == "fail")

    @property
    def ok(self) -> bool:
        """True when nothing failed."""
        return not self.failures


def load_gates(path: Path) -> Gates:
    """Read gates.toml. Raises InputError naming the file and the key; a file without limits is an error too."""
    try:
        gates = Gates.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {explain(error)}") from error
    if not any(gates.root.values()):
        raise InputError(f"{path} holds no limits, so it would pass anything")
    return gates


def only(gates: Gates, scenes: Sequence[str]) -> Gates:
    """The limits of these scenes; all of them when none is named. Raises InputError for a scene without limits."""
    for name in scenes:
        if name not in gates.root:
            raise InputError(f"no limits for scene {name!r}; the gates name {', '.join(gates.root)}")
    return Gates({name: limits for name, limits in gates.root.items() if name in scenes}) if scenes else gates


def present(gates: Gates, results: Results) -> tuple[Gates, list[str]]:
    """The limits of the scenes that the run holds, and the names of those it does not hold.

    Raises InputError if it holds none: such a run would pass anything.
    """
    names = {scene.name for scene in results.scenes}
    held = {name: limits for name, limits in gates.root.items() if name in names}
    if not held:
        raise InputError(f"the run holds none of the scenes that have limits: {', '.join(gates.root)}")
    return Gates(held), [name for name in gates.root if name not in names]


def load_run(run: Path) -> Results:
    """Read a run's folder, or its results.json. Raises InputError naming the file."""
    results = Results.model_validate(load_results(run))
    names = [scene.name for scene in results.scenes]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(f"{run}: more than one scene is called {', '.join(map(repr, doubled))}")
    return results


def explain(error: ValidationError) -> str:
    """What pydantic found, as one line: path, reason; at most three."""
    found = error.errors(include_url=False)
    lines = [f"{'.'.join(map(str, item['loc'])) or 'top level'}: {item['msg']}" for item in found[:3]]
    more = f" (and {len(found) - 3} more)" if len(found) > 3 else ""
    return "; ".join(lines) + more


def judge(results: Results, gates: Gates) -> GateReport:
    """Every limit of `gates` against `results`."""
    return GateReport(tuple(_judge_all(results, gates)))


def judge_scene(name: str, metrics: Mapping[str, Any], limits: Mapping[str, Limit]) -> list[Judgement]:
    """Every limit of one scene against its metrics, entries as results.json holds them."""
    found = []
    for metric, limit in limits.items():
        entry = metrics.get(metric)
        if entry is None:
            found.append(Judgement(name, metric, "fail", MISSING, describe(limit)))
        else:
            found.append(_judge_metric(name, metric, Metric.model_validate(entry), limit))
    return found


def _judge_all(results: Results, gates: Gates) -> Iterator[Judgement]:
    scenes = {scene.name: scene for scene in results.scenes}
    for name, limits in gates.root.items():
        scene = scenes.get(name)
        for metric, limit in limits.items():
            reason = _scene_reason(scene)
            record = None if scene is None else scene.metrics.get(metric)
            if not reason and limit.only_with and not getattr(scene, limit.only_with):
                continue
            if reason:
                yield Judgement(name, metric, "fail", reason, describe(limit))
            elif record is None:
                yield Judgement(name, metric, "fail", MISSING, describe(limit))
            else:
                yield _judge_metric(name, metric, record, limit)


def _scene_reason(scene: SceneResult | None) -> str:
    if scene is None:
        return "scene is missing"
    if scene.status == "ok":
        return ""
    return f"scene {scene.status}: {scene.error}" if scene.error else f"scene {scene.status}"


def _judge_metric(scene: str, metric: str, record: Metric, limit: Limit) -> Judgement:
    reasons = [reason for reason in _reasons(record, limit) if reason]
    verdict: Verdict = "fail" if reasons else "pass"
    measured: dict[str, Any] = {"value": record.value, "se": record.se, "n": record.n}
    return Judgement(scene, metric, verdict, "; ".join(reasons), describe(limit), **measured)


def _reasons(record: Metric, limit: Limit) -> Iterator[str]:
    """Why this metric fails this limit; nothing when it passes."""
    if record.below_noise and not limit.allow_below_noise:
        yield "below the noise floor of the reference, so nothing is shown" + _to_see(record, limit)
        return
    reach = [SIGMAS * (record.se or 0.0)] * 2
    if record.interval is not None:  # as far as the interval goes on that side, where it is not symmetric
        reach = [max(record.value - record.interval[0], 0.0), max(record.interval[1] - record.value, 0.0)]
    if limit.max is not None:
        yield _side(record, limit.max - record.value, reach[1], f"over max {limit.max:g}")
    if limit.min is not None:
        yield _side(record, record.value - limit.min, reach[0], f"under min {limit.min:g}")


def _side(record: Metric, room: float, reach: float, outside: str) -> str:
    """Reason to fail for `room` between value and limit (negative: beyond it), or nothing. reach: of the interval to that side."""
    if room < 0.0:
        return outside
    if room < reach:
        interval = f"value ± {SIGMAS:g}·se" if record.interval is None else "its 95 % interval"
        needed = samples_to_decide(0.0, reach / SIGMAS, record.n, room, SIGMAS)
        how = (
            f"about {needed:,} samples instead of {record.n:,} decide it"
            if needed < UNDECIDABLE
            else "it lies on the limit"
        )
        return f"not shown: {interval} straddles the limit; {how}"
    return ""


def _to_see(record: Metric, limit: Limit) -> str:
    """How many samples it takes until an error as large as the limit would stand clear of the noise. What `noise` says of an error
    falls with the fourth root of their number: it is the root of a standard error."""
    effect = limit.max if limit.max is not None else limit.min
    if record.noise is None or not effect or record.noise <= abs(effect):
        return ""
    needed = samples_needed(record.noise**2, record.n, effect**2)
    return f"; it takes about {needed:,} samples instead of {record.n:,} to see an error of {abs(effect):g}"


def describe(limit: Limit) -> str:
    """The limit in words, as in `≤ 0.12`."""
    parts = [f"≥ {limit.min:g}"] if limit.min is not None else []
    parts += [f"≤ {limit.max:g}"] if limit.max is not None else []
    return " and ".join(parts)
