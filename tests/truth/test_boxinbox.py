"""The cube in a cube of 204 patches: exact occluded form factors and radiosity, against rays alone and the hybrid.

Indirect radiosity is B - E, from a dense solution with the form factors under test, so that no solver's error is in it. Its
error is relative to its mean over patches: as root mean square over patches, and of the worst patch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.progress import silent
from lightgauge.reference.transport.form_factors import FormFactors, patch_form_factors
from lightgauge.reference.transport.hybrid import hybrid_form_factors
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.reconcile import reconcile
from lightgauge.reference.visibility import Geometry
from small_scenes import one_patch_each

Array = npt.NDArray[Any]
RHO = (0.5, 0.9, 0.99)
BUDGET = 4096  # rays per patch, of all kinds


@dataclass(frozen=True)
class Truth:
    """Form factors, emission, radiosity by albedo, and the scene with the number of the patch that each quad became."""

    f: Array
    e: Array
    b: dict[float, Array]
    g: Geometry
    p: Patches
    number: Array


@pytest.fixture(scope="module")
def truth(shared_truth: Path) -> Truth:
    data = np.load(shared_truth / "boxinbox_204_truth.npz")
    g, p, number = one_patch_each(data["quads"])
    np.testing.assert_allclose(p.area[number], data["areas"], rtol=1e-12)
    return Truth(data["F"], data["E"], {rho: data[f"B_rho{rho}"] for rho in RHO}, g, p, number)


def dense(t: Truth, rows: FormFactors) -> Array:
    return np.asarray(rows.matrix().toarray()[np.ix_(t.number, t.number)], dtype=np.float64)


def rms(a: Array) -> float:
    return math.sqrt(float((a**2).mean()))


def indirect_error(t: Truth, rows: FormFactors, rho: float) -> tuple[float, float]:
    """Root mean square over patches and largest error of the indirect radiosity, relative to its mean."""
    b = np.linalg.solve(np.eye(len(t.e)) - rho * dense(t, rows), t.e)
    exact = t.b[rho] - t.e
    error = (b - t.e - exact) / exact.mean()
    return rms(error), float(np.abs(error).max())


def test_the_truth_is_consistent(truth: Truth) -> None:
    np.testing.assert_allclose(truth.f.sum(axis=1), 1.0, atol=2e-7)
    flow = truth.p.area[truth.number][:, None] * truth.f
    np.testing.assert_allclose(flow, flow.T, atol=1e-12)
    for rho, b in truth.b.items():
        np.testing.assert_allclose(np.linalg.solve(np.eye(len(b)) - rho * truth.f, truth.e), b, rtol=1e-6)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_hybrid_within_the_budget(truth: Truth, seed: int) -> None:
    """64 rays from each patch and shadow rays for a noise of 5.2e-4: about 3,900 rays per patch in all. RMS error of the indirect
    light under 1e-3 at every albedo: seen over six seeds 2.3e-4 … 3.3e-4, 5e-5 … 7e-5, 5e-6 … 7e-6. The worst patch, in a corner
    of a shadow, is at the limit at ρ = 0.5: 1.0e-3 … 1.5e-3 there, 2e-4 … 3e-4 and 2e-5 … 3e-5 at the others."""
    raw = patch_form_factors(truth.g, truth.p, 64, seed, silent)
    found = hybrid_form_factors(truth.g, truth.p, raw, 5.2e-4, seed, silent)
    assert found.rays / truth.p.count + 64 <= BUDGET
    assert found.laws.reciprocity <= 1e-6 and found.laws.closure <= 1e-6
    errors = {rho: indirect_error(truth, found.laws.rows, rho) for rho in RHO}
    for rho, typical, worst in ((0.5, 5e-4, 2.5e-3), (0.9, 1e-4, 6e-4), (0.99, 1e-5, 6e-5)):
        assert errors[rho][0] < typical <= 1e-3 and errors[rho][1] < worst, errors
    assert rms(dense(truth, found.laws.rows) - truth.f) < 3e-5


def test_rays_alone_reach_their_own_floor(truth: Truth) -> None:
    """4,096 rays per patch, reconciled: over 20 seeds 4.99e-3 ± 0.07e-3, 1.121e-3 ± 0.010e-3 and 1.23e-4 ± 0.04e-4 at the three
    albedos; raw rows give 5.4e-3, 1.4e-3 and 7.4e-4. So the 1e-3 asked for is met at ρ = 0.99 only. What limits: the lamp is 25
    patches, and a raw row's sum over them is wrong by 1.75e-3 (asserted); 1e-3 at ρ = 0.5 would take about a fifth of that. Least
    squares with the *true* variance of every such sum, which nobody has, come to 4.85e-3, 1.09e-3 and 1.16e-4."""
    lamp, exact = truth.e > 0.0, truth.f @ truth.e
    of_sums, errors = [], {rho: [] for rho in RHO}
    for seed in range(3):
        raw = patch_form_factors(truth.g, truth.p, BUDGET, seed, silent)
        of_sums.append(rms(dense(truth, raw) @ lamp - exact))
        rows = reconcile(raw, truth.p.area).rows
        assert rms(dense(truth, rows) - truth.f) < 5.9e-4
        for rho in RHO:
            errors[rho].append(indirect_error(truth, rows, rho)[0])
    for rho, limit in ((0.5, 5.8e-3), (0.9, 1.3e-3), (0.99, 2e-4)):
        assert max(errors[rho]) < limit, errors
    assert min(errors[0.5]) > 1e-3 > max(errors[0.99])
    assert 1.5e-3 < np.mean(of_sums) < 2.0e-3, of_sums


def test_hybrid_as_a_reference(truth: Truth) -> None:
    """Noise 2.5e-4: at most 1e-5 rms per pair (seen 8.1e-6 … 8.4e-6), against exact ones; the standard errors say so: promised
    and measured rms over rows differ by under a third."""
    raw = patch_form_factors(truth.g, truth.p, 256, 1, silent)
    found = hybrid_form_factors(truth.g, truth.p, raw, 2.5e-4, 1, silent)
    error = dense(truth, found.laws.rows) - truth.f
    assert rms(error) <= 1e-5
    promised = math.sqrt(float((found.laws.rows.row_se**2).mean()))
    measured = math.sqrt(float((error**2).sum(axis=1).mean()))
    assert 0.6 < measured / promised < 1.1, (measured, promised)
    for rho, limit in ((0.5, 3e-4), (0.9, 6e-5), (0.99, 6e-6)):
        assert indirect_error(truth, found.laws.rows, rho)[0] < limit


def test_what_is_not_seen_is_exactly_zero(truth: Truth) -> None:
    """17,124 entries are 0 in truth: faces turned away, and pairs behind the inner cube. All of them are 0, also where that is
    not provable from single patches, since no ray passes. Of those that are not 0, only slivers under 3e-4 are missed."""
    raw = patch_form_factors(truth.g, truth.p, 64, 3, silent)
    found = hybrid_form_factors(truth.g, truth.p, raw, 1e-3, 3, silent)
    f, unseen = dense(truth, found.laws.rows), truth.f == 0.0
    assert unseen.sum() == 17124 and not f[unseen].any()
    assert truth.f[f == 0.0].max() < 3e-4 and ((f == 0.0) & ~unseen).sum() < 500
    assert found.clear + found.blocked + found.mixed == (len(f) ** 2 - _turned_away(truth)) / 2


def _turned_away(t: Truth) -> int:
    """Pairs, both ways and with the diagonal, that do not face each other were nothing in between."""
    centre, normal = t.p.centroid, t.p.normal
    towards = centre[None] - centre[:, None]
    here = np.einsum("ijc,ic->ij", towards, normal) > 1e-9
    return int((~(here & here.T)).sum())


def test_clear_pairs_are_closed_forms(truth: Truth) -> None:
    """Entries without a standard error are the truth to 1e-7, and closing does not bend them: four fifths of those seen."""
    raw = patch_form_factors(truth.g, truth.p, 64, 3, silent)
    rows = hybrid_form_factors(truth.g, truth.p, raw, 1e-2, 3, silent).laws.rows
    se = rows.matrix().copy()
    se.data[:] = rows.se[:, 0]
    number = np.ix_(truth.number, truth.number)
    exact = (rows.matrix().toarray()[number] > 0.0) & (se.toarray()[number] == 0.0)
    assert exact.sum() > 15_000
    np.testing.assert_allclose(dense(truth, rows)[exact], truth.f[exact], atol=1e-7)
