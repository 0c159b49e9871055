"""Rays by need: the error asked for is reached, uneven scenes need fewer rays than a uniform choice, the pilot is not used again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import irradiance
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport import adaptive
from lightgauge.reference.transport.adaptive import (
    DIM,
    LEAST,
    PILOT,
    Allocation,
    Pilot,
    allocate,
    fixed,
    gathered,
    guess_light,
    pilot_matrix,
    trace_pilot,
)
from lightgauge.reference.transport.form_factors import REPLICATES, patch_form_factors
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.receivers import Receivers, patch_receivers, probe_receivers
from lightgauge.reference.visibility import Geometry
from small_scenes import box, box_quads, material, quad, random_units, scene, surfaces

Array = npt.NDArray[Any]


def room(lamp: float) -> Scene:
    """A room with a block in it and a square lamp, edge `lamp` m, under the ceiling."""
    walls = [quad(q) for q in box_quads((0, 0, 0), (4, 2, 2))]
    block = box((2.0, 0, 0.6), (2.6, 1.2, 1.4), inward=False)
    a, b = 0.3, 0.3 + lamp
    shining = quad([[a, 1.99, a], [b, 1.99, a], [b, 1.99, b], [a, 1.99, b]], emission=20.0)
    return scene([*walls, block, shining], [material(0.6)])


def behind_a_gap() -> Scene:
    """Two rooms with a gap between them; the lamp in one is small enough for a pilot's rays from the other to miss it."""
    walls = [quad(q) for q in box_quads((0, 0, 0), (4, 2, 2))]
    between = [box((1.9, 0, a), (2.0, 2, b), inward=False) for a, b in ((0.0, 0.8), (1.2, 2.0))]
    lamp = quad([[0.2, 1.99, 0.2], [0.8, 1.99, 0.2], [0.8, 1.99, 0.8], [0.2, 1.99, 0.8]], emission=20.0)
    return scene([*walls, *between, lamp], [material(0.6)])


def even_and_uneven() -> Scene:
    """Two closed rooms. In one all walls glow alike: no ray tells anything new. In the other half of one wall glows."""
    even = box((0, 0, 0), (4, 2, 4), emission=1.0, name="even")
    walls = [quad(q) for q in box_quads((5, 0, 0), (6, 1, 1))]
    lamp = quad([[5.001, 0, 0], [5.001, 0.5, 0], [5.001, 0.5, 1], [5.001, 0, 1]], emission=8.0)
    return scene([even, *walls, lamp], [material(0.5)])


@dataclass(frozen=True)
class Case:
    """A scene, its patches as receivers, the light they gather, what they truly gather (R,) and the error's scale (R,)."""

    g: Geometry
    p: Patches
    receivers: Receivers
    light: Array
    exact: Array
    scale: Array

    def error(self, rays: int | Array, seed: int) -> float:
        """Relative error, root mean square over the area, of one run."""
        found = patch_form_factors(self.g, self.p, rays, seed, silent).matrix() @ self.light
        return math.sqrt(float(self.p.area @ ((found - self.exact) / self.scale) ** 2 / self.p.area.sum()))

    def uniform_error(self, each: float, seed: int) -> float:
        """The same of `each` rays for all, read between the two powers of two about it."""
        below = 2 ** math.floor(math.log2(each))
        errors = [self.error(n, seed) for n in (below, 2 * below)]
        return math.exp(float(np.interp(math.log2(each / below), [0.0, 1.0], np.log(errors))))

    def allocations(self, noise: float, count: int, least: int = LEAST) -> list[Allocation]:
        """What `count` pilots, each with other rays, find."""
        pilots = (trace_pilot(self.g, self.p, self.receivers, seed) for seed in range(count))
        return [allocate(pilot, self.light, self.p.area, noise, 1 << 20, least) for pilot in pilots]


def case_of(s: Scene, size: float, rays: int, runs: int) -> Case:
    g, p = surfaces(s, size)
    receivers = patch_receivers(g, p)
    light = guess_light(s, p, trace_pilot(g, p, receivers, 50), np.zeros((p.count, 3)))
    many = [patch_form_factors(g, p, rays, 900 + k, silent).matrix() @ light for k in range(runs)]
    exact = np.mean(many, axis=0)
    return Case(g, p, receivers, light, exact, exact + DIM * float(p.area @ exact / p.area.sum()))


@pytest.fixture(scope="module")
def lamp_case() -> Case:
    return case_of(room(1.0), 0.5, 4096, 4)


@pytest.fixture(scope="module")
def uneven_case() -> Case:
    return case_of(even_and_uneven(), 0.4, 4096, 4)


def reached(c: Case, noise: float, pilots: int) -> Array:
    """Error over the error asked for, of that many pilots and one run each."""
    found = c.allocations(noise, pilots)
    assert all(0.7 * noise < f.reached <= noise for f in found)
    return np.array([c.error(f.rays, 20 + k) / noise for k, f in enumerate(found)])


@pytest.mark.parametrize("noise", [0.08, 0.05])
def test_the_error_asked_for_is_reached(lamp_case: Case, noise: float) -> None:
    """The mean square error over pilots is under what was asked for, and not under a quarter of it: low-discrepancy rays gain with
    their number, which the pilot cannot see, so a third fewer rays would often do. Over 30 seeds 0.64 and
    0.59 ± 0.05 (sd); with half the rays 1.3 and 1.2."""
    found = (reached(lamp_case, noise, 8) ** 2).mean()
    assert 0.25 < found < 1.0, found


def test_what_a_pilot_misses() -> None:
    """The limit of it: patches that see a lamp under a thousandth of their hemisphere, as bright as all the rest together. 64 rays
    find it from few of them. The error of one pilot is then 0.6 to 1.8 times what was asked for, not unbounded, since patches that
    missed it are drawn to the mean of all. The mean of 12 over 30 seeds: 0.92 ± 0.06 (sd); not drawn, 1.9."""
    found = reached(case_of(behind_a_gap(), 0.5, 4096, 4), 0.15, 12).mean()
    assert 0.5 < found < 1.3, found


def test_rays_go_where_the_light_varies(uneven_case: Case) -> None:
    """A patch of the even room gets about a third of the rays: its own variance is nothing, what it is drawn to is not. All rays, the
    pilot's included, are then fewer than a uniform choice would take, and as many rays, one number for all, leave a larger error.
    Over 30 seeds (sd): 3.4 ± 0.2 times the rays, 0.61 ± 0.03 of the uniform choice's; own error 0.0134 ± 0.0013 at most, logarithm
    of the uniform choice's over it 0.56 ± 0.04."""
    c = uneven_case
    even = c.p.centroid[:, 0] < 4.5
    assert even.sum() > 100 and (~even).sum() > 30
    found = c.allocations(0.01, 8, 64)
    assert all(f.spent == f.rays.sum() + PILOT * c.p.count for f in found)
    each = np.mean([[f.rays[even].mean(), f.rays[~even].mean()] for f in found], axis=0)
    assert each[1] > 2.4 * each[0]
    assert np.mean([f.spent / f.uniform for f in found]) < 0.8
    found = c.allocations(0.02, 6, 64)
    own = np.array([c.error(f.rays, k) for k, f in enumerate(found)])
    uniform = np.array([c.uniform_error(float(f.rays.mean()), k) for k, f in enumerate(found)])
    assert (own < 0.02).all() and np.log(uniform / own).mean() > math.log(1.2), (own, uniform)


def test_the_uniform_count_is_what_uniform_rays_need(uneven_case: Case, lamp_case: Case) -> None:
    """Uniform rays of the count reported reach the error of the allocation, within a factor of 1.5 (of the error) in the mean of three
    pilots; over 30 seeds the logarithm of it is 0.09 ± 0.06 and 0.07 ± 0.04 (sd)."""
    for c, noise in ((uneven_case, 0.05), (lamp_case, 0.1)):
        ratios = [
            c.uniform_error(found.uniform / c.p.count, k) / c.error(found.rays, k)
            for k, found in enumerate(c.allocations(noise, 3))
        ]
        assert 1 / 1.5 < math.exp(np.log(ratios).mean()) < 1.5, ratios


def test_the_pilot_is_not_used_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rays are others than those of the result, and for given counts the result does not depend on it."""
    g, p = surfaces(behind_a_gap(), 0.8)
    receivers = patch_receivers(g, p)
    pilot = trace_pilot(g, p, receivers, 1)
    rows = patch_form_factors(g, p, PILOT, 1, silent)
    own = pilot_matrix(pilot, p.count + SKY_BINS + 1)
    assert np.abs((own - rows.matrix()).toarray()).max() > 0.05
    monkeypatch.setattr(adaptive, "PILOT_SEED", 12345)
    other = trace_pilot(g, p, receivers, 1)
    assert not np.array_equal(pilot.columns, other.columns)
    again = patch_form_factors(g, p, PILOT, 1, silent)
    np.testing.assert_array_equal(rows.values, again.values)
    np.testing.assert_array_equal(rows.columns, again.columns)
    # with the seed of the result they would be the same rays
    monkeypatch.setattr(adaptive, "PILOT_SEED", 0)
    same = pilot_matrix(trace_pilot(g, p, receivers, 1), p.count + SKY_BINS + 1)
    np.testing.assert_allclose((same - rows.matrix()).toarray(), 0.0, atol=1e-7)


def test_the_pilot_does_not_depend_on_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    g, p = surfaces(behind_a_gap(), 0.8)
    kinds = (patch_receivers(g, p), probe_receivers(g, random_units(9, 1) * 0.2 + [1.0, 1.0, 1.0]))
    whole = [trace_pilot(g, p, r, 1) for r in kinds]
    monkeypatch.setattr(adaptive, "RAYS_PER_BATCH", 200)
    for r, expected in zip(kinds, whole, strict=True):
        found = trace_pilot(g, p, r, 1)
        np.testing.assert_array_equal(found.columns, expected.columns)
        assert (found.directions is None) == (not r.spherical)
        if r.spherical:
            np.testing.assert_array_equal(found.directions, expected.directions)


def random_pilot(receivers: int, columns: int, seed: int, spherical: bool) -> tuple[Pilot, Array]:
    rng = np.random.default_rng(seed)
    found = rng.integers(0, columns, (receivers, PILOT)).astype(np.uint32)
    d = random_units(receivers * PILOT, seed).reshape(receivers, PILOT, 3).astype(np.float32)
    return Pilot(found, d if spherical else None), rng.random(columns)


def test_gathered_light_and_its_variance() -> None:
    pilot, light = random_pilot(5, 9, 1, False)
    mean, variance = gathered(pilot, light)
    np.testing.assert_allclose(mean, pilot_matrix(pilot, 9) @ light, rtol=1e-12)
    parts = light[pilot.columns].reshape(5, REPLICATES, -1).mean(axis=2)
    np.testing.assert_allclose(variance, parts.std(axis=1, ddof=1) ** 2 / REPLICATES, rtol=1e-12)
    half_mean, half = gathered(pilot, light, slice(1, None, 2))
    np.testing.assert_allclose(half_mean, parts[:, 1::2].mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(half, parts[:, 1::2].var(axis=1, ddof=1) / 4, rtol=1e-12)


def test_variance_of_probes_is_that_of_irradiance_over_all_normals() -> None:
    """SH of each replicate, irradiance for 2,000 random normals, spread over replicates, mean over normals, which are few enough
    to spread it by 1 %: within 5.5 %."""
    pilot, light = random_pilot(3, 9, 2, True)
    assert pilot.directions is not None
    mean, variance = gathered(pilot, light)
    d = pilot.directions.reshape(3, REPLICATES, -1, 3).astype(np.float64)
    b = light[pilot.columns].reshape(3, REPLICATES, -1, 1)
    y0, y1 = 0.5 / math.sqrt(math.pi), 0.5 * math.sqrt(3.0 / math.pi)
    basis = np.concatenate([np.full_like(b, y0), y1 * d[..., [1, 2, 0]]], axis=3)
    sh = 4.0 * (basis * b).mean(axis=2)  # 4π/N Σ Y B/π
    normals = random_units(2000, 3)
    for r in range(3):
        e = np.stack([irradiance(np.repeat(sh[r, k, :, None], 3, axis=1)[None].repeat(2000, 0), normals)[:, 0]
                      for k in range(REPLICATES)])  # fmt: skip
        assert e.mean() == pytest.approx(mean[r], rel=0.03)
        assert (e.var(axis=0, ddof=1) / REPLICATES).mean() == pytest.approx(variance[r], rel=0.055)


@pytest.mark.parametrize("most", [64, 500, 4096])
def test_counts_are_powers_of_two_between_the_bounds(most: int) -> None:
    pilot, light = random_pilot(40, 30, 3, False)
    for noise in (1e-9, 1e-2, 1e3):
        rays = allocate(pilot, light * (np.arange(30) == 3), np.ones(40), noise, 1 << (most.bit_length() - 1), 64).rays
        assert ((rays & (rays - 1)) == 0).all() and (rays >= 64).all() and (rays <= most).all()
        assert noise > 1e-9 or (rays == 1 << (most.bit_length() - 1)).all()
        assert noise < 1e3 or (rays == 64).all()


def test_nothing_to_decide() -> None:
    pilot, light = random_pilot(4, 9, 4, False)
    for found in (allocate(pilot, 0.0 * light, np.ones(4), 0.01, 1024), fixed(4, 64)):
        assert isinstance(found, Allocation) and found.rays.tolist() == [64] * 4 and found.spent == found.uniform == 256
    none = Pilot(np.zeros((0, PILOT), np.uint32), None)
    assert len(allocate(none, light, np.ones(0), 0.01, 1024).rays) == 0
    alike = Pilot(np.full((3, PILOT), 2, np.uint32), None)  # no spread at all
    found = allocate(alike, light, np.ones(3), 0.01, 1024)
    assert found.rays.tolist() == [64] * 3 and found.reached == 0.0
