"""Solvers against exact answers and one another, the spectral radius, and one bounce an update.

Systems here have given form factors, so all that is left is the solver's own error.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.progress import silent
from lightgauge.reference.transport.form_factors import patch_form_factors
from lightgauge.reference.transport.gather import upload
from lightgauge.reference.transport.solver_types import System, device_system, matrix_system
from lightgauge.reference.transport.solvers import METHODS, OneBounce, solve
from lightgauge.reference.transport.spectral import bounce_count, estimate_spectrum, refuse_slow
from scipy import sparse
from small_scenes import box, material, scene, surfaces

Array = npt.NDArray[np.float64]
ALL = ("jacobi", "gauss-seidel", "southwell", "one-bounce")
CARRIED = ALL[:3]


def system_of(f: Any, albedo: Any, source: Any, area: Any = 1.0) -> System:
    p = len(f)
    return matrix_system(
        sparse.csr_array(np.asarray(f, float)),
        np.broadcast_to(np.asarray(albedo, float), (p, 3)),
        np.broadcast_to(np.asarray(source, float), (p, 3)),
        np.broadcast_to(np.asarray(area, float), (p,)),
    )


def random_system(seed: int, p: int = 60, escaping: float = 0.0, reciprocal: bool = True) -> System:
    """Coloured albedo, areas over two decades, patches that see themselves. reciprocal: A_i F_ij = A_j F_ji; otherwise
    rows as rays would leave them. Rows sum to 1 - escaping."""
    rng = np.random.default_rng(seed)
    area = 10.0 ** rng.uniform(-2, 0, p)
    if reciprocal:
        share, bend = area / area.sum(), rng.uniform(-1, 1, p)
        bend -= share @ bend
        f = share[None, :] * (1.0 + 0.25 * bend[:, None] * bend[None, :])  # rows still sum to one
        assert (f > 0.0).all()
    else:
        f = rng.random((p, p)) * (rng.random((p, p)) < 0.3) + 1e-3
        f /= f.sum(axis=1, keepdims=True)
    source = rng.random((p, 3)) * (rng.random((p, 1)) < 0.2)
    source[0] = 1.0
    return system_of((1.0 - escaping) * f, rng.uniform(0.0, 0.95, (p, 3)), source, area)


def sphere_system(albedo: Any, source: Array, area: Array) -> System:
    """Inside of a sphere: F_ij = A_j / A."""
    return system_of(np.tile(area / area.sum(), (len(area), 1)), albedo, source, area)


def exact(s: System) -> Array:
    f = s.rows("test").toarray()
    unit = np.eye(s.patches)
    return np.stack([np.linalg.solve(unit - s.albedo[:, c, None] * f, s.source[:, c]) for c in range(3)], axis=1)


def true_residual(s: System, b: Array) -> float:
    r = np.abs(s.source + s.reflected(b) - b)
    return float(max((r.max(axis=0) / s.source.max(axis=0)).max(), ((s.area @ r) / (s.area @ s.source)).max()))


# Exact answers


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("seed", range(4))
def test_every_method_reaches_the_direct_solution(method: str, seed: int) -> None:
    """The error is at most residual / (1 - ρmax), ρmax = 0.95."""
    s = random_system(seed, escaping=0.1 * seed, reciprocal=seed % 2 == 0)
    found = solve(s, METHODS[method], 1e-11)
    np.testing.assert_allclose(found.radiosity, exact(s), rtol=0, atol=20 * 1e-11 * s.source.max())
    assert true_residual(s, found.radiosity) <= 1.001e-11
    assert found.residual <= 1e-11


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("rho", [(0.5, 0.5, 0.5), (0.9, 0.3, 0.0), (0.99, 0.97, 0.2)])
def test_inside_of_a_sphere(method: str, rho: tuple[float, float, float]) -> None:
    """failure-catalogue B2: B = E + ρ Ē / (1 - ρ) for any E, exactly, whatever the facets."""
    rng = np.random.default_rng(3)
    area, e = rng.random(24) + 0.01, rng.random((24, 3)) ** 4
    found = solve(sphere_system(rho, e, area), METHODS[method], 1e-12)
    r = np.array(rho)
    np.testing.assert_allclose(found.radiosity, e + r * (area @ e / area.sum()) / (1 - r), rtol=1.1e-10)


@pytest.mark.parametrize("method", ALL)
def test_sphere_of_many_albedos(method: str) -> None:
    """H = Ē / (1 - ρ̄) everywhere, with area means: Hottel and Sarofim 1967, ch. 3."""
    rng = np.random.default_rng(4)
    area, e, rho = rng.random(50) + 0.1, rng.random((50, 3)), rng.uniform(0, 0.98, (50, 3))
    mean = area / area.sum()
    found = solve(sphere_system(rho, e, area), METHODS[method], 1e-12)
    np.testing.assert_allclose(found.radiosity, e + rho * (mean @ e) / (1 - mean @ rho), rtol=1e-10)


@pytest.mark.parametrize("method", ALL)
def test_energy_of_a_closed_scene(method: str) -> None:
    """failure-catalogue B3: Σ A (B (1 - ρ) - E) / ρ has no closed form for mixed albedo, but what is emitted is absorbed:
    Σ A ((1 - ρ) H - E) = 0 with H = F B, for reciprocal F with rows that sum to one."""
    s = random_system(11)
    b = solve(s, METHODS[method], 1e-12).radiosity
    absorbed = s.area @ ((1.0 - s.albedo) * s.product(b))
    np.testing.assert_allclose(absorbed, s.area @ s.source, rtol=1e-9)
    uniform = dataclasses.replace(s, albedo=np.full_like(s.albedo, 0.9))
    b = solve(uniform, METHODS[method], 1e-12).radiosity
    defect = s.area @ (b * (1.0 - 0.9) - s.source) / (s.area @ s.source)
    assert np.abs(defect).max() < 1e-9


# How fast


@pytest.mark.parametrize(("rho", "steps"), [(0.9, 66), (0.99, 688)])
def test_jacobi_in_a_furnace_takes_as_many_steps_as_the_catalogue_says(rho: float, steps: int) -> None:
    """failure-catalogue B1: residual ρ^n, so ln 1e-3 / ln ρ gathers; the spectral radius foretells them exactly."""
    s = sphere_system(rho, np.ones((12, 3)), np.arange(1.0, 13.0))
    found = solve(s, METHODS["jacobi"], 1e-3)
    assert found.iterations == steps == bounce_count(estimate_spectrum(s).upper, 1e-3)
    np.testing.assert_allclose(found.history.residual, rho ** np.arange(steps + 1), rtol=1e-9)
    assert bounce_count(0.999, 1e-3) == 6905


def test_gauss_seidel_needs_fewer_row_operations_than_jacobi() -> None:
    """Stein and Rosenberg 1948: for a non-negative matrix never slower; about half in a closed room."""
    for seed in range(3):
        s = random_system(seed, reciprocal=False)
        jacobi, seidel = (solve(s, METHODS[m], 1e-9) for m in ("jacobi", "gauss-seidel"))
        assert seidel.row_operations < 0.75 * jacobi.row_operations


def test_southwell_lights_a_room_in_fewer_row_operations() -> None:
    """Cohen et al. 1988: with one small lamp among many patches, shooting has an answer within 1 % (area mean) before
    Jacobi has finished its second sweep."""
    s = random_system(5, p=400)
    lamp = np.zeros_like(s.source)
    lamp[17] = 1.0
    s = dataclasses.replace(s, source=lamp, albedo=0.5 * s.albedo)
    b = exact(s)
    found = solve(s, METHODS["southwell"], 1e-2)
    wrong = s.area @ np.abs(found.radiosity - b) / (s.area @ b)
    assert wrong.max() < 0.01
    assert found.row_operations < 2 * s.patches
    assert found.row_operations < solve(s, METHODS["jacobi"], 1e-2).row_operations


@pytest.mark.parametrize("method", CARRIED)
def test_a_small_lamp_does_not_hide_an_unlit_room(method: str) -> None:
    """A lamp of 1e-5 of the area has a peak beside which the room's light is small from the first bounce on. The tolerance
    counts power as well: what is missing of the reflected power
    is at most tolerance / (1 - ρ) of the lamp's, here 1 / ρ of the tolerance."""
    s = sphere_system(0.9, np.array([[1e6] * 3] + [[0.0] * 3] * 40), np.array([1e-5] + [1.0 / 40] * 40))
    reflected = [s.area @ (b - s.source) for b in (solve(s, METHODS[method], 1e-3).radiosity, exact(s))]
    np.testing.assert_allclose(reflected[0], reflected[1], rtol=1.2e-3)


def test_southwell_shoots_the_most_powerful_patch_first() -> None:
    """Two lamps: the large dim one holds more power than the small bright one; after one shot only it is dark."""
    s = system_of(np.full((4, 4), 0.25), 0.5, [[3.0] * 3, [1.0] * 3, [0.0] * 3, [0.0] * 3], [1.0, 10.0, 1.0, 1.0])
    b, r = np.zeros((4, 3)), s.source.copy()
    assert METHODS["southwell"].prepare(s)(b, r) == 1
    step = 1.0 / (1.0 - 0.5 * 0.25)  # it sees itself
    np.testing.assert_allclose(b[:, 0], [0.0, step, 0.0, 0.0])
    np.testing.assert_allclose(r[:, 0], [3 + step / 8, 0.0, step / 8, step / 8])


def test_southwell_shoots_power_away() -> None:
    """Unshot power never rises: each shot loses (1 - ρ) of what it shoots, if F is reciprocal and closed."""
    s = random_system(6)
    b, r = np.zeros_like(s.source), s.source.copy()
    sweep, before = METHODS["southwell"].prepare(s), np.inf
    for _ in range(40):
        sweep(b, r)
        power = s.area @ r.sum(axis=1)
        assert power < before
        before = power
    np.testing.assert_allclose(s.source + s.reflected(b) - b, r, atol=1e-13)


@pytest.mark.parametrize("method", CARRIED)
def test_the_carried_residual_is_the_residual(method: str) -> None:
    s = random_system(7, reciprocal=False)
    for tolerance in (0.5, 1e-2, 1e-4):
        found = solve(s, METHODS[method], tolerance)
        assert true_residual(s, found.radiosity) == pytest.approx(found.residual, rel=1e-9)


@pytest.mark.parametrize("method", ALL)
def test_history(method: str) -> None:
    s = random_system(8)
    found = solve(s, METHODS[method], 1e-6)
    h = found.history
    assert len(h.residual) == len(h.row_operations) == len(h.milliseconds)
    assert h.row_operations[0] == 0 and (np.diff(h.row_operations) > 0).all()
    assert (np.diff(h.milliseconds) >= 0).all() and h.milliseconds[-1] == pytest.approx(1e3 * found.seconds)
    assert h.residual[0] == 1.0 and (h.residual[:-1] > 1e-6).all() and h.residual[-1] == found.residual <= 1e-6
    assert h.row_operations[-1] == found.row_operations
    assert found.iterations == math.ceil(found.row_operations / s.patches)


def test_a_start_near_the_answer_saves_work_and_ends_in_the_same_place() -> None:
    """Also where the light was brighter before, so that the residual is negative, and where all light went out."""
    s = random_system(9)
    b = exact(s)
    for method in ALL:
        for factor in (1.05, 0.95):
            warm = solve(s, METHODS[method], 1e-10, start=factor * b)
            np.testing.assert_allclose(warm.radiosity, b, atol=1e-8)
        assert solve(s, METHODS[method], 1e-4, start=b).row_operations < s.patches + 1
        out = solve(dataclasses.replace(s, source=np.zeros_like(b)), METHODS[method], 1e-8, start=b)
        np.testing.assert_allclose(out.radiosity, 0.0, atol=1e-6 * b.max())


@pytest.mark.parametrize("method", ALL)
def test_no_light_and_no_albedo(method: str) -> None:
    f = np.full((3, 3), 1 / 3)
    assert not solve(system_of(f, 0.5, 0.0), METHODS[method], 1e-6).radiosity.any()
    black = solve(system_of(f, 0.0, [[1, 2, 3]] * 3), METHODS[method], 1e-6)
    np.testing.assert_array_equal(black.radiosity, [[1, 2, 3]] * 3)


def test_a_dim_colour_is_solved_as_well_as_a_bright_one() -> None:
    """The tolerance holds in each colour by itself: blue at a millionth of red is not below anyone's notice."""
    s = random_system(10)
    s = dataclasses.replace(s, source=s.source * [1.0, 1.0, 1e-6], albedo=np.full_like(s.albedo, 0.9))
    found = solve(s, METHODS["jacobi"], 1e-6)
    np.testing.assert_allclose(found.radiosity, exact(s), rtol=1e-4)


def test_the_device_reaches_tolerances_below_its_precision() -> None:
    """Products in single precision: the carried residual falls all the same, and the answer is right to 1e-5 at ρ = 0.9."""
    g, p = surfaces(scene([box((0, 0, 0), (1, 2, 3))], [material((0.9, 0.6, 0.3))]), 0.5)
    rows = patch_form_factors(g, p, 256, 1, silent)
    source = np.random.default_rng(1).random((p.count, 3))
    device = device_system(upload(rows), p.albedo, source, p.area)
    plain = matrix_system(rows, p.albedo, source, p.area)
    b = exact(plain)
    for method in ("jacobi", "one-bounce"):
        np.testing.assert_allclose(solve(device, METHODS[method], 1e-6).radiosity, b, rtol=2e-5)
    np.testing.assert_allclose(solve(device, METHODS["jacobi"], 1e-12).radiosity, b, rtol=2e-6)
    both = device_system(upload(rows), p.albedo, source, p.area, rows)
    np.testing.assert_allclose(solve(both, METHODS["gauss-seidel"], 1e-10).radiosity, b, rtol=1e-8)
    with pytest.raises(ValueError, match="gauss-seidel walks single rows"):
        solve(device, METHODS["gauss-seidel"], 1e-6)


# Spectral radius


def radius_of(s: System) -> float:
    f = s.rows("test").toarray()
    return max(float(np.abs(np.linalg.eigvals(s.albedo[:, c, None] * f)).max()) for c in range(3))


@pytest.mark.parametrize("seed", range(6))
def test_spectral_radius_is_bracketed(seed: int) -> None:
    s = random_system(seed, escaping=0.15 * seed, reciprocal=seed % 2 == 0)
    found, true = estimate_spectrum(s), radius_of(s)
    assert found.lower <= true * (1 + 1e-12) and true <= found.upper * (1 + 1e-12)
    assert found.lower <= found.radius <= found.upper
    assert math.log(true) / math.log(found.upper) <= 1.1  # the bounces it lets expect, against the bounces it takes
    assert found.products <= 20
    assert estimate_spectrum(s) == found  # no chance in it


def test_spectral_radius_of_known_matrices() -> None:
    furnace = estimate_spectrum(sphere_system((0.2, 0.7, 0.4), np.ones((9, 3)), np.arange(1.0, 10.0)))
    assert furnace.radius == pytest.approx(0.7, rel=1e-12) and furnace.colour == 1
    assert furnace.spread == pytest.approx(1.0) and furnace.products == 1
    plates = estimate_spectrum(system_of([[0, 0.2], [0.2, 0]], [[0.9] * 3, [0.4] * 3], 1.0))  # light swings to and fro
    assert plates.upper == pytest.approx(0.2 * math.sqrt(0.36), abs=0.02) and plates.lower <= 0.12 <= plates.upper
    assert estimate_spectrum(system_of(np.full((4, 4), 0.25), 0.0, 1.0)).upper == 0.0
    one_way = np.triu(np.full((6, 6), 0.2), 1)  # nobody looks back: the light dies by itself
    assert estimate_spectrum(system_of(one_way, 0.9, 1.0)).upper == pytest.approx(0.0, abs=0.02)


def test_spectral_radius_of_two_rooms_is_that_of_the_brighter() -> None:
    """No light passes between them, so the lower bound stays at the dark room; the upper one still closes."""
    f = np.kron(np.eye(2), np.full((5, 5), 0.2))
    albedo = np.array([[0.3, 0.1, 0.3, 0.1, 0.2], [0.8, 0.4, 0.8, 0.4, 0.6]]).reshape(-1, 1) * np.ones(3)
    found = estimate_spectrum(system_of(f, albedo, 1.0))
    assert found.lower <= 0.6 + 1e-12
    assert 0.6 - 1e-12 <= found.upper == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("rho", [0.999, 0.9995])
def test_slow_light_is_refused_with_the_value_and_the_way_out(rho: float) -> None:
    s = sphere_system((0.5, 0.5, rho), np.ones((6, 3)), np.ones(6))
    for method in ALL:
        with pytest.raises(ValueError, match=rf"under 0\.999.*got {rho:.4f} in blue.*lower the albedo"):
            solve(s, METHODS[method], 1e-3)


def test_the_radius_decides_and_not_the_albedo() -> None:
    """White plates in the open bounce little; a room at 0.998 is slow but solved to the tolerance."""
    plates = system_of([[0, 0.2], [0.2, 0]], 0.9999, [[1.0] * 3, [0.0] * 3])
    refuse_slow(plates, estimate_spectrum(plates))
    np.testing.assert_allclose(solve(plates, METHODS["southwell"], 1e-12).radiosity, exact(plates), rtol=1e-10)
    slow = sphere_system(0.998, np.ones((4, 3)), np.ones(4))
    assert solve(slow, METHODS["jacobi"], 1e-6).radiosity == pytest.approx(np.full((4, 3), 500.0), rel=1e-5)


@pytest.mark.parametrize(("rho", "lag"), [(0.5, 7), (0.9, 44), (0.99, 459)])
def test_bounce_count(rho: float, lag: int) -> None:
    assert bounce_count(rho, 0.01) == lag
    assert rho**lag <= 0.01 < rho ** (lag - 1)


@pytest.mark.parametrize(("radius", "tolerance"), [(1.0, 0.1), (-0.1, 0.1), (math.nan, 0.1), (0.5, 0.0), (0.5, 1.0)])
def test_bounce_count_refuses_nonsense(radius: float, tolerance: float) -> None:
    with pytest.raises(ValueError, match="must lie in"):
        bounce_count(radius, tolerance)


# One bounce an update


@pytest.mark.parametrize("rho", [0.5, 0.9, 0.99])
def test_lag_of_one_bounce_behind_a_step_of_light(rho: float) -> None:
    """failure-catalogue B7: light off at steady state leaves ρ^k after k updates, 1 % after 7, 44, 459; light on again
    takes as long, less the bounce that the source itself brings."""
    s = sphere_system(rho, np.ones((5, 3)), np.ones(5))
    state = OneBounce(s, np.full((5, 3), 1.0 / (1.0 - rho)))
    lag, dark = bounce_count(rho, 0.01), np.zeros((5, 3))
    for k in range(1, lag + 1):
        left = state.step(dark)[0, 0] * (1.0 - rho)
        assert left == pytest.approx(rho**k, rel=1e-9)
        assert (left <= 0.01) == (k == lag)
    state = OneBounce(s)
    for _ in range(lag):
        state.step()
    assert state.radiosity == pytest.approx(np.full((5, 3), (1 - rho**lag) / (1 - rho)), rel=1e-9)


def test_one_bounce_under_light_that_changes_every_frame() -> None:
    """B_t = Σ_k M^k S_{t-k}: every frame's light arrives after as many bounces as frames have passed."""
    s = random_system(12, p=20)
    lights = np.random.default_rng(2).random((9, 20, 3))
    state = OneBounce(s)
    assert not state.radiosity.any()
    for light in lights:
        state.step(light)
    expected, carried = np.zeros((20, 3)), list(lights)
    for age, light in enumerate(reversed(carried)):
        for _ in range(age):
            light = s.reflected(light)
        expected += light
    np.testing.assert_allclose(state.radiosity, expected, rtol=1e-12)


def test_one_bounce_as_a_method_is_jacobi_a_frame_behind() -> None:
    """It knows its last change only, which is the residual of the frame before: never too small."""
    s = random_system(7, reciprocal=False)
    frames, gathered = solve(s, METHODS["one-bounce"], 1e-4), solve(s, METHODS["jacobi"], 1e-4)
    assert frames.iterations == gathered.iterations + 1
    np.testing.assert_allclose(frames.history.residual[1:], gathered.history.residual, rtol=1e-9)
    assert true_residual(s, frames.radiosity) < frames.residual


# Bad input


def test_bad_systems_are_refused_by_name() -> None:
    f, ones = np.full((2, 2), 0.5), np.ones((2, 3))
    for albedo in (1.0, -0.1, math.nan, 1.5):
        with pytest.raises(ValueError, match=r"albedo must lie in \[0, 1\)"):
            system_of(f, albedo, ones)
    for light in (math.nan, math.inf):
        with pytest.raises(ValueError, match=r"source must be finite.*at patch 1"):
            system_of(f, 0.5, [[1.0] * 3, [1.0, light, 1.0]])
    with pytest.raises(ValueError, match="area must be > 0"):
        system_of(f, 0.5, ones, [1.0, 0.0])
    with pytest.raises(ValueError, match=r"source must have the shape \(2, 3\), got \(3, 3\)"):
        matrix_system(sparse.csr_array(f), 0.5 * ones, np.ones((3, 3)), np.ones(2))
    with pytest.raises(ValueError, match=r"matrix must have the shape \(3, 3\), got \(2, 2\)"):
        matrix_system(sparse.csr_array(f), np.full((3, 3), 0.5), np.ones((3, 3)), np.ones(3))
    with pytest.raises(ValueError, match="source must have the shape"):
        OneBounce(system_of(f, 0.5, ones)).step(np.ones((3, 3)))


def test_more_than_the_arithmetic_can_give_is_refused() -> None:
    """One bounce an update sums anew in single precision each frame: below its rounding the last change never falls."""
    g, p = surfaces(scene([box((0, 0, 0), (1, 2, 3))], [material(0.9)]), 0.5)
    rng = np.random.default_rng(5)
    source = rng.random((p.count, 3))
    rough = dataclasses.replace(
        matrix_system(patch_form_factors(g, p, 64, 1, silent), p.albedo, source, p.area),
        product=lambda light: (light.mean(axis=0) * (1 + 1e-6 * rng.random((p.count, 3)))).astype(np.float32),
    )
    with pytest.raises(ValueError, match=r"tolerance 1e-09 not reached by one-bounce in \d+ iterations"):
        solve(rough, METHODS["one-bounce"], 1e-9)
