"""Cases A and B of the failure catalogue: sound code is judged as it should be, and each provocation catches a fault."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.transport import accumulate, receivers, reconcile, solvers
from lightgauge.validation.stress import (
    cases_form_factors,
    cases_radiosity,
    measure_meshes,
    measure_radiosity,
)
from lightgauge.validation.stress.case import Case
from lightgauge.validation.stress.judge import Verdict, judge

ALL = {case.id: case for case in cases_form_factors.CASES + cases_radiosity.CASES}


def verdict(name: str, *values: float, seed: int = 1) -> Verdict:
    case: Case = replace(ALL[name], values=values)
    return judge(case, {value: case.measure(value, seed) for value in values})


def failing(name: str, *values: float) -> set[str]:
    return {p.curve for p in verdict(name, *values).points if p.status == "fail"}


def test_every_row_of_both_sections_has_a_case() -> None:
    assert list(ALL) == [*(f"A{k}" for k in range(1, 12)), *(f"B{k}" for k in range(1, 9))]
    for case in ALL.values():
        assert list(case.values) == sorted(set(case.values)) and 3 <= len(case.values) <= 8
        assert all(curve.reason for curve in case.curves)
        assert case.breaks is None or case.breaks in {curve.name for curve in case.curves}


@pytest.mark.parametrize(
    ("name", "value"),
    [("A4", 100.0), ("A7", 256.0), ("A11", 1e-4), ("B1", 0.1), ("B2", 1.0), ("B3", 64.0), ("B7", 0.9)],
)
def test_sound_code_passes(name: str, value: float) -> None:
    found = verdict(name, value)
    assert {p.status for p in found.points} <= {"pass", "shown"}, found.why


def test_gaps_fail_where_they_are_said_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under the lift; with rays lifted a hundred times as far, where they must not."""
    found = verdict("A2", 1e-7, 1e-4)
    assert found.status == "fail" and found.as_stated
    monkeypatch.setattr(receivers, "LIFT", 200 * receivers.LIFT)
    assert "ours" in failing("A2", 1e-4)


def test_rays_of_all_receivers_alike_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    real = accumulate.receiver_seeds
    monkeypatch.setattr(accumulate, "receiver_seeds", lambda receiver, *more: real(receiver * 0, *more))
    assert "ours" in failing("A7", 256.0)


def test_reciprocity_turned_round_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    from lightgauge.validation.stress import measure_factors

    real = measure_factors.reconcile
    monkeypatch.setattr(measure_factors, "reconcile", lambda raw, area: real(raw, area[::-1].copy()))
    assert "reconciled" in failing("A4", 100.0)


def test_rows_left_open_make_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconcile, "closed", lambda flows, area: flows)
    assert failing("B3", 64.0) == {"reconciled (ours)"}


def test_a_bounce_too_weak_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """One per cent of every bounce lost: the furnace, the ball and the lag all show it."""
    real: Any = solvers.System.reflected
    monkeypatch.setattr(solvers.System, "reflected", lambda system, light: np.asarray(0.99 * real(system, light)))
    assert "error left, of the tolerance" in failing("B1", 0.01)
    assert "solvers" in failing("B2", 1.0)
    assert "on" in failing("B7", 0.9)
    measure_radiosity._facet_error.cache_clear()  # what the faulty product left


def test_a_loader_that_does_not_turn_faces_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def as_read(mesh: Any, where: str, has_front: bool) -> Any:
        return type("Kept", (), {"mesh": mesh, "closed": False, "notes": ()})()

    monkeypatch.setattr(measure_meshes, "repair", as_read)
    assert {"flipped", "kinds not said"} <= failing("A10", 4.0)


def test_a_solver_that_stops_early_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told that a tenth is left of what is: against closed forms and against a dense solve."""
    real: Any = solvers.Unshot.__call__
    monkeypatch.setattr(solvers.Unshot, "__call__", lambda unshot, r: 0.1 * real(unshot, r))
    assert {"error left, of the tolerance", "off a dense solve, of the tolerance"} <= failing("B1", 0.1)
    assert "off a dense solve, of the tolerance" in failing("B3", 64.0)
