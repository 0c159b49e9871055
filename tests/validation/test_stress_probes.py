"""Cases C1 … D7: some give the status that they should, and with a fault in the product they fail.

Rationale: failure-catalogue C and D. All points of all cases are `lightgauge stress C D`; here the cheapest that can tell.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath.device import OpenDevice
from lightgauge.fastpath.sampler import Sampler
from lightgauge.reference import tiling
from lightgauge.reference.errors import EnvironmentLacks
from lightgauge.reference.lattice import OCTANTS
from lightgauge.reference.placement import culling, dead_edges, distance
from lightgauge.reference.texture_types import VirtualTexture
from lightgauge.reference.volume import sampler, tiles
from lightgauge.validation.benchmarks import leak_scene
from lightgauge.validation.stress import kernel_reads, measure_chains
from lightgauge.validation.stress.case import Case
from lightgauge.validation.stress.cases_octree import D2, D4, D5, D6, D7
from lightgauge.validation.stress.cases_probes import C1, C5, C7
from lightgauge.validation.stress.judge import Verdict, judge

Fault = Callable[[pytest.MonkeyPatch], None]


def judged(case: Case, *values: float) -> Verdict:
    """The case at some of its values."""
    some = dataclasses.replace(case, values=values)
    return judge(some, {v: some.measure(v, 5) for v in values})


@pytest.mark.parametrize(
    ("case", "values"),
    [(D2, (4.0,)), (D5, (0.8, 1.0)), (D7, (3.0,)), (C5, (64.0,))],
    ids=lambda c: getattr(c, "id", ""),
)
def test_sound_code_passes(case: Case, values: tuple[float, ...]) -> None:
    found = judged(case, *values)
    assert found.status == "pass", found.why


@pytest.mark.parametrize(("case", "values"), [(C1, (20.0, 100.0)), (C7, (0.9,))], ids=lambda c: getattr(c, "id", ""))
def test_what_the_method_cannot_do_fails_as_stated(case: Case, values: tuple[float, ...]) -> None:
    found = judged(case, *values)
    assert found.status == "fail" and found.as_stated, found.why


def _one_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles only where voxels are, and beyond faces."""
    monkeypatch.setattr(tiling, "OCTANTS", OCTANTS[OCTANTS.sum(axis=1) <= 1])


def _light_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light not multiplied by the weight as it is rounded."""
    monkeypatch.setattr(tiles, "weight_ratio", lambda stored, exact: np.ones_like(exact))


def _never_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """0/0 where all eight probes are invalid."""
    monkeypatch.setattr(sampler, "MIN_WEIGHT", np.float32(-1.0))


def _old_parents(monkeypatch: pytest.MonkeyPatch) -> None:
    """Culling judged against parents that are gone."""
    monkeypatch.setattr(measure_chains, "replaced", lambda c, wanted, threshold=np.inf: culling.replaced(c, wanted))


def _four_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Directions that turn by three eighths instead of by the golden angle."""
    monkeypatch.setattr(distance, "GOLDEN_TURN", 0x60000000)


def _no_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any probe beside may lend its light."""
    monkeypatch.setattr(dead_edges, "allowed", lambda g, tree, valid, pairs: np.ones(len(pairs), np.bool_))


def _all_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Probes in walls count."""
    monkeypatch.setattr(leak_scene, "inside_share", lambda g, positions, normals: np.zeros(len(positions)))


FAULTS: list[tuple[Case, float, str, Fault]] = [
    (D2, 4.0, "sup", _one_side),
    (D4, 3.0, "seam_half8", _light_as_it_was),
    (D5, 0.8, "nan", _never_up),
    (D6, 0.2, "crack_ours", _no_bars),
    (D7, 3.0, "ours", _old_parents),
    (C5, 64.0, "spread", _four_arms),
    (C7, 1.5, "straight", _all_valid),
]


@pytest.mark.parametrize(("case", "value", "curve", "fault"), FAULTS, ids=lambda x: getattr(x, "id", ""))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_fault_in_the_product_fails(
    case: Case, value: float, curve: str, fault: Fault, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault(monkeypatch)
    found = judged(case, value)
    assert found.status == "fail" and not found.as_stated
    assert curve in {p.curve for p in found.points if p.status == "fail"}, found.why


def test_a_kernel_that_reads_another_texture_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """One per cent less of one coefficient, for the kernel alone."""

    def darker(found: OpenDevice, texture: VirtualTexture, *more: Any) -> Sampler:
        less = texture.texels.copy()
        less[..., 0] *= np.float32(0.99)
        return Sampler(found, dataclasses.replace(texture, texels=less), *more)

    monkeypatch.setattr(kernel_reads, "Sampler", darker)
    found = judged(D2, 3.0)
    assert {p.curve for p in found.points if p.status == "fail"} == {"kernel"}


def test_without_a_device_the_plain_sampler_is_judged_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise EnvironmentLacks("no OpenCL device")

    monkeypatch.setattr(kernel_reads, "device", none)
    kernel_reads._device.cache_clear()
    found = judged(D2, 3.0)
    kernel_reads._device.cache_clear()
    assert found.status == "pass" and "kernel was not read, for want of an OpenCL device" in found.why
