"""Rays that gather at points, against the same integrals through form-factor rows and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.progress import silent
from lightgauge.reference.sh import irradiance
from lightgauge.reference.transport.form_factors import point_form_factors, probe_form_factors
from lightgauge.reference.transport.hits import upload_patches
from lightgauge.reference.transport.ray_gather import ray_gather
from small_scenes import box, random_units, scene, surfaces

G, P = surfaces(scene([box((0, 0, 0), (2, 3, 4))]), 0.7)
DEVICE = upload_patches(G, P)
WHERE = np.random.default_rng(1).uniform((0.3, 0.3, 0.3), (1.7, 2.7, 3.7), (40, 3))
NORMALS = random_units(40, 2)
LIGHT = np.random.default_rng(3).random((DEVICE.columns, 3))


def test_light_from_all_around_is_exact_at_order_two() -> None:
    """Radiance 1/π everywhere: irradiance 1 at any normal, L00 = √4π / π and no other coefficient, within the rays' noise."""
    even = np.ones((DEVICE.columns, 3))
    found = ray_gather(G, DEVICE, WHERE, NORMALS, [even], 4096, 5, order=2)
    assert (
        found.irradiance is not None
        and found.irradiance.shape == (1, 8, 40, 3)
        and found.radiance.shape == (8, 40, 9, 3)
    )
    np.testing.assert_allclose(found.irradiance.mean(axis=1), 1.0, atol=0.01)
    exact = np.zeros(9)
    exact[0] = np.sqrt(4.0 * np.pi) / np.pi
    np.testing.assert_allclose(found.radiance.mean(axis=0), np.tile(exact[:, None], (40, 1, 3)), atol=0.03)


def test_the_same_as_through_rows() -> None:
    rows = point_form_factors(G, P, WHERE, NORMALS, 16384, 6, silent)
    probes = probe_form_factors(G, P, WHERE, 16384, 7, silent, order=2)
    at_points = ray_gather(G, DEVICE, WHERE, NORMALS, [0.5 * LIGHT, LIGHT], 16384, 8)
    alone = ray_gather(G, DEVICE, WHERE, None, [LIGHT], 16384, 9, order=2)
    assert at_points.irradiance is not None and alone.irradiance is None
    np.testing.assert_allclose(at_points.irradiance[1].mean(axis=0), rows.matrix() @ LIGHT, rtol=0.03)
    np.testing.assert_allclose(at_points.irradiance[0], 0.5 * at_points.irradiance[1], rtol=1e-5)  # the same rays
    through = np.stack([probes.matrix(k) @ LIGHT for k in range(9)], axis=1)
    np.testing.assert_allclose(alone.radiance.mean(axis=0), through, atol=0.03)
    np.testing.assert_allclose(at_points.radiance.mean(axis=0), through[:, :4], atol=0.03)


def test_batches_are_independent_and_repeat() -> None:
    """The spread of the batches is the error of their mean, and a second run gives the same numbers."""
    few = [ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 512, seed).radiance for seed in (1, 1, 2)]
    assert np.array_equal(few[0], few[1])
    exact = ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 65536, 3).radiance.mean(axis=0)
    score = (few[0].mean(axis=0) - exact) / (few[0].std(axis=0, ddof=1) / np.sqrt(8.0))
    assert 0.7 < np.sqrt(np.median(score**2) / 0.505) < 1.5  # 0.505: median of t² with 7 degrees of freedom


def test_what_is_seen_does_not_depend_on_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 256, 4).radiance
    monkeypatch.setattr("lightgauge.reference.transport.ray_gather.LANES", 256 * 7)
    np.testing.assert_allclose(ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 256, 4).radiance, whole, rtol=1e-6)
    assert irradiance(whole.mean(axis=0), NORMALS).shape == (40, 3)


def test_wrong_counts_are_refused() -> None:
    with pytest.raises(ValueError, match="power of two"):
        ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 100, 0)
    with pytest.raises(ValueError, match="at least 32"):
        ray_gather(G, DEVICE, WHERE, NORMALS, [LIGHT], 16, 0)
    with pytest.raises(ValueError, match="lighting"):
        ray_gather(G, DEVICE, WHERE, NORMALS, [], 64, 0)
