"""Radiosity against closed forms and published solutions, its convergence, and the light tags."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.datatypes import Scene, Sky
from lightgauge.reference.errors import InputError
from lightgauge.reference.progress import silent
from lightgauge.reference.sky import SKY_BINS
from lightgauge.reference.transport.form_factors import patch_form_factors
from lightgauge.reference.transport.gather import upload
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.transport.radiosity import Radiosity, solve
from lightgauge.reference.transport.reconcile import reconcile
from lightgauge.reference.transport.solvers import METHODS
from lightgauge.reference.transport.spectral import Spectrum
from lightgauge.reference.truth.analytic import closed_sphere_radiosity
from small_scenes import box, box_quads, material, polygon_mesh, quad, scene, sphere_mesh, surfaces


def solved(s: Scene, size: float, rays: int = 1024, tolerance: float = 1e-6) -> tuple[Patches, Radiosity, Any]:
    g, p = surfaces(s, size)
    rows = upload(patch_form_factors(g, p, rays, 1, silent))
    return p, solve(s, p, rows, np.zeros((p.count, 3)), tolerance), g


def by_mesh(p: Patches, g: Any, values: np.ndarray, meshes: int) -> np.ndarray:
    """Area mean (meshes, 3) of patch values."""
    owner = np.zeros(p.front, int)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    weight = p.area[: p.front]
    return np.stack(
        [weight[owner == i] @ values[: p.front][owner == i] / weight[owner == i].sum() for i in range(meshes)]
    )


@pytest.mark.parametrize("rho", [0.5, 0.9, 0.99])
def test_furnace(rho: float) -> None:
    """Closed box, uniform emission: B = E / (1 - ρ) in every patch, whatever the form factors' noise (rows sum to 1).
    Jacobi: the change after k steps is ρ^k; steps to 1e-4 of the source are ln 1e-4 / ln ρ (failure-catalogue B1)."""
    _, r, _ = solved(scene([box((0, 0, 0), (1, 2, 3), emission=1 / math.pi)], [material(rho)]), 0.5, 256, 1e-4)
    np.testing.assert_allclose(r.radiosity, 1 / (1 - rho), rtol=1.5e-4)
    np.testing.assert_allclose(r.irradiance, 1 / (1 - rho), rtol=1.5e-4)
    steps = math.log(1e-4) / math.log(rho)
    assert r.iterations == pytest.approx(steps, abs=2 + 0.02 * steps)
    assert r.residual <= 1e-4


def test_albedo_near_one_converges() -> None:
    """ρ = 0.998: E / (1 - ρ) = 500 after the 5,751 bounces that the spectral radius foretells."""
    _, r, _ = solved(scene([box((0, 0, 0), (1, 1, 1), emission=1 / math.pi)], [material(0.998)]), 1.0, 64, 1e-5)
    np.testing.assert_allclose(r.radiosity, 500.0, rtol=1e-4)
    assert r.spectral_radius == pytest.approx(0.998, abs=1e-6)
    assert r.bounces == pytest.approx(math.log(1e-5) / math.log(0.998), rel=1e-3)
    assert r.iterations == pytest.approx(r.bounces, rel=1e-3)


@pytest.mark.parametrize("rho", [0.999, 0.9999])
def test_a_furnace_that_never_cools_is_refused(rho: float) -> None:
    with pytest.raises(ValueError, match=rf"under 0\.999.*got {rho:.4f}.*lower the albedo"):
        solved(scene([box((0, 0, 0), (1, 1, 1), emission=1.0)], [material(rho)]), 1.0, 64)


def test_the_pipeline_names_the_scene_that_never_cools() -> None:
    with pytest.raises(InputError, match=r"scene 'test'.*under 0\.999"):
        pipeline_light(scene([box((0, 0, 0), (1, 1, 1), emission=1.0)], [material(0.9995)]), patch_size=0.5)


def test_white_walls_under_the_open_sky_are_solved() -> None:
    """The spectral radius decides, not the albedo: half of the light of a white corner leaves at each bounce."""
    corner = [quad(q) for q in box_quads((0, 0, 0), (1, 1, 1))[:3]]
    _, r, _ = solved(scene(corner, [material(0.9995)], Sky(np.ones((1, 1, 3), np.float32), 0.0, False)), 0.5)
    assert 0.2 < r.spectral_radius < 0.6 and r.iterations <= r.bounces
    assert (r.radiosity < math.pi).all() and (r.radiosity > 0.9 * math.pi).all()


@pytest.mark.parametrize("method", sorted(METHODS))
def test_methods_agree_on_a_scene(method: str) -> None:
    """The same room by every method, lit by the sky, an emitter and direct light."""
    walls = [
        quad(q, mat=i % 2, emission=0.3 * float(i == 0)) for i, q in enumerate(box_quads((0, 0, 0), (1, 2, 3))[:5])
    ]
    s = scene(walls, [material((0.8, 0.5, 0.1)), material(0.6)], Sky(np.float32([[[1, 2, 3]]]), 0.0, False))
    g, p = surfaces(s, 0.5)
    rows = patch_form_factors(g, p, 256, 1, silent)
    direct = np.random.default_rng(1).random((p.count, 3))
    r = solve(s, p, upload(rows), direct, 1e-6, METHODS[method], rows)
    light = np.concatenate([r.radiosity, np.tile(np.pi * np.array([1.0, 2.0, 3.0]), (SKY_BINS, 1)), np.zeros((1, 3))])
    incident = direct + rows.matrix().astype(np.float64) @ light
    np.testing.assert_allclose(r.radiosity, p.exitance + p.albedo * incident, rtol=1e-5)
    assert r.residual <= 1e-6


def test_methods_that_walk_rows_ask_for_them() -> None:
    s = scene([box((0, 0, 0), (1, 1, 1), emission=1.0)])
    g, p = surfaces(s, 0.5)
    rows = upload(patch_form_factors(g, p, 64, 1, silent))
    with pytest.raises(ValueError, match="southwell walks single rows of F and needs the matrix"):
        solve(s, p, rows, np.zeros((p.count, 3)), 1e-4, METHODS["southwell"])


def test_spectrum_of_an_earlier_solution_is_taken_as_it_is() -> None:
    """It does not depend on the lights: a relight passes it on, and no product is spent on it."""
    s = scene([box((0, 0, 0), (1, 1, 1), emission=1.0)])
    g, p = surfaces(s, 0.5)
    rows = upload(patch_form_factors(g, p, 64, 1, silent))
    known = Spectrum(0.77, 0.76, 0.78, 0, 1.0, 3)
    r = solve(s, p, rows, np.zeros((p.count, 3)), 1e-4, spectrum=known)
    assert r.spectral_radius == 0.78 and r.bounces == math.ceil(math.log(1e-4) / math.log(0.78))
    np.testing.assert_allclose(r.radiosity, 2.0 * math.pi, rtol=2e-4)


def test_no_albedo_no_bounce() -> None:
    walls = [quad(q, mat=int(i == 5), emission=float(i == 5)) for i, q in enumerate(box_quads((0, 0, 0), (1, 1, 1)))]
    p, r, g = solved(scene(walls, [material(0.0), material(0.0)]), 0.5)
    np.testing.assert_allclose(by_mesh(p, g, r.radiosity, 6), np.diag([0, 0, 0, 0, 0, math.pi])[:, [5] * 3], atol=1e-12)
    assert r.iterations <= 2


@pytest.mark.parametrize("rho", [0.3, 0.8])
def test_closed_sphere(rho: float) -> None:
    """Emission on a cap: B = E + ρ Ē / (1 - ρ) everywhere (Ē over the facetted area). 1,024 rays a patch see the cap with
    a standard error of √(f (1 - f)/1024)/f; rms over patches under it (a bound, since rays are stratified)."""
    ball = sphere_mesh(1.0, 3)
    cap = ball.vertices[ball.faces].mean(axis=1)[:, 2] > math.cos(math.radians(30))
    parts = [
        polygon_mesh(ball.vertices, ball.faces[m].tolist(), mat=0, emission=float(i == 0))
        for i, m in enumerate((cap, ~cap))
    ]
    p, r, _ = solved(scene(parts, [material(rho)]), 0.25)
    exact = closed_sphere_radiosity(p.area, p.albedo, p.exitance)
    f = 0.5 * (1 - math.cos(math.radians(30)))
    incident = (exact - p.exitance) / rho
    relative = (r.irradiance - incident) / incident
    assert abs(p.area @ relative[:, 0] / p.area.sum()) < 0.01
    assert relative.std() < math.sqrt((1 - f) / f / 1024)


def test_closed_form_of_the_sphere(published: dict[str, Any]) -> None:
    """Ours against the published: cap of 30°, ρ = 0.8."""
    f = 0.5 * (1 - math.cos(math.radians(30)))
    case = published["sphere_polar_cap_emitter_rho0.8"]["solution"]["B_at"]
    got = closed_sphere_radiosity(np.array([f, 1 - f]), np.full((2, 3), 0.8), np.array([[1.0] * 3, [0.0] * 3]))
    np.testing.assert_allclose(got, np.array([case["cap"], case["rest"]])[:, None].repeat(3, 1), rtol=1e-12)
    with pytest.raises(ValueError, match="one albedo"):
        closed_sphere_radiosity(np.ones(2), np.array([[0.5] * 3, [0.6] * 3]), np.ones((2, 3)))


def test_energy_balance_of_a_closed_room() -> None:
    """What is emitted is absorbed, Σ A ((1 - ρ) H - E) = 0 (failure-catalogue B3), as far as the form factors are
    reciprocal: 2,048 rays of each of 276 patches leave about 1e-3, reconciled ones under 1e-4."""
    walls = [quad(q, mat=i % 2, emission=float(i == 3)) for i, q in enumerate(box_quads((0, 0, 0), (1, 2, 3)))]
    s = scene(walls, [material(0.3), material(0.7)])
    g, p = surfaces(s, 0.3)
    raw = patch_form_factors(g, p, 2048, 1, silent)
    for rows, limit in ((raw, 5e-3), (reconcile(raw, p.area).rows, 1e-4)):
        r = solve(s, p, upload(rows), np.zeros((p.count, 3)), 1e-7)
        np.testing.assert_allclose(r.radiosity - p.albedo * r.irradiance, p.exitance, atol=1e-5)
        defect = p.area @ (r.irradiance * (1 - p.albedo) - p.exitance)
        assert np.abs(defect / (p.area @ p.exitance)).max() < limit
        assert r.energy_residual < limit


def test_energy_residual_tells_what_is_wrong() -> None:
    """Form factors that are not reciprocal make or lose light; the residual is that share of what came in."""
    s = scene([box((0, 0, 0), (1, 2, 3), emission=1 / math.pi)], [material(0.5)])
    g, p = surfaces(s, 0.5)
    raw = reconcile(patch_form_factors(g, p, 256, 1, silent), p.area).rows
    bent = raw.values.copy()
    towards = raw.columns < p.count // 2
    bent[towards] *= 1.1
    row = np.repeat(np.arange(p.count), np.diff(raw.indptr))
    bent[:, 0] /= np.bincount(row, bent[:, 0])[row]  # rows still sum to one: only reciprocity is broken
    dim = dataclasses.replace(p, exitance=p.exitance * (np.arange(p.count) < p.count // 2)[:, None])
    r = solve(s, dim, upload(dataclasses.replace(raw, values=bent.astype(np.float32))), np.zeros((p.count, 3)), 1e-7)
    defect = p.area @ (r.irradiance * (1 - p.albedo) - dim.exitance) / (p.area @ dim.exitance)
    assert abs(defect[0]) > 5e-3
    np.testing.assert_allclose(r.energy_residual, np.abs(defect).max(), rtol=1e-3)


def test_sky_over_an_open_floor() -> None:
    """H = π L; B = ρ π L; and what a receiver sees of the sky obeys its tag."""
    floor = quad([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]])
    for engine in (False, True):
        s = scene([floor], [material(0.5)], Sky(np.float32([[[1, 2, 3]]]), 0.0, engine))
        p, r, _ = solved(s, 0.5)
        np.testing.assert_allclose(r.radiosity, np.tile(0.5 * np.pi * np.array([1, 2, 3]), (p.count, 1)), rtol=1e-5)
        expected = 0.0 if engine else np.pi * np.array([1, 2, 3])
        np.testing.assert_allclose(r.light[p.count : -1], np.broadcast_to(expected, (SKY_BINS, 3)), rtol=1e-6)
        assert not r.light[-1].any()


def lamp_room(tag: str) -> Scene:
    """A cube with a lamp of radiance 1 that hangs under its ceiling."""
    lamp = quad(
        [[0.3, 0.9, 0.3], [0.7, 0.9, 0.3], [0.7, 0.9, 0.7], [0.3, 0.9, 0.7]],
        mat=1,
        emission=1.0,
        engine=tag == "engine",
    )
    return scene([box((0, 0, 0), (1, 1, 1)), lamp], [material(0.5), material(0.0)])


def pipeline_light(s: Scene, **settings: Any) -> tuple[pipeline.Surfaces, pipeline.PatchLight]:
    radiosity = {"patch_size": 0.2, "rays": 1024, "shadow_rays": 256, **settings}
    made = Scene(
        **{**vars(s), "settings": s.settings.model_validate({**s.settings.model_dump(), "radiosity": radiosity})}
    )
    surfaces_ = pipeline.bake_surfaces(made, 1)
    return surfaces_, pipeline.light_patches(made, surfaces_, 1)


def test_area_lamp_by_tag() -> None:
    """The same lamp: total light alike; what receivers may see lacks the lamp's own exitance if it is the engine's."""
    found = {}
    for tag in ("engine", "input"):
        surfaces_, light = pipeline_light(lamp_room(tag), rays=8192)
        p, r = surfaces_.patches, light.radiosity
        own = (p.exitance if tag == "input" else p.engine_exitance)[:, 0] > 0
        found[tag] = (p, r, own)
    p, engine, own = found["engine"]
    _, given, _ = found["input"]
    assert (p.area[own] @ p.engine_exitance[own])[0] == pytest.approx(0.16 * math.pi)
    area, walls = p.area / p.area.sum(), ~own
    np.testing.assert_allclose(area @ engine.irradiance, area @ given.irradiance, rtol=0.01)
    np.testing.assert_allclose(
        area[walls] @ engine.light[: p.count][walls], area[walls] @ given.light[: p.count][walls], rtol=0.01
    )
    np.testing.assert_allclose(engine.light[: p.count][own], 0.0, atol=1e-12)
    np.testing.assert_allclose(given.light[: p.count][own], math.pi, rtol=1e-6)
    # the light of the first bounce alone is at least ρ × what arrives: nothing was left out of `light`
    np.testing.assert_allclose(engine.light[: p.count][walls], (p.albedo * engine.irradiance)[walls], rtol=1e-4)


@pytest.mark.parametrize("kind", ["point", "spot", "directional"])
def test_punctual_light_bounces_whatever_its_tag(kind: str) -> None:
    """The tag says who shows the *direct* light. Light reflected by the patches is the same for `engine` and `input`."""
    lights: dict[str, dict[str, Any]] = {
        "point": {"type": "point", "position": (0.5, 0.6, 0.5), "intensity": (1, 1, 1)},
        "spot": {"type": "spot", "position": (0.5, 0.6, 0.5), "direction": (0, -1, 0), "intensity": (1, 1, 1)},
        "directional": {"type": "directional", "direction": (0.1, -1, 0.2), "irradiance": (1, 1, 1)},
    }
    reflected = []
    for tag in ("engine", "input"):
        walls = [quad(q) for i, q in enumerate(box_quads((0, 0, 0), (1, 1, 1))) if i != 3]
        _, light = pipeline_light(scene(walls, lights={"l": {**lights[kind], "tag": tag}}))
        reflected.append(light.radiosity.radiosity)
    assert reflected[0].mean() > 0.01
    np.testing.assert_allclose(reflected[1], reflected[0], rtol=1e-6)


def test_two_sided_sheet_is_lit_from_its_back() -> None:
    """failure-catalogue A9: a floor lit from below reflects downwards only."""
    sheet = quad([[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]])
    glow = quad([[-4, 0, -4], [-4, 0, 5], [5, 0, 5], [5, 0, -4]], mat=1, emission=1.0)
    p, r, _ = solved(scene([sheet, glow], [material(0.5, two_sided=True), material(0.0)]), 20.0, 1 << 14)
    back = p.front + np.flatnonzero(p.twin[p.front :] >= 0)
    top = p.twin[back[0]]
    assert r.radiosity[top, 0] == 0.0
    # point over the middle of the sheet: nearly the whole lower hemisphere glows
    assert r.radiosity[back[0], 0] == pytest.approx(0.5 * math.pi, rel=0.06)
