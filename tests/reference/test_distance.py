"""Harmonic mean distance against closed forms and a slow, obvious twin (failure-catalogue C5)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lightgauge.reference.datatypes import F64, I64, Mesh
from lightgauge.reference.directions import fibonacci_sphere
from lightgauge.reference.placement import distance
from lightgauge.reference.placement.distance import GOLDEN, nearer_than
from lightgauge.reference.visibility import Geometry, build_geometry, cast, to_box, vectors
from small_scenes import box, quad, scene, sphere_mesh

BIG = 1e4
MASK = 0xFFFFFFFF


def harmonic_mean(g: Geometry, positions: F64, rays: int, seed: int) -> F64:
    """Position n has the key n."""
    return distance.harmonic_mean(g, positions, np.arange(len(positions)), rays, seed)


def mixed(bits: int) -> int:
    bits = (bits ^ bits >> 16) * 0x7FEB352D & MASK
    bits = (bits ^ bits >> 15) * 0x846CA68B & MASK
    return bits ^ bits >> 16


def rotations(keys: I64, seed: int) -> F64:
    """Rotation matrices (N, 3, 3) key by key, in plain integers and float64."""
    found = []
    for key in keys.tolist():
        first = mixed((key & MASK) ^ mixed(key >> 32 ^ mixed(seed)))
        second = mixed(first + GOLDEN & MASK)
        u, v, w = (bits / 2**32 for bits in (first, second, mixed(second + GOLDEN & MASK)))
        x, y = math.sqrt(1 - u) * math.sin(2 * math.pi * v), math.sqrt(1 - u) * math.cos(2 * math.pi * v)
        z, r = math.sqrt(u) * math.sin(2 * math.pi * w), math.sqrt(u) * math.cos(2 * math.pi * w)
        axis, cross = np.array([x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        found.append((r * r - axis @ axis) * np.eye(3) + 2 * np.outer(axis, axis) + 2 * r * cross)
    return np.array(found)


def twin(g: Geometry, positions: F64, keys: I64, rays: int, seed: int) -> F64:
    """The formula with all directions in memory."""
    i = np.arange(rays)  # the kernel starts its spiral half a step earlier: a turn about the lattice's axis
    lattice = fibonacci_sphere(rays)
    phi = math.pi * (3.0 - math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - lattice[:, 2] ** 2)
    lattice[:, :2] = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1)
    directions = np.einsum("nij,kj->nki", rotations(keys, seed), lattice).reshape(-1, 3)
    hits = cast(g, to_box(g, np.repeat(positions, rays, axis=0)), vectors(directions))
    with np.errstate(divide="ignore"):
        return rays / (1.0 / np.abs(np.array(hits.t, np.float64))).reshape(-1, rays).sum(axis=1)


def plane(y: float, up: bool) -> list[list[float]]:
    ring = [[-BIG, y, -BIG], [-BIG, y, BIG], [BIG, y, BIG], [BIG, y, -BIG]]
    return ring if up else ring[::-1]


def test_plane_reads_four_times_the_height() -> None:
    """1/HM = ∫_lower cosθ/h dω / 4π = 1/(4h). Spread of rotated Fibonacci rays: under 1 % at 1,024."""
    g = build_geometry(scene([quad(plane(0, True))]))
    p = np.column_stack([np.zeros(40), np.repeat([0.5, 2.0], 20), np.zeros(40)])
    np.testing.assert_allclose(harmonic_mean(g, p, 1024, 1), 4 * p[:, 1], rtol=0.01)


def test_middle_between_plates_reads_their_distance() -> None:
    """Plates 2h apart: half the height from each: 2h."""
    g = build_geometry(scene([quad(plane(0, True)), quad(plane(3, False))]))
    np.testing.assert_allclose(harmonic_mean(g, np.tile([0, 1.5, 0], (20, 1)), 1024, 1), 3.0, rtol=0.01)


def test_sphere_centre_reads_the_radius() -> None:
    g = build_geometry(scene([sphere_mesh(2.0, 4)]))
    np.testing.assert_allclose(
        harmonic_mean(g, np.zeros((5, 3)), 64, 1), 2.0, rtol=4e-3
    )  # facets lie inside the sphere


def test_square_corridor() -> None:
    """In the middle of a long corridor of half width a: √2 a."""
    g = build_geometry(scene([box((-1, -1, -BIG), (1, 1, BIG))]))
    np.testing.assert_allclose(harmonic_mean(g, np.zeros((20, 3)), 4096, 1), math.sqrt(2), rtol=5e-3)


def test_a_point_on_a_surface_is_at_distance_zero_and_never_nan() -> None:
    """failure-catalogue C5: d = 0 → 0; never NaN (a NaN compares as far away, and the voxel vanishes)."""
    g = build_geometry(scene([quad([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])]))
    on = np.array([[0.5, 0.5, 0.0], [0.25, 0.7, 0.0], [0.5, 0.5, 1e-7]])
    found = harmonic_mean(g, on, 64, 1)
    assert not np.isnan(found).any(), found
    assert (found < 1e-4).all()


def test_all_miss_is_infinite() -> None:
    g = build_geometry(scene([quad([[0, 0, 0], [1e-6, 0, 0], [1e-6, 1e-6, 0], [0, 1e-6, 0]])]))
    assert harmonic_mean(g, np.array([[0.0, 0.0, 1e3]]), 64, 1)[0] == np.inf


def test_both_sides_of_a_surface_count() -> None:
    g = build_geometry(scene([quad(plane(0, True))]))
    up, down = harmonic_mean(g, np.array([[0, 1.0, 0], [0, -1.0, 0]]), 1024, 1)
    assert up == pytest.approx(down, rel=0.02)


@pytest.mark.parametrize(
    ("meshes", "expected", "spread"),
    [
        ([quad(plane(0, True))], 4.0, 0.005),  # independent directions: √(1/6 - 1/16) · 4 / √64 = 16 %
        ([quad(plane(0, True)), quad(plane(2, False))], 2.0, 0.005),
        ([box((-1, 0, -BIG), (1, 2, BIG))], math.sqrt(2), 0.004),
        ([box((-1, 0, -1), (1, 2, 1))], None, 0.004),
    ],
    ids=["plane", "plates", "corridor", "cube"],
)
def test_bias_and_spread_of_64_rays(meshes: list[Mesh], expected: float | None, spread: float) -> None:
    """failure-catalogue C5, 1 m over the floor: rotated Fibonacci rays spread by 0.4 %, unbiased in 1/HM."""
    g = build_geometry(scene(meshes))
    inverse = 1 / harmonic_mean(g, np.tile([0.0, 1.0, 0.0], (2000, 1)), 64, 1)
    if expected is None:
        expected = harmonic_mean(g, np.tile([0.0, 1.0, 0.0], (50, 1)), 4096, 2).mean()
    assert inverse.std() / inverse.mean() < spread
    assert abs(inverse.mean() * expected - 1) < 4 * inverse.std() / inverse.mean() / math.sqrt(2000) + 2e-5


def test_misses_add_nothing() -> None:
    """Half of the sphere open: twice the distance of the closed one. 64 rays find the half to 2 % of it."""
    ball = sphere_mesh(2.0, 4)
    half = ball.faces[(ball.vertices[ball.faces][..., 1] <= 1e-9).all(axis=1)]
    g = build_geometry(scene([ball.__class__(**{**ball.__dict__, "faces": half})]))
    found = harmonic_mean(g, np.zeros((500, 3)), 64, 1)
    assert 1 / (1 / found).mean() == pytest.approx(4.0, rel=0.03)  # the equator's facets reach half a facet over it
    assert found.std() / found.mean() < 0.06


@pytest.mark.parametrize("rays", [16, 64, 101])
def test_equals_the_twin(rays: int) -> None:
    """The same directions one by one. A ray at an edge may hit in one and miss in the other: none does here."""
    g = build_geometry(scene([box((-1, -2, -1), (3, 1, 1)), box((0, 0, 0), (0.5, 0.25, 0.75), inward=False)]))
    rng = np.random.default_rng(3)
    p = rng.uniform((-0.9, -1.9, -0.9), (2.9, 0.9, 0.9), (300, 3))
    key = rng.integers(0, 1 << 62, len(p))
    expected = twin(g, p, key, rays, 12345)
    np.testing.assert_allclose(distance.harmonic_mean(g, p, key, rays, 12345), expected, rtol=2e-4)
    one = distance.harmonic_mean(g, p[:1], key[:1], rays, 12345)
    np.testing.assert_allclose(one, expected[:1], rtol=2e-4)


def test_rotations_are_uniform_and_alike_for_no_two_neighbours() -> None:
    """Keys of neighbours on the lattice differ in one bit or few. Matrix entries: mean 0, variance 1/3, uncorrelated."""
    key = np.arange(3000) + (1 << 42)
    turned = rotations(key, 7)
    np.testing.assert_allclose(np.einsum("nij,nkj->nik", turned, turned), np.tile(np.eye(3), (3000, 1, 1)), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    assert np.abs(turned.mean(axis=0)).max() < 4 * math.sqrt(1 / 3 / 3000)
    assert np.abs((turned**2).mean(axis=0) - 1 / 3).max() < 4 * math.sqrt(4 / 45 / 3000)
    for step in (1, 2, 64):
        both = np.einsum("nij,nij->n", turned[step:], turned[:-step])
        assert abs(both.mean()) < 4 * both.std() / math.sqrt(len(both))


def test_a_value_belongs_to_its_key_and_seed() -> None:
    """design.md, 3: a result is a function of scene, settings and seed, not of what else is asked, or in which batches."""
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    p = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 3))
    key = np.arange(50) * 977
    whole = distance.harmonic_mean(g, p, key, 64, 1)
    some = np.array([40, 3, 17])
    np.testing.assert_array_equal(distance.harmonic_mean(g, p[some], key[some], 64, 1), whole[some])
    np.testing.assert_array_equal(distance.harmonic_mean(g, p[7:8], key[7:8], 64, 1), whole[7:8])
    assert not np.array_equal(distance.harmonic_mean(g, p, key, 64, 2), whole)
    assert not np.array_equal(distance.harmonic_mean(g, p, key + 1, 64, 1), whole)


def test_does_not_depend_on_the_batch_size(monkeypatch: pytest.MonkeyPatch) -> None:
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    p = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 3))
    whole = harmonic_mean(g, p, 64, 1)
    near = nearer_than(g, p, np.arange(50), 0.8, 64, 1)
    monkeypatch.setattr(distance, "CORNERS_PER_BATCH", 7)
    np.testing.assert_array_equal(harmonic_mean(g, p, 64, 1), whole)
    np.testing.assert_array_equal(nearer_than(g, p, np.arange(50), 0.8, 64, 1), near)


def test_the_rays_in_memory_are_those_that_are_traced() -> None:
    g = build_geometry(scene([box((-1, -1, -1), (1, 1, 1))]))
    p = np.random.default_rng(0).uniform(-0.9, 0.9, (5, 3))
    key = np.arange(5) * 977
    hits = cast(g, *distance.corner_rays(g, p, key, 32, 1))
    by_hand = 32 / (1 / np.array(hits.t, np.float64)).reshape(32, 5).sum(axis=0)
    np.testing.assert_allclose(distance.harmonic_mean(g, p, key, 32, 1), by_hand, rtol=1e-5)


def test_nearer_is_what_the_whole_sum_says() -> None:
    """Lanes stop early where the answer is known; the answer stays that of the full value, on every side of the limit, for
    points on surfaces, and where nothing is hit."""
    g = build_geometry(scene([quad(plane(0, True)), sphere_mesh(1.0, 2, inward=False)]))
    rng = np.random.default_rng(1)
    p = rng.uniform((-3, 0, -3), (3, 3, 3), (3000, 3))
    p[:3] = [[0.5, 0, 0.5], [2.0, -0.0, 1.0], [0, BIG * 1e3, 0]]
    key = np.arange(len(p))
    value = distance.harmonic_mean(g, p, key, 64, 5)
    assert value[0] == value[1] == 0.0 and value[2] > 1e4
    for limit in (1e-3, 0.5, 2.0, 8.0, 1e9):
        np.testing.assert_array_equal(nearer_than(g, p, key, limit, 64, 5), value < limit)
