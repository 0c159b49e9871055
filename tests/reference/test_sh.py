"""Spherical harmonics against published values and exact integrals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference import sh
from small_scenes import random_units


def quadrature(n: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Directions and weights exact for polynomials to degree 2 n - 1: Gauss in z, trapezoid in φ."""
    z, wz = np.polynomial.legendre.leggauss(n)
    phi = np.arange(2 * n) * math.pi / n
    zz, pp = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1 - zz**2)
    d = np.stack([r * np.cos(pp), r * np.sin(pp), zz], axis=-1).reshape(-1, 3)
    return d, np.repeat(wz, 2 * n) * math.pi / n


def test_basis_is_the_published_one(published: dict[str, Any]) -> None:
    case = published["sh_basis_values"]
    for row in case["cases"]:
        np.testing.assert_allclose(sh.basis(np.array(row["direction"])), row["Y"][:4], atol=1e-12)
        np.testing.assert_allclose(sh.basis(np.array(row["direction"]), 2), row["Y"][:9], atol=1e-12)


def test_basis_is_orthonormal() -> None:
    d, w = quadrature()
    y = sh.basis(d, 2)
    np.testing.assert_allclose(np.einsum("n,ni,nj->ij", w, y, y), np.eye(9), atol=1e-13)
    np.testing.assert_array_equal(sh.basis(d), y[:, :4])


def test_cosine_lobe_is_the_published_one(published: dict[str, Any]) -> None:
    exact = published["sh_cosine_lobe_A_l"]["A_l"]
    assert exact[:3] == pytest.approx([sh.COSINE_A0, sh.COSINE_A1, sh.COSINE_A2], abs=1e-13)


def test_constant_and_linear_radiance_give_exact_irradiance() -> None:
    """L = a + b·ω: E(n) = π a + 2π/3 b·n."""
    d, w = quadrature()
    a, b = (
        np.array([1.0, 0.4, 2.0]),
        np.array([[0.3, -0.2, 0.5], [0.1, 0.9, -0.4], [-0.7, 0.2, 0.1]]),
    )  # b: colour, axis
    radiance = a + d @ b.T
    coefficients = np.einsum("n,nk,nc->kc", w, sh.basis(d), radiance)
    normals = random_units(50, 1)
    expected = math.pi * a + 2 * math.pi / 3 * normals @ b.T
    np.testing.assert_allclose(sh.irradiance(coefficients[None].repeat(50, 0), normals), expected, atol=1e-12)


def test_quadratic_radiance_gives_exact_irradiance() -> None:
    """L = (a·ω)²: E(n) = π/4 (|a|² + (a·n)²), from ∫ ω_i ω_j max(n·ω, 0) = π/4 (δ_ij + n_i n_j)."""
    d, w = quadrature()
    a = np.array([0.8, -0.5, 1.3])
    coefficients = np.repeat((w * (d @ a) ** 2 @ sh.basis(d, 2))[:, None], 3, axis=1)
    normals = random_units(50, 5)
    expected = math.pi / 4.0 * (a @ a + (normals @ a) ** 2)
    got = sh.irradiance(coefficients[None].repeat(50, 0), normals)
    np.testing.assert_allclose(got, np.repeat(expected[:, None], 3, axis=1), atol=1e-12)


def test_only_four_or_nine_coefficients() -> None:
    assert [sh.order_of(sh.coefficient_count(order)) for order in (1, 2)] == [1, 2]
    with pytest.raises(ValueError, match="must have 4 or 9 coefficients, got 5"):
        sh.irradiance(np.zeros((5, 3)), np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize(
    "name", ["sh_env_hemisphere_sky", "sh_env_cap_30deg", "sh_env_cap_60deg", "sh_env_directional", "sh_rect_light_offaxis"]
)  # fmt: skip
def test_irradiance_of_published_environments(published: dict[str, Any], name: str) -> None:
    case = published[name]
    for name, count in (("L1", 4), ("L2", 9)):
        coefficients = np.repeat(np.array(case["L_coeffs"][:count])[:, None], 3, axis=1)
        for row in case["cases"]:
            got = sh.irradiance(coefficients, np.array(row["normal"]))
            np.testing.assert_allclose(got, row["E_sh"][name], atol=max(1e-11, 10 * case["tolerance"]))


def test_directional_coefficients_are_the_basis_at_the_direction(published: dict[str, Any]) -> None:
    direction = np.array([2.0, 3.0, 6.0]) / 7.0
    np.testing.assert_allclose(sh.basis(direction), published["sh_env_directional"]["L_coeffs"][:4], atol=1e-12)


def test_any_leading_shape() -> None:
    d = random_units(24, 2).reshape(2, 3, 4, 3)
    assert sh.basis(d).shape == (2, 3, 4, 4)
    assert sh.irradiance(np.ones((2, 3, 4, 4, 3)), d).shape == (2, 3, 4, 3)
