"""Probes and spherical harmonics against the published answers and closed forms of the same kinds.

Coefficients by rays come from REPLICATES probes (or points) at one place, each with its own randomisation; the standard
error is that of their mean. Everything by rays must lie within what these leave to chance. Probes are traced with SH of order 2, whose
first four coefficients are those of order 1; what the published entries say beyond has no counterpart here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from chance import standard_errors
from lightgauge.reference import pipeline
from lightgauge.reference.config import DirectionalLight
from lightgauge.reference.datatypes import Mesh, Scene, Sky
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import COSINE_A0, COSINE_A1, COSINE_A2, Y0, Y1, Y20, basis, irradiance, irradiance_weights
from lightgauge.reference.sky import SKY_BINS, bin_radiance
from lightgauge.reference.transport.form_factors import FormFactors, point_form_factors, probe_form_factors
from lightgauge.reference.transport.patches import Patches
from lightgauge.reference.visibility import build_geometry
from small_scenes import box_quads, material, mesh, quad, scene, sphere_mesh, surfaces

Array = npt.NDArray[np.float64]
Light = Callable[[Patches], Array]
REPLICATES, RAYS = 32, 4096
RIM = 512  # corners of a disc
HORIZON = 4e-4  # a ramp of π/1023 over the horizon, spread over bins of 0.2 rad, takes 2.4e-4 from L10 and E


def light_of(s: Scene, p: Patches) -> Array:
    """What columns carry when nothing reflects: exitance, the sky, nothing."""
    return np.concatenate([p.exitance, np.pi * bin_radiance(s.sky), np.zeros((1, 3))])


def gathered_by(rows: FormFactors, light: Array) -> Array:
    """What each replicate gathers (REPLICATES, K) of light's red."""
    return np.stack([rows.matrix(k) @ light[:, 0] for k in range(rows.values.shape[1])], axis=1)


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Mean over replicates, the first axis, and its standard error."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(len(values))


def probe_at(s: Scene, position: Any, light: Light | None = None) -> tuple[Array, Array]:
    """Radiance SH (9,) of a probe, with standard errors."""
    return mean_and_error(probes_at(s, position, light))


def probes_at(s: Scene, position: Any, light: Light | None = None) -> Array:
    """Radiance SH (REPLICATES, 9) of a probe. The coefficients of one replicate have their rays in common, so what is made of them has
    the error of what is made of each replicate, not the root of the sum of theirs."""
    g, p = surfaces(s, 1e6)
    rows = probe_form_factors(g, p, np.tile(np.asarray(position, float), (REPLICATES, 1)), RAYS, 5, silent, 2)
    return gathered_by(rows, light_of(s, p) if light is None else light(p))


def gathered_at(s: Scene, position: Any, normal: Any, light: Array | None = None) -> tuple[float, float]:
    """Irradiance at a surface element by rays, with its standard error."""
    g, p = surfaces(s, 1e6)
    light = light_of(s, p) if light is None else light
    place, up = (np.tile(np.asarray(v, float), (REPLICATES, 1)) for v in (position, normal))
    mean, error = mean_and_error(gathered_by(point_form_factors(g, p, place, up, RAYS, 6, silent), light))
    return float(mean[0]), float(error[0])


def assert_within(got: Any, error: Any, expected: Any, known: float = 0.0, times: int = 1) -> None:
    """Within the standard errors of REPLICATES runs, the rounding of a sum of 4,096 numbers in single precision, and a `known` bias.
    times: how often a test asks this."""
    away = standard_errors(REPLICATES, times * np.size(expected))
    allowed = away * np.asarray(error) + 2e-6 * (1.0 + np.abs(expected)) + known
    np.testing.assert_array_less(np.abs(np.asarray(got) - expected), allowed)


def disc(half_angle: float) -> Mesh:
    """A disc of radiance 1 at z = 1 that the origin sees under this half angle (degrees); 512 corners, area exact."""
    turn = 2.0 * math.pi / RIM
    radius = math.tan(math.radians(half_angle)) * math.sqrt(turn / math.sin(turn))
    angle = -turn * np.arange(RIM)  # clockwise from above: it shines downwards
    corners = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(RIM)])
    fan = [(RIM, i, (i + 1) % RIM) for i in range(RIM)]
    return mesh(np.vstack([corners, [0.0, 0.0, 1.0]]), fan, emission=1.0)


def sky_over_y() -> Scene:
    """Radiance 1 above the horizon (y up), and two specks of dust, without which there is no scene. The picture's step is
    a ramp of one row, which the sky's bins spread over 0.2 rad."""
    image = np.zeros((1024, 1, 3), dtype=np.float32)
    image[:512] = 1.0
    specks = [quad([[x, 0, 0], [x, 0, 1e-4], [x + 1e-4, 0, 1e-4], [x + 1e-4, 0, 0]]) for x in (-5.0, 5.0)]
    return scene(specks, [material(0.0)], Sky(image, 0.0, False))


def cycled(v: Any) -> Array:
    """The published z is our y (up): (x, y, z) -> (y, z, x)."""
    return np.asarray(v, float)[..., [1, 2, 0]]


ENVIRONMENTS: dict[str, Callable[[dict[str, Any]], Scene]] = {
    "sh_env_cap_30deg": lambda case: scene([disc(30.0)], [material(0.0)]),
    "sh_env_cap_60deg": lambda case: scene([disc(60.0)], [material(0.0)]),
    "sh_rect_light_offaxis": lambda case: scene([quad(case["light"], emission=1.0)], [material(0.0)]),
}
ALL_ENVIRONMENTS = [*ENVIRONMENTS, "sh_env_hemisphere_sky", "sh_env_directional"]


# The representation, without rays


def test_basis(published: dict[str, Any]) -> None:
    case = published["sh_basis_values"]
    for entry in case["cases"]:
        np.testing.assert_allclose(basis(np.array(entry["direction"]), 2), entry["Y"][:9], atol=case["tolerance"])


def test_cosine_lobe(published: dict[str, Any]) -> None:
    """A0, A1, A2, and that L1 holds 7/8 of the clamped cosine's energy, L2 127/128: Σ (2l + 1)/4π A_l² over ∫ cos² = 2π/3."""
    case = published["sh_cosine_lobe_A_l"]
    lobes = [COSINE_A0, COSINE_A1, COSINE_A2]
    np.testing.assert_allclose(lobes, case["A_l"][:3], rtol=case["tolerance"])
    energy = np.cumsum([(2 * band + 1) * a * a for band, a in enumerate(lobes)]) / (4 * math.pi) / (2 * math.pi / 3)
    expected = [case["energy_fraction_cumulative"][f"L{band}"] for band in range(3)]
    np.testing.assert_allclose(energy, expected, rtol=1e-12)


def test_ramamoorthi_constants(published: dict[str, Any]) -> None:
    """E(n) = c1 L22 (x² - y²) + c3 L20 z² + c4 L00 - c5 L20 + 2 c1 (L2-2 xy + L21 xz + L2-1 yz) + 2 c2 (L11 x + L1-1 y + L10 z)
    (their eq. 13); theirs of order 2 hold the basis without its own constants, as ours do."""
    case = published["sh_ramamoorthi_constants"]
    for n in (np.array([0.6, 0.0, 0.8]), np.array([2.0, -3.0, -6.0]) / 7.0):
        w, (x, y, z) = irradiance_weights(n, 2), n
        for constants, tolerance in ((case["exact_values"], case["tolerance"]), (case["published"], 2.2e-6)):
            c1, c2, c3, c4, c5 = (constants[f"c{i}"] for i in range(1, 6))
            second = [2 * c1 * x * y, 2 * c1 * y * z, c3 * z * z - c5, 2 * c1 * x * z, c1 * (x * x - y * y)]
            np.testing.assert_allclose(w, [c4, *(2 * c2 * n[[1, 2, 0]]), *second], atol=tolerance)


@pytest.mark.parametrize("name", ALL_ENVIRONMENTS)
def test_irradiance_of_published_coefficients(published: dict[str, Any], name: str) -> None:
    """What perfect L1 and L2 projections give, which is not the exact irradiance but for the hemisphere."""
    case = published[name]
    for band, count in (("L1", 4), ("L2", 9)):
        coefficients = np.repeat(np.array(case["L_coeffs"][:count])[:, None], 3, axis=1)
        for entry in case["cases"]:
            got = irradiance(coefficients, np.array(entry["normal"]))
            np.testing.assert_allclose(got, entry["E_sh"][band], atol=max(1e-12, case["tolerance"]))


# Through rays


@pytest.mark.parametrize("name", list(ENVIRONMENTS))
def test_probe_under_a_light(published: dict[str, Any], name: str) -> None:
    """Coefficients, and from them the L1 and L2 irradiance at every published normal."""
    case = published[name]
    values = probes_at(ENVIRONMENTS[name](case), (0.0, 0.0, 0.0))
    got, error = mean_and_error(values)
    assert_within(got, error, case["L_coeffs"][:9])
    assert (error[[0, 2]] < 2e-3 * got[[0, 2]]).all()  # a test that can fail
    assert (error[4:] < 4e-3 * got[0]).all()
    for entry in case["cases"]:
        w = irradiance_weights(np.array(entry["normal"]), 2)
        for band, v in (("L1", np.where(np.arange(9) < 4, w, 0.0)), ("L2", w)):
            assert_within(*mean_and_error(values @ v), entry["E_sh"][band], times=2 * len(case["cases"]))


@pytest.mark.parametrize("name", list(ENVIRONMENTS))
def test_point_under_a_light(published: dict[str, Any], name: str) -> None:
    """The exact irradiance, horizon and all; zero where there is none. Where fewer than 20 rays can hit, their spread
    says nothing and the binomial error of the exact answer stands in."""
    case = published[name]
    s = ENVIRONMENTS[name](case)
    for entry in case["cases"]:
        exact = entry["E_exact"]
        got, error = gathered_at(s, (0.0, 0.0, 0.0), entry["normal"])
        share, rays = exact / math.pi, REPLICATES * RAYS
        if exact == 0.0:
            assert got == 0.0
        elif share * rays < 20:
            assert_within(got, math.pi * math.sqrt(share / rays), exact)
        else:
            assert_within(got, error, exact)
            assert error < 0.01 * exact + 1e-4


def test_probe_and_point_under_half_a_sky(published: dict[str, Any]) -> None:
    """Through the image sky and its bins: here L1 is exact for every normal, and L2 the same."""
    case = published["sh_env_hemisphere_sky"]
    s = sky_over_y()
    light = light_of(s, surfaces(s, 1e6)[1])
    values = probes_at(s, (0.0, 0.0, 0.0), lambda p: light)
    got, error = mean_and_error(values)
    assert_within(got, error, [case["L_coeffs"][0], case["L_coeffs"][2], *7 * [0.0]], HORIZON)
    for entry in case["cases"]:
        normal = cycled(entry["normal"])
        w = irradiance_weights(normal, 2)
        assert_within(*mean_and_error(values @ w), entry["E_exact"], HORIZON)
        assert_within(*gathered_at(s, (0.0, 0.0, 0.0), normal, light), entry["E_exact"], HORIZON)


def test_probe_under_the_sun(published: dict[str, Any]) -> None:
    """A directional light tagged `input` enters the probes without rays: coefficients are Y(d), exactly."""
    case = published["sh_env_directional"]
    towards = np.array([2.0, 3.0, 6.0]) / 7.0
    sun = DirectionalLight.model_validate(
        {"type": "directional", "direction": (-towards).tolist(), "irradiance": (1, 1, 1), "tag": "input"}
    )
    s = scene([quad([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]])], lights={"sun": sun.model_dump()})
    for order, band, count in ((1, "L1", 4), (2, "L2", 9)):
        got = pipeline.punctual_input(s, build_geometry(s), np.zeros((1, 3)), order)[0]
        np.testing.assert_allclose(got, np.repeat(np.array(case["L_coeffs"][:count])[:, None], 3, axis=1), rtol=1e-6)
        for entry in case["cases"]:
            np.testing.assert_allclose(irradiance(got, np.array(entry["normal"])), entry["E_sh"][band], atol=1e-6)


def test_probe_in_a_cube_with_one_bright_wall(published: dict[str, Any]) -> None:
    """Its coefficients, and from them the L2 irradiance; what each axis receives; and that the six walls together are a uniform
    surround."""
    case = published["sh_probe_cube_center_one_wall"]
    walls = [quad(q, emission=float(i == 5)) for i, q in enumerate(box_quads((0, 0, 0), (1, 1, 1)))]
    s, centre = scene(walls, [material(0.0)]), (0.5, 0.5, 0.5)
    values = probes_at(s, centre)
    got, error = mean_and_error(values)
    assert_within(got, error, case["L_coeffs"][:9])
    assert (error[[0, 2]] < 2e-3 * got[[0, 2]]).all()
    axes = {f"{'xyz'[a]}{'-+'[k]}": (2 * k - 1) * np.eye(3)[a] for a in range(3) for k in (0, 1)}
    for name, normal in axes.items():
        assert_within(*gathered_at(s, centre, normal), case["E_axis_exact"][name])
        w = irradiance_weights(normal, 2)
        assert_within(*mean_and_error(values @ w), case["E_sh_L2_axis"][name])
    value, spread = gathered_at(s, centre, axes["z+"])
    assert_within(value / math.pi, spread / math.pi, case["F_point_to_facing_wall"])
    total, _ = probe_at(
        s, centre, lambda p: np.concatenate([np.full((p.count, 3), math.pi), np.zeros((SKY_BINS + 1, 3))])
    )
    assert_within(total, [1e-5, *8 * [1e-3]], [4 * math.pi * Y0, *8 * [0.0]])


# Closed forms of the same kinds


@pytest.mark.parametrize("half_angle", [2.0, 10.0, 45.0, 75.0, 85.0])
def test_caps(half_angle: float) -> None:
    """Cone of radiance 1 about +z, cosine c of its half angle: L00 = 2π Y0 (1 - c), L10 = π Y1 (1 - c²),
    L20 = 2π Y20 (c - c³); irradiance of the facing element π (1 - c²)."""
    s, c = scene([disc(half_angle)], [material(0.0)]), math.cos(math.radians(half_angle))
    got, error = probe_at(s, (0.0, 0.0, 0.0))
    second = [0.0, 0.0, 2 * math.pi * Y20 * (c - c**3), 0.0, 0.0]
    assert_within(got, error, [2 * math.pi * Y0 * (1 - c), 0.0, math.pi * Y1 * (1 - c * c), 0.0, *second])
    assert_within(*gathered_at(s, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), math.pi * (1 - c * c))


def test_uniform_surround() -> None:
    """Anywhere inside any closed shape of radiance 1: L00 = √4π, no higher band, irradiance π for every normal."""
    s = scene([sphere_mesh(1.0, 2, emission=1.0)], [material(0.0)])
    for position in ((0.0, 0.0, 0.0), (0.5, -0.2, 0.6)):
        got, error = probe_at(s, position)
        assert_within(got, error, [math.sqrt(4 * math.pi), *8 * [0.0]])
        for normal in ((0.0, 1.0, 0.0), (0.6, 0.0, 0.8)):
            assert gathered_at(s, position, normal)[0] == pytest.approx(math.pi, rel=1e-6)


def test_parallel_walls_cancel_in_the_odd_band() -> None:
    """failure-catalogue C3: two facing lights alike give L1 nothing but the mean; both walls' L00 and band 2 add."""
    one, two = (
        scene(
            [quad(q, emission=float(i in lit)) for i, q in enumerate(box_quads((0, 0, 0), (1, 1, 1)))], [material(0.0)]
        )
        for lit in ((5,), (4, 5))
    )
    (single, e1), (double, e2) = probe_at(one, (0.5, 0.5, 0.5)), probe_at(two, (0.5, 0.5, 0.5))
    assert_within(double, np.hypot(2 * e1, e2), [2 * single[0], 0.0, 0.0, 0.0, *2 * single[4:]])


def test_polygon_light_does_not_depend_on_its_cuts() -> None:
    """The same rectangle as one quad and as seven triangles about a point off its middle."""
    whole = [[-0.5, -0.25, 0.5], [-0.5, 0.75, 0.5], [1.5, 0.75, 0.5], [1.5, -0.25, 0.5]]
    ring = [whole[0], whole[1], [0.1, 0.75, 0.5], whole[2], whole[3], [1.4, -0.25, 0.5], [-0.2, -0.25, 0.5]]
    fan = mesh([*ring, [0.7, 0.1, 0.5]], [(7, i, (i + 1) % 7) for i in range(7)], emission=1.0)
    (a, ea), (b, eb) = (probe_at(scene([m], [material(0.0)]), (0, 0, 0)) for m in (quad(whole, emission=1.0), fan))
    assert_within(a, np.hypot(ea, eb), b)
