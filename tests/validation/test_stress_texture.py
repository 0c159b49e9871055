"""Cases E, F and R of `lightgauge stress`: sound code gets the verdict that each case states, broken code fails it."""

from __future__ import annotations

import ctypes
import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from lightgauge.fastpath import layout, sampler, windows
from lightgauge.fastpath.clipmap import Clipmap
from lightgauge.reference.texture_types import VirtualTexture
from lightgauge.reference.variant import ensure_variant
from lightgauge.validation.provenance import provenance, vector_width
from lightgauge.validation.statistics import welch
from lightgauge.validation.stress import (
    rates_measured,
    texture_filter,
    texture_reads,
    texture_streams,
    texture_worlds,
    truth_again,
    truth_bounces,
    truth_checks,
    truth_paths,
)
from lightgauge.validation.stress.case import Case
from lightgauge.validation.stress.cases_rates import CASES as RATES
from lightgauge.validation.stress.cases_rates import R4
from lightgauge.validation.stress.cases_texture import CASES as TEXTURE
from lightgauge.validation.stress.cases_texture import E1, E3, E6, E7, E8
from lightgauge.validation.stress.cases_truth import CASES as TRUTH
from lightgauge.validation.stress.cases_truth import F5
from lightgauge.validation.stress.catalogue import check_case
from lightgauge.validation.stress.judge import Verdict, judge
from lightgauge.validation.stress.rates_fit import exponent


def verdict(case: Case, *values: float) -> Verdict:
    """Judged at some values of the sweep only."""
    return judge(dataclasses.replace(case, values=values), {value: case.measure(value, 1) for value in values})


def test_every_case_is_there_and_can_fail() -> None:
    assert [c.id for c in (*TEXTURE, *TRUTH, *RATES)] == [
        *(f"E{i}" for i in range(1, 9)), "F1", "F3", "F4", "F5", "F6", "R1", "R2", "R3", "R4",
    ]  # fmt: skip
    for case in (*TEXTURE, *TRUTH, *RATES):
        check_case(case)


@pytest.mark.parametrize(("case", "values"), [(E6, (255.0, 256.0)), (E8, (1.0,)), (R4, (0.125,))])
def test_sound_code_passes(case: Case, values: tuple[float, ...]) -> None:
    found = verdict(case, *values)
    assert found.status == "pass", found.why


def test_half_floats_fail_as_stated_beside_a_bright_light() -> None:
    found = verdict(E3, 1e-7, 1.0)
    assert found.status == "fail" and found.as_stated and found.good, found.why


@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_light_stored_without_exposure_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (layout, sampler, texture_reads):
        monkeypatch.setattr(module, "exposure", lambda texture, storage: 1.0)
    found = verdict(E3, 1e-7)
    assert found.status == "fail" and not found.as_stated


def test_a_clipmap_that_forgets_who_leaves_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Clipmap, "leave", lambda self, tiles: None)
    monkeypatch.setattr(texture_streams, "FRAMES", 8)
    found = verdict(E7, 3.0)
    assert found.status == "fail" and not found.as_stated and "wrong reads" in found.why


def test_bits_that_wrap_around_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windows, "MAX_OFFSET", 1024)
    assert verdict(E6, 256.0).status == "fail"


def test_a_sampler_half_a_texel_off_breaks_its_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rates_measured.Sampler.__call__
    rates_measured._interpolated.cache_clear()
    monkeypatch.setattr(
        rates_measured.Sampler, "__call__", lambda self, p, n: whole(self, p + 0.25 * self._lattice.finest, n)
    )
    found = verdict(R4, 0.125)
    rates_measured._interpolated.cache_clear()
    assert found.status == "fail" and "smooth light" in found.why


def test_what_finds_bias_finds_none_where_it_is_told_to_be_blind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth_checks, "RUNS", 12)
    monkeypatch.setattr(truth_checks, "CLEAN_RUNS", 40)
    few = dataclasses.replace(F5, values=(0.003,), curves=tuple(c for c in F5.curves if c.name == "Welch on blocks"))
    reading = {0.003: {"Welch on blocks": F5.measure(0.003, 1)["Welch on blocks"]}}
    assert judge(few, reading).status == "pass"
    monkeypatch.setattr(welch, "holm", lambda p, alpha: np.zeros(len(p), bool))
    reading = {0.003: {"Welch on blocks": F5.measure(0.003, 1)["Welch on blocks"]}}
    truth_checks._false_finds.cache_clear()
    assert judge(few, reading).status == "fail"


def test_bounces_lost_by_a_dense_solve() -> None:
    """Where every row sums to one and all reflect alike, paths of D segments lose ρ^(D - 1) of the indirect light."""
    rng = np.random.default_rng(4)
    rows = rng.random((6, 6))
    rows /= rows.sum(axis=1, keepdims=True)
    albedo = np.tile([0.5, 0.8, 0.3], (6, 1))
    even = truth_bounces.Transport(rows, np.eye(6), albedo, np.ones((6, 3)))
    first = albedo[0] / (1.0 - albedo[0])
    for depth in (1, 2, 5):
        assert even.lost(depth) == pytest.approx(float(first @ albedo[0] ** (depth - 1) / first.sum()), rel=1e-9)


def test_tilts_explain_single_facets() -> None:
    """Facets of an icosphere: what their normals' tilt costs is most of what they are off, with the coefficient of the theory."""
    off, tilt = rates_measured._deviation(2, 3, 0), rates_measured.tilts(2)
    assert float(off @ tilt) / float(tilt @ tilt) == pytest.approx(1.0, abs=0.1)


def test_a_filter_of_fewer_bits_goes_over_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(texture_filter, "COUNT", 4000)
    assert verdict(E1, 0.2).status == "pass"
    whole = texture_filter._fixed_point

    def coarser(texture: VirtualTexture, p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return whole(texture, np.round(p * 128.0) / 128.0, n)

    monkeypatch.setattr(texture_filter, "_fixed_point", coarser)
    found = verdict(E1, 0.2)
    assert found.status == "fail" and "24.8 filter over its bound" in {
        p.curve for p in found.points if p.status == "fail"
    }


def test_tail_index_and_exponent_of_known_laws() -> None:
    rng = np.random.default_rng(3)
    pareto = truth_paths.tail_index(1.0 + rng.pareto(1.5, 100_000), 0.01)
    assert abs(pareto.value - 1.5) < 4 * pareto.se and pareto.n == 1000
    assert truth_paths.tail_index(np.full(1000, 2.0), 0.01).value == truth_paths.MOST_INDEX
    assert truth_paths.early_index(0.98) == pytest.approx(1.65, abs=0.01) and math.isinf(truth_paths.early_index(0.9))
    x = np.array([1.0, 2.0, 4.0])
    fitted = exponent(x, 3.0 * x**2 * np.exp(0.05 * rng.normal(size=(8, 3))))
    assert abs(fitted.value - 2.0) < 5 * fitted.se and 0.0 < fitted.se < 0.05
    assert (fitted.n, fitted.df) == (8, 7)  # slopes, not errors


def test_the_truth_again_really_runs_on_that_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[int] = []

    def counted(*given: object) -> SimpleNamespace:
        import drjit as dr

        ran.append(dr.thread_count())
        return SimpleNamespace(irradiance=np.full((4, 10, 3), 1.0 + 1e-3 * (ran[-1] == 3)))

    ensure_variant()
    monkeypatch.setattr(truth_again, "picture", counted)
    monkeypatch.setattr(truth_again, "sampled_on", lambda threads, seed: (threads, np.zeros((2, 3), np.float32)))
    for kept in (truth_again._traced, truth_again._sampled_on_one):
        kept.cache_clear()
    found = truth_again.again(3.0, 91)
    for kept in (truth_again._traced, truth_again._sampled_on_one):
        kept.cache_clear()
    assert ran == [1, 3, 3] and found["truth, values that differ"].value == 120.0


def test_the_kernel_again_runs_on_that_many_threads() -> None:
    """Each in a process of its own; a device that does not do as it is told reads nothing."""
    units, four = truth_again.sampled_on(4, 1)
    assert units == 4 and four.shape == (truth_again.SAMPLES, 3)
    one = np.zeros((2, 3), np.float32)
    off = truth_again.sampled_again((1, one), (2, one + 1.0), 2)
    assert off["sampler, values that differ"].value == 6.0
    assert truth_again.sampled_again((8, one), (8, one), 2) == {}


def test_the_vector_width_of_kernels_is_recorded() -> None:
    ensure_variant()
    import drjit as dr

    core = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    assert vector_width() == core._Z21jit_llvm_vector_widthv() > 1
    assert provenance(texture_worlds.device(), {}, 0, "x")["vector_width"] == vector_width()
