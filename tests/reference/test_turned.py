"""Turning: the matrix, points, and boxes that are no longer axis-aligned."""

from __future__ import annotations

import numpy as np
import pytest
from lightgauge.reference.config_placement import BoxSettings
from lightgauge.reference.turned import TurnedBox, rotation_matrix, turned, turned_boxes, turns

BOX = BoxSettings(min=(1.0, 0.0, -2.0), max=(3.0, 1.5, -1.0))


def test_turns_counter_clockwise_about_x_then_y_then_z() -> None:
    x, y, z = np.eye(3)
    np.testing.assert_allclose(turned(x, rotation_matrix(90.0)), -z, atol=0)  # a number turns about y
    np.testing.assert_allclose(turned(y, rotation_matrix((90.0, 0.0, 0.0))), z, atol=0)
    np.testing.assert_allclose(turned(y, rotation_matrix((90.0, 90.0, 0.0))), x, atol=0)  # y to z by x, z to x by y
    np.testing.assert_allclose(turned(x, rotation_matrix((0.0, 0.0, 90.0))), y, atol=0)
    m = rotation_matrix((20.0, -35.0, 100.0))
    np.testing.assert_allclose(m @ m.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(m) == pytest.approx(1.0)


def test_whole_turns_change_no_bit() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    for nothing in (0.0, 360.0, -720.0, (0.0, 360.0, 0.0)):
        assert not turns(rotation_matrix(nothing))
        assert np.array_equal(turned(points, rotation_matrix(nothing)), points)
    np.testing.assert_allclose(
        turned(points, rotation_matrix(390.0)), turned(points, rotation_matrix(30.0)), atol=1e-14
    )


def test_equal_points_stay_equal() -> None:
    """Whatever stands beside them in the array: meshes that share corners must go on sharing them."""
    rng = np.random.default_rng(1)
    shared, m = rng.normal(size=(7, 3)) * 1e3, rotation_matrix((12.3, 45.6, 78.9))
    for before in range(9):
        alone = np.concatenate([rng.normal(size=(before, 3)), shared])
        assert np.array_equal(turned(alone, m)[before:], turned(shared, m))


def test_box_not_turned_is_what_it_was() -> None:
    box = turned_boxes([BOX], 0.0)[0]
    assert not box.turns
    assert np.array_equal(box.bounds[0], BOX.min) and np.array_equal(box.bounds[1], BOX.max)
    assert box.inside(np.array([BOX.min, BOX.max, (0.0, 0.0, 0.0)])).tolist() == [True, True, False]


def test_corners_and_inside_follow_the_turn() -> None:
    box = turned_boxes([BOX], (10.0, 30.0, -50.0))[0]
    share = np.random.default_rng(2).uniform(-0.3, 1.3, (500, 3))
    expected = ((share >= 0.0) & (share <= 1.0)).all(axis=1)
    assert np.array_equal(box.inside(box.world(share)), expected) and 50 < expected.sum() < 450
    np.testing.assert_allclose(box.corners, turned(turned_boxes([BOX], 0.0)[0].corners, box.matrix))
    low, high = box.bounds
    np.testing.assert_allclose([low, high], [box.corners.min(axis=0), box.corners.max(axis=0)])


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.0, 30.0, 0.0), (25.0, 40.0, 60.0)])
def test_overlap_with_cubes_is_exact(rotation: tuple[float, float, float]) -> None:
    """Against brute force: cubes that hold a sample of the box touch it, cubes that keep a gap in a fine sampling do not."""
    rng = np.random.default_rng(3)
    box = TurnedBox(np.array([-0.5, -0.2, -0.9]), np.array([0.6, 0.3, 0.4]), rotation_matrix(rotation))
    centres, half = rng.uniform(-1.5, 1.5, (400, 3)), 0.25
    touch = box.touches_cubes(centres, half)
    inner = box.world(np.stack(np.meshgrid(*[np.linspace(0, 1, 25)] * 3, indexing="ij"), -1).reshape(-1, 3))
    gap = np.array([np.abs(inner - c).max(axis=1).min() for c in centres]) - half  # a sample is off by 0.04 m at most
    assert touch[gap <= 0.0].all()
    assert not touch[gap > 0.06].any()
    assert 20 < touch.sum() < 380
