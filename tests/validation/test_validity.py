"""Validity against the winding number (failure-catalogue C4)."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.placement.validity import back_share
from lightgauge.reference.visibility import Geometry, build_geometry
from lightgauge.validation.metrics.validity import Judged, area_under_curve, measure_validity, rates
from small_scenes import box, material, quad, scene, sphere_mesh


def probes(g: Geometry, count: int = 1500, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    at = np.random.default_rng(seed).uniform(g.lower - 0.3, g.upper + 0.3, (count, 3))
    return at, back_share(g, at, seed)


def test_area_is_the_share_of_pairs_in_the_right_order() -> None:
    rng = np.random.default_rng(1)
    share, solid = rng.integers(0, 6, 300) / 5.0, rng.random(300) < 0.4  # many ties
    share[solid] = np.minimum(share[solid] + 0.2, 1.0)
    a, b = share[solid][:, None], share[~solid][None]
    pairs = float(((a > b) + 0.5 * (a == b)).mean())
    found = area_under_curve(Judged(share, solid))
    assert found.value == pytest.approx(pairs, abs=1e-12) and found.n == 300


def test_its_standard_error_is_what_repeats_show() -> None:
    rng = np.random.default_rng(2)
    solid = np.arange(400) < 150
    values = [area_under_curve(Judged(rng.normal(solid * 1.0), solid)) for _ in range(200)]
    spread = float(np.std([v.value for v in values]))
    assert np.mean([v.se for v in values]) == pytest.approx(spread, rel=0.3)  # 1.06 ± 0.044 over 40 seeds


def test_rates_are_the_curve() -> None:
    j = Judged(np.array([0.0, 0.05, 0.2, 0.6, 1.0, 0.3]), np.array([False, False, False, True, True, True]))
    assert rates(j, 0.1) == (0.0, pytest.approx(1 / 3))
    assert rates(j, 0.5) == (pytest.approx(1 / 3), 0.0)
    assert rates(j, 1.0) == (1.0, 0.0)


@pytest.mark.parametrize("room", [False, True])
def test_closed_meshes_are_told_apart(room: bool) -> None:
    """A block, alone or in a room's shell. Nothing free sees backs; far outside of the shell few rays meet it, so that a tolerance
    misses some places there, but their order is right."""
    block = box((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3), inward=False)
    g = build_geometry(scene([sphere_mesh(1.0, 2, True), block] if room else [block]))
    found = measure_validity(g, *probes(g), 0.2, 0.1, 0)
    assert set(found.metrics) == {"validity_auc", "validity_auc_near", "validity_wrong"}
    assert found.metrics["validity_auc"].value >= 0.99 and found.metrics["validity_auc_near"].value >= 0.99
    assert found.judged is not None and not found.notes
    missed, alarms = rates(found.judged, 0.1)
    assert alarms == 0.0 and (missed > 0.0) == room
    assert found.metrics["validity_wrong"].value == pytest.approx(missed * found.judged.solid.mean())


def test_a_share_that_says_nothing_is_found_out() -> None:
    g = build_geometry(scene([sphere_mesh(1.0, 2, True)]))
    at, share = probes(g)
    noise = np.random.default_rng(3).permutation(share)
    auc = measure_validity(g, at, noise, 0.2, 0.1, 0).metrics["validity_auc"]
    assert abs(auc.value - 0.5) < 4 * auc.se
    assert measure_validity(g, at, 1.0 - share, 0.2, 0.1, 0).metrics["validity_auc"].value < 0.01


def test_open_meshes_give_figures_another_name() -> None:
    """Under a single sheet all is back faces, and the winding number knows nothing of it: a false alarm."""
    floor = quad([(-3, 0, -3), (-3, 0, 3), (3, 0, 3), (3, 0, -3)])
    g = build_geometry(scene([floor, box((-1, 0.5, -1), (1, 2.5, 1), inward=False)]))
    at = np.random.default_rng(0).uniform((-3, -2, -3), (3, 3, 3), (1500, 3))
    found = measure_validity(g, at, back_share(g, at, 0), 0.2, 0.1, 0)
    assert set(found.metrics) == {"validity_auc_open", "validity_auc_near_open", "validity_wrong_open"}
    assert found.metrics["validity_wrong_open"].value > 0.1
    assert found.metrics["validity_auc_near_open"].value > 0.99


def test_nothing_is_said_where_nothing_is_closed_or_nothing_is_inside() -> None:
    floor = quad([(-3, 0, -3), (-3, 0, 3), (3, 0, 3), (3, 0, -3)])
    g = build_geometry(scene([floor]))
    found = measure_validity(g, *probes(g), 0.2, 0.1, 0)
    assert not found.metrics and found.judged is None and "no mesh is closed" in found.notes[0]
    g = build_geometry(scene([box((0, 0, 0), (1, 1, 1), inward=False)], [material()]))
    outside = np.full((50, 3), 3.0)
    found = measure_validity(g, outside, back_share(g, outside, 0), 0.2, 0.1, 0)
    assert "validity_auc" not in found.metrics and "0 of 50 probes" in found.notes[0]
