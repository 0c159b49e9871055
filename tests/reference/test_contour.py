"""Closed forms: clipping, the contour integral against its own sums and Lambert's formula, the device against its twin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.device_arrays import ALIGNMENT, aligned
from lightgauge.reference.transport.closed_forms import contour_batch
from lightgauge.reference.transport.closed_forms.contour import (
    contour_sum,
    log_double_integral,
    log_integral,
    polygon_form_factor,
    tanh_sinh,
)
from lightgauge.reference.transport.closed_forms.contour_batch import pair_form_factors
from lightgauge.reference.transport.closed_forms.lambert import edge_vectors, gauss_lambert, point_form_factor
from lightgauge.reference.transport.closed_forms.polygon_clip import clip_polygon, padded, unit_normals, vector_areas

UNIT = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
WALL = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])


def area(polygon: Any) -> float:
    return float(np.linalg.norm(vector_areas(np.asarray(polygon)[None])[0]))


def exchanged(a: Any, b: Any) -> float:
    return area(a) * polygon_form_factor(np.asarray(a), np.asarray(b))


def random_polygons(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and quadrilaterals of sizes over two decades, in a room of size 2: some cut others' planes."""
    rng = np.random.default_rng(seed)
    polygons, sizes = np.zeros((count, 4, 3)), rng.integers(3, 5, count)
    for k in range(count):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, sizes[k]))
        size, flat = 10.0 ** rng.uniform(-2.0, 0.3), 10.0 ** rng.uniform(-1.0, 0.0)
        corners = size * (np.outer(np.cos(angle), axes[0]) + flat * np.outer(np.sin(angle), axes[1]))
        polygons[k, : sizes[k]] = rng.uniform(-1.0, 1.0, 3) + corners
        polygons[k, sizes[k] :] = 1e9  # what is past the size must not matter
    return polygons, sizes


def test_clipping_keeps_what_is_above() -> None:
    above = clip_polygon(UNIT, UNIT[:, 0] - 0.25)
    assert area(above) == pytest.approx(0.75, rel=1e-15) and above[:, 0].min() == 0.25
    assert len(clip_polygon(UNIT, UNIT[:, 0] - 2.0)) == 0
    assert len(clip_polygon(UNIT, np.zeros(4))) == 0, "in the plane is not above it"
    touching = clip_polygon(UNIT, np.array([0.0, -1.0, -1.0, 0.0]))
    assert len(touching) == 0
    assert np.array_equal(clip_polygon(UNIT, np.array([1e-18, 1.0, 1.0, -1e-18]), 1e-12), UNIT)


def test_a_cut_is_the_same_from_both_sides() -> None:
    """Two polygons that share an edge keep sharing it: neither gap nor overlap."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        a, b, c, d = rng.normal(size=(4, 3))
        normal = rng.normal(size=3)
        parts = [clip_polygon(np.array(t), np.array(t) @ normal) for t in ((a, b, c), (b, a, d))]
        cuts = [{tuple(p) for p in part if tuple(p) not in map(tuple, (a, b, c, d))} for part in parts]
        crosses = (a @ normal) * (b @ normal) < 0.0
        assert len(cuts[0] & cuts[1]) == (1 if crosses else 0)


def test_integrals_of_the_logarithm() -> None:
    nodes, weights = tanh_sinh()
    s = np.where(nodes > 0.0, nodes, 1.0 + nodes)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert weights @ (s * np.log(s)) == pytest.approx(-0.25, abs=1e-12)
    for x, d in ((0.7, 0.0), (2.0, 1e-6), (1.0, 3.0)):
        x_, d_ = np.array([x]), np.array([d])
        numeric = x * (weights @ np.log(np.hypot(x * s, d)))
        assert log_integral(x_, d_)[0] == pytest.approx(numeric, abs=1e-9)
        twice = x * (weights @ log_integral(x * s, np.full_like(s, d)))
        start = log_double_integral(np.zeros(1), d_)[0]
        assert log_double_integral(x_, d_)[0] - start == pytest.approx(twice, abs=1e-11)


@pytest.mark.parametrize("gap", [0.0, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0])
def test_parts_add_up(gap: float) -> None:
    """Cut either polygon in two: what the parts exchange sums to the whole, whatever comes near whatever."""
    rng = np.random.default_rng(int(-math.log10(gap + 1e-12) * 7))
    for k in range(12):
        emitter = UNIT.copy()
        emitter[2:, 0] += rng.uniform(-0.3, 0.3, 2)
        angle, tilt, long = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.02, 3.1), rng.uniform(0.05, 1.5)
        base = np.array([[rng.random(), rng.random(), gap], [1.0, 0.0, gap], [0.5, 0.0, gap]][k % 3])
        u = (
            np.array([1.0, 0.0, 0.0])
            if k % 3 == 2
            else np.array([np.cos(angle), np.sin(angle), rng.random() * (k % 2)])
        )
        v = np.cos(tilt) * np.array([-np.sin(angle), np.cos(angle), 0.0]) + np.array([0.0, 0.0, np.sin(tilt)])
        receiver = np.array([base, base + long * u, base + long * u + v, base + v])
        if np.cross(u, v) @ (emitter.mean(axis=0) - receiver.mean(axis=0)) < 0.0:
            receiver = receiver[::-1]
        whole = exchanged(emitter, receiver)
        s, t = rng.uniform(0.1, 0.9, 2)
        a, b, c, d = emitter
        m, n = a + s * (b - a), c + t * (d - c)
        assert exchanged([a, m, n, d], receiver) + exchanged([m, b, c, n], receiver) == pytest.approx(whole, abs=1e-13)
        a, b, c, d = receiver
        m = a + s * (b - a)
        assert exchanged([a, m, d], emitter) + exchanged([m, b, c, d], emitter) == pytest.approx(whole, abs=1e-13)
        assert exchanged(receiver, emitter) == pytest.approx(whole, abs=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_contour_and_lambert_agree(seed: int) -> None:
    """Two formulas that share nothing, on polygons too near for the far rule and far enough for Gauss points."""
    rng = np.random.default_rng([seed, 9])
    other = UNIT[::-1] @ np.diag([1.0, 1.0, 1.0]) + [0.3 * rng.random(), rng.random(), 1.5 + rng.random()]
    other[:2] += [0.0, 0.0, 0.4 * rng.random()]
    assert contour_sum(UNIT, other) == pytest.approx(gauss_lambert(UNIT, other, 24), rel=1e-11)


def test_polygons_that_are_not_convex() -> None:
    """An L, even when a horizon cuts it into two pieces, is the sum of its rectangles."""
    l_shape = np.array([[0, 0, 1], [0, 2, 1], [1, 2, 1], [1, 1, 1], [2, 1, 1], [2, 0, 1]], float)
    parts = [l_shape[[0, 1, 2]], l_shape[[0, 2, 3]], l_shape[[0, 3, 4]], l_shape[[0, 4, 5]]]
    tilted = np.array([[0, 0, 0], [2, 0, 0.5], [2, 2, 1.9], [0, 2, 1.4]], float)
    tilted[2] = tilted[1] + tilted[3] - tilted[0]
    for emitter in (UNIT, 2.0 * UNIT + np.array([0.5, 0.5, -1.0]), tilted):
        signed = sum(exchanged(emitter, part) for part in parts)
        assert exchanged(emitter, l_shape) == pytest.approx(signed, abs=1e-13)
    assert exchanged(UNIT, l_shape) > 0.1


@pytest.mark.parametrize(
    ("emitter", "receiver"),
    [
        (UNIT, UNIT + np.array([1, 0, 0])),
        (UNIT, UNIT),
        (UNIT, UNIT + np.array([0, 0, 1])),
        (UNIT[::-1], UNIT + np.array([0, 0, 1])),
        (UNIT[::-1], WALL),
        (UNIT, WALL - np.array([0, 0, 1.0])),
        (UNIT, WALL - np.array([0, 0, 3.0])),
    ],
    ids=["coplanar", "itself", "behind it", "back to back", "faces away", "below, touching", "below"],
)
def test_zero_is_zero(emitter: np.ndarray, receiver: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn, shift = q * np.sign(np.linalg.det(q)), 10.0 ** rng.uniform(-1, 4) * rng.normal(size=3)
        a, b = emitter @ turn.T + shift, receiver @ turn.T + shift
        assert polygon_form_factor(a, b) == 0.0
        both = np.stack([a, b])
        assert pair_form_factors(both, np.array([4, 4]), np.array([[0, 1]]))[0] == 0.0


def test_size_and_place_do_not_matter() -> None:
    truth = polygon_form_factor(UNIT, WALL)
    for scale in (1e-9, 1e-4, 1e4, 1e9):
        assert polygon_form_factor(scale * UNIT, scale * WALL) == pytest.approx(truth, abs=1e-14)
    for far in (1e3, 1e6):  # the corners themselves are rounded to far · 1e-16
        found = polygon_form_factor(UNIT + far, WALL + far)
        assert found == pytest.approx(truth, abs=1e-12)


def test_sizes_apart_by_a_million() -> None:
    """F from a speck is the point's, whatever the contour sum would have cancelled."""
    speck = 1e-6 * (UNIT - 0.5 * UNIT[2])
    wall = np.array([[-3.0, -2.0, 1.0], [-3.0, 5.0, 1.0], [2.0, 5.0, 1.0], [2.0, -2.0, 1.0]])
    truth = point_form_factor(np.zeros(3), np.array([0.0, 0.0, 1.0]), wall)
    assert polygon_form_factor(speck, wall) == pytest.approx(truth, abs=1e-9)
    assert polygon_form_factor(wall, speck) * area(wall) / area(speck) == pytest.approx(truth, abs=1e-9)


def test_refuses_polygons_without_area() -> None:
    for pair in ((UNIT[[0, 1, 1]], UNIT), (UNIT, np.zeros((3, 3)))):
        with pytest.raises(ValueError, match="need an area"):
            polygon_form_factor(*pair)


def test_points_see_what_is_above_their_horizon() -> None:
    up = np.array([0.0, 0.0, 1.0])
    ceiling = 1e4 * (UNIT[::-1] - 0.5 * UNIT[2]) + [0.0, 0.0, 1.0]
    assert point_form_factor(np.zeros(3), up, ceiling) == pytest.approx(1.0, abs=1e-7)
    wall = np.array([[-1e4, 1.0, -1e4], [1e4, 1.0, -1e4], [1e4, 1.0, 1e4], [-1e4, 1.0, 1e4]])[::-1]
    assert point_form_factor(np.zeros(3), up, wall[::-1]) == pytest.approx(0.5, abs=1e-4), "upper half of a wide wall"
    assert point_form_factor(np.zeros(3), up, wall) == 0.0, "its back"
    assert point_form_factor(np.array([0.3, 0.3, 0.0]), up, UNIT) == 0.0, "in its plane"
    assert point_form_factor(np.zeros(3), -up, ceiling) == 0.0
    straight = edge_vectors(np.zeros((1, 3)), UNIT[::-1] + np.array([0.0, 0.0, 1.0]))[0, 2] / (2.0 * np.pi)
    assert point_form_factor(np.zeros(3), up, UNIT[::-1] + np.array([0.0, 0.0, 1.0])) == straight


def test_device_and_twin_agree() -> None:
    polygons, sizes = random_polygons(40, 3)
    i, j = np.triu_indices(40, 1)
    found = pair_form_factors(polygons, sizes, np.stack([i, j], axis=1))
    whole = [polygons[k, : sizes[k]] for k in range(40)]
    truth = np.array([exchanged(whole[a], whole[b]) for a, b in zip(i, j, strict=True)])
    smaller = np.array([min(area(whole[a]), area(whole[b])) for a, b in zip(i, j, strict=True)])
    assert np.array_equal(found == 0.0, truth == 0.0) and 0.04 < (truth > 0.0).mean() < 0.8
    assert np.abs(found - truth).max(initial=0.0, where=truth > 0.0) <= 1e-11 * smaller.max()
    assert (np.abs(found - truth) / smaller).max() < 1e-10
    swapped = pair_form_factors(polygons, sizes, np.stack([j, i], axis=1))
    assert np.abs(found - swapped).max() <= 1e-12 * smaller.max()
    one = pair_form_factors(polygons, sizes, np.array([[i[7], j[7]]]))
    assert one[0] == found[7], "a pair alone reads the same"


@pytest.mark.parametrize("number", range(contour_batch.NEAR))
def test_every_tier_keeps_its_promise(number: int) -> None:
    """At the nearest distance at which its Gauss points are used, face on and edge on."""
    least = contour_batch.TIERS[number][0]
    small, large = UNIT - np.array([0.5, 0.5, 0.0]), 3.0 * (UNIT[::-1] - np.array([0.5, 0.5, 0.0]))
    radius = math.sqrt(0.5)
    above = large + np.array([0.0, 0.0, 1.0001 * least * radius])
    tilt = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    aside = large @ tilt.T + [1.0001 * least * radius, 0.0, 0.8]
    for other in (above, aside):
        found = pair_form_factors(np.stack([small, other]), np.array([4, 4]), np.array([[0, 1]]))[0]
        truth = exchanged(small, other)
        assert truth > 0.0 and found == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("rotated", [False, True])
def test_rows_of_a_room_sum_to_one(rotated: bool) -> None:
    """All patches of a closed cube: every tier, common edges and corners, coplanar neighbours."""
    n, quads = 6, []
    for axis in range(3):
        for side in (0, 1):
            for a in range(n):
                for b in range(n):
                    corners = np.zeros((4, 3))
                    corners[:, axis] = side
                    corners[:, (axis + 1) % 3] = (a + np.array([0, 1, 1, 0])) / n
                    corners[:, (axis + 2) % 3] = (b + np.array([0, 0, 1, 1])) / n
                    quads.append(corners[::-1] if side else corners)
    room = np.array(quads)
    if rotated:
        room = room @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0].T
        room = (
            room if np.dot(unit_normals(room)[0], room.mean(axis=(0, 1)) - room[0].mean(axis=0)) > 0 else room[:, ::-1]
        )
    i, j = np.triu_indices(len(room), 1)
    flow = pair_form_factors(room, np.full(len(room), 4), np.stack([i, j], axis=1)) * n * n
    rows = np.bincount(i, flow, len(room)) + np.bincount(j, flow, len(room))
    assert np.abs(rows - 1.0).max() < 1e-11


def test_arrays_reach_the_device_aligned() -> None:
    for size in range(1, 40):
        made = aligned(np.arange(size), np.float64)
        assert made.ctypes.data % ALIGNMENT == 0 and np.array_equal(made, np.arange(size))


def test_padding_repeats_the_last_corner() -> None:
    made = padded(np.stack([UNIT, UNIT]), np.array([3, 4]))
    assert np.array_equal(made[0], UNIT[[0, 1, 2, 2]]) and np.array_equal(made[1], UNIT)
