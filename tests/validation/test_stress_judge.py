"""Stress readings with few repetitions, holes in curves, and points of failure that noise or NaN hide."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from lightgauge.validation.statistics.plan import UNDECIDABLE, samples_by_student, samples_needed, student_bound
from lightgauge.validation.stress import catalogue, record, worker
from lightgauge.validation.stress.bisect import breaking
from lightgauge.validation.stress.case import Band, Case, Curve, Reading, at_most
from lightgauge.validation.stress.judge import judge, place
from lightgauge.validation.stress.until_decided import mean_of, settled

NAN = Reading(math.nan)


def case(*curves: Curve, values: tuple[float, ...] = (1.0, 2.0, 3.0), limit: float = 1.0) -> Case:
    """A case that is never run."""
    return Case("A1", "t", "s", "p", "", values, "m", curves, lambda value, seed: {}, breaks="x", limit=limit)


CURVE = Curve("x", at_most(1.0), "why")


def test_few_repetitions_are_not_out_more_often_than_many() -> None:
    """On the edge of a band three standard errors leave 0.135 %: of 8,000 means of four 11 are out; by the normal law 230 were."""
    rng = np.random.default_rng(7)
    found = Counter(place(mean_of(four), Band(high=0.0), 3.0) for four in rng.normal(size=(8000, 4)).tolist())
    assert 2 <= found["out"] <= 25


def test_bounds_by_student() -> None:
    assert student_bound(3.0, None) == student_bound(3.0, math.inf) == 3.0
    assert student_bound(1.959964, 3) == pytest.approx(3.182446, abs=1e-5)  # tables: t of 0.975 at 3
    assert student_bound(3.0, 0) == math.inf
    assert (
        Reading(1.0, 0.1, 4, 3).reach(1.959964) == pytest.approx(0.3182446)
        and Reading(1.0, 0.0, 1, 0).reach(3.0) == 0.0
    )


def test_samples_that_student_asks_for() -> None:
    """With so many the bound is met, and hardly missed with one fewer; a known error asks for what it did."""
    n = samples_by_student(0.5, 4, 3, 0.6, 3.8)
    assert (
        student_bound(3.8, n - 1) * 0.5 * math.sqrt(4 / n)
        <= 0.6
        < student_bound(3.8, n - 2) * 0.5 * math.sqrt(4 / (n - 1))
    )
    assert samples_by_student(0.5, 4, None, 0.6, 3.8) == samples_needed(0.5, 4, 0.6 / 3.8) < n
    assert samples_by_student(1.0, 4, 3, 1e-12, 3.8) == UNDECIDABLE


def test_a_look_is_not_settled_by_a_spread_of_two_values() -> None:
    wide = Band(-1.0, 1.0)
    assert settled(Reading(0.0, 0.1, 100), wide, 1, 6, 1e-4) and not settled(Reading(0.0, 0.1, 2, 1), wide, 1, 6, 1e-4)


def test_degrees_of_freedom_reach_the_record() -> None:
    sent = worker.reading_json(Reading(0.5, 0.1, 4, 3))
    outcome = {"readings": [{"value": 1.0, "readings": {"x": sent, "y": worker.reading_json(Reading(0.5, 0.1, 4))}}]}
    read = record.readings_of(outcome)[1.0]
    assert read["x"] == Reading(0.5, 0.1, 4, 3) and read["y"].df is None
    found = judge(case(CURVE, values=(1.0,)), {1.0: {"x": read["x"]}})
    assert record._point(found.points[0])["df"] == 3


HALF_READ = {1.0: {"x": Reading(0.5)}, 2.0: {}, 3.0: {"x": Reading(0.5)}}


def test_a_curve_with_a_hole_fails_and_names_it() -> None:
    found = judge(case(CURVE), HALF_READ)
    assert found.status == "fail" and "not read: x at p 2" in found.why
    assert judge(case(CURVE), {1.0: {"x": Reading(0.5)}}).status == "fail"
    assert "never read: x" in judge(case(CURVE, Curve("y", None, "")), {v: {"y": NAN} for v in (1.0, 2.0, 3.0)}).why


def test_a_curve_may_be_absent_where_it_says_that_it_means_nothing() -> None:
    odd = Curve("x", at_most(1.0), "why", where=lambda value: value != 2.0)
    assert judge(case(odd), HALF_READ).status == "pass"
    with pytest.raises(ValueError, match="means nothing"):
        catalogue.check_case(case(Curve("x", at_most(1.0), "why", where=lambda value: value > 9.0)))


def test_what_a_machine_lacks_it_lacks_everywhere() -> None:
    other = Curve("y", at_most(1.0), "why", needs="a device")
    both = {v: {"x": Reading(0.5)} for v in (1.0, 2.0, 3.0)}
    assert "for want of a device" in judge(case(CURVE, other), both).why
    some = {**both, 1.0: {"x": Reading(0.5), "y": Reading(0.5)}}
    found = judge(case(CURVE, other), some)
    assert found.status == "fail" and "not read: y at p 2, 3" in found.why


def test_noise_makes_no_point_of_failure() -> None:
    """The reviewer's: four readings about the limit, each ten times as noisy as it is off."""
    swept = case(CURVE, values=(1.0, 2.0, 3.0, 4.0))
    noisy = {v: Reading(r, 0.5, 8) for v, r in zip(swept.values, (0.95, 1.05, 0.90, 0.97), strict=True)}
    found = breaking(swept, noisy, lambda value: pytest.fail("nothing to halve"))
    assert found.at is None and found.said.startswith("below the noise: x at p 1 reads 0.95 ± 0.5 (n = 8)")


def test_a_bracket_needs_ends_off_the_limit_by_more_than_few_repetitions_tell() -> None:
    ends = {1.0: Reading(0.0), 2.0: Reading(0.5), 3.0: Reading(1.5, 0.1, 4, 3)}
    assert breaking(case(CURVE), ends, lambda value: None).at is None  # five standard errors, of four values
    found = breaking(case(CURVE), {**ends, 3.0: Reading(1.5, 0.1, 4)}, lambda value: None)
    assert (found.low, found.high) == (2.0, 3.0)


def test_a_noisy_reading_between_clear_ones_widens_the_bracket() -> None:
    known = {1.0: Reading(0.5), 2.0: Reading(1.05, 0.5, 8), 3.0: Reading(2.0)}
    found = breaking(case(CURVE), known, lambda value: pytest.fail("read in the sweep"))
    assert (found.low, found.high) == (1.0, 3.0) and "at 2 noise hides the limit" in found.said


def test_a_reading_that_is_no_number_breaks() -> None:
    found = breaking(
        case(CURVE), {1.0: Reading(0.5), 2.0: NAN, 3.0: Reading(2.0)}, lambda v: Reading(0.5) if v < 1.3 else NAN
    )
    assert found.low is not None and found.high is not None and 1.2 < found.low < 1.3 < found.high <= 1.4
    assert "is no number any more" in found.said and "crosses 2 times" in found.said
    known = {1.0: Reading(0.5), 2.0: Reading(2.0)}
    between = breaking(case(CURVE), known, lambda v: Reading(0.5) if v < 1.4 else NAN)
    assert "is no number any more" in between.said and between.high is not None and between.high < 1.5
    assert (
        "is no number (NaN or infinite) at any of p 1 to 2"
        in breaking(case(CURVE), dict.fromkeys(known, NAN), lambda v: None).said
    )
