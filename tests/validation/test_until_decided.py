"""Samples until a case is decided: early where it is clear, late where it is not, and never other than the judge would say."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from lightgauge.validation.stress.case import Case, Curve, Reading, at_most, within
from lightgauge.validation.stress.judge import judge
from lightgauge.validation.stress.until_decided import mean_of, share_of, until_decided

LOOKS, EACH = 6, 10


def case(**more: object) -> Case:
    curve = Curve("x", at_most(1.0), "", stated=within(0.0, 10.0))
    made: dict[str, object] = {"breaks": "x", "limit": 5.0, **more}
    return Case("X1", "t", "s", "p", "", (1.0, 2.0), "m", (curve,), lambda v, s: {}, **made)  # type: ignore[arg-type]


def drawn(mean: float, noise: float, seed: int) -> tuple[list[int], Callable[[int], Mapping[str, Reading]]]:
    """A look that adds EACH normal numbers, and the list of the looks taken."""
    rng, values, taken = np.random.default_rng(seed), list[float](), list[int]()

    def look(k: int) -> Mapping[str, Reading]:
        taken.append(k)
        values.extend(rng.normal(mean, noise, EACH))
        return {"x": mean_of(values)}

    return taken, look


@pytest.mark.parametrize(
    ("mean", "noise", "least", "most"),
    [(0.9, 0.3, 1, 1), (8.0, 2.0, 1, 2), (2.5, 3.0, 3, LOOKS), (1.0, 30.0, LOOKS, LOOKS)],
    ids=["noise is small", "clearly over", "hard to tell", "cannot be told"],
)
def test_as_many_looks_as_it_takes(mean: float, noise: float, least: int, most: int) -> None:
    taken, look = drawn(mean, noise, seed=3)
    found = until_decided(case(), 1.0, look, LOOKS)
    assert least <= len(taken) <= most and taken == list(range(1, len(taken) + 1))
    assert found["x"].n == EACH * len(taken)


def test_what_is_decided_here_is_decided_by_the_judge() -> None:
    early = 0
    for seed in range(40):
        taken, look = drawn(3.0, 2.0, seed)
        readings = {value: until_decided(case(), value, look, LOOKS) for value in (1.0, 2.0)}
        early += len(taken) < 2 * LOOKS
        if len(taken) < 2 * LOOKS:
            verdict = judge(case(), readings)
            assert verdict.status == "fail" and verdict.as_stated
    assert early == 40


def test_a_value_on_its_limit_is_hardly_ever_called_out() -> None:
    """Looking six times would, at the judge's bounds each time, be wrong more often than it allows; so many seeds allow three."""
    strict, out = Case("X1", "t", "s", "p", "", (1.0,), "m", (Curve("x", at_most(1.0), ""),), lambda v, s: {}), 0
    for seed in range(500):
        _, look = drawn(1.0, 4.0, seed)
        out += judge(strict, {1.0: until_decided(strict, 1.0, look, LOOKS)}).status == "fail"
    assert out <= 3


def test_between_the_swept_values_only_the_limit_is_asked_for() -> None:
    taken, look = drawn(1.0, 1.0, seed=1)
    until_decided(case(), 1.5, look, LOOKS)
    assert len(taken) <= 2  # on the edge of the band, far from the limit of 5
    taken, look = drawn(5.0, 1.0, seed=1)
    until_decided(case(), 1.5, look, LOOKS)
    assert len(taken) == LOOKS  # on the limit, however small the noise


def test_exact_and_broken_readings_need_no_more() -> None:
    for reading in (Reading(7.0), Reading(math.nan, 1.0)):
        taken: list[int] = []
        until_decided(case(), 1.0, lambda k, r=reading, t=taken: t.append(k) or {"x": r}, LOOKS)  # type: ignore[misc]
        assert taken == [1]
    with pytest.raises(ValueError, match="least"):
        until_decided(case(), 1.0, lambda k: {}, 1, least=2)


def test_means_and_shares() -> None:
    assert mean_of([1.0, 3.0]) == Reading(2.0, 1.0, 2, 1)
    assert mean_of([2.0], [0.3]).reach(3.0) == math.inf  # one value has no spread: its own error is only part of it
    assert mean_of([2.0, 2.0], [0.3, 0.4]).se == pytest.approx(0.25)
    assert share_of(1, 4).se == pytest.approx(math.sqrt(0.1875 / 4))
    assert share_of(0, 4).se == share_of(4, 4).se == pytest.approx(math.sqrt(0.1875 / 4))
