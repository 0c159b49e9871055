"""Where probes are drawn, which are hidden, which are faint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from lightgauge.validation.report.overlay import (
    LEVEL_STOPS,
    draw_probes,
    level_colours,
    lighting,
    project,
    seen_points,
    surface_marks,
    visible,
    voxel_sizes,
)
from lightgauge.validation.report.pictures import INVALID, REAL, VIRTUAL, CameraPose, ProbeDots, SceneView

POSES = [
    CameraPose((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 90.0, 200, 100),
    CameraPose((0.278, 0.273, -0.8), (0.278, 0.273, 0.0), (0.0, 1.0, 0.0), 39.3077, 224, 224),
    CameraPose((3.0, 5.0, -2.0), (-1.0, 0.5, 4.0), (0.3, 1.0, 0.1), 65.0, 256, 192),
]


def pinhole(pose: CameraPose, point: np.ndarray) -> tuple[float, float]:
    """A 4 × 4 look-at matrix times a projection matrix, as graphics libraries do it (OpenGL's clip space)."""
    eye, target, up = (np.asarray(v, float) for v in (pose.origin, pose.target, pose.up))
    z = (eye - target) / np.linalg.norm(eye - target)
    x = np.cross(up, z) / np.linalg.norm(np.cross(up, z))
    view = np.eye(4)
    view[:3, :3] = np.stack([x, np.cross(z, x), z])
    view[:3, 3] = -view[:3, :3] @ eye
    cot = 1.0 / np.tan(np.radians(pose.fov_deg) / 2.0)
    near, far = 0.01, 1e3
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = cot, cot * pose.width / pose.height
    clip[2, 2:], clip[3, 2] = ((far + near) / (near - far), 2 * far * near / (near - far)), -1.0
    cx, cy, _, w = clip @ view @ np.append(point, 1.0)
    return (cx / w + 1.0) / 2.0 * pose.width, (1.0 - cy / w) / 2.0 * pose.height


@pytest.mark.parametrize("pose", POSES)
def test_projection_against_a_matrix_pinhole(pose: CameraPose) -> None:
    points = np.random.default_rng(0).uniform(-6.0, 6.0, (300, 3))
    xy, distance = project(pose, points)
    ahead = (points - pose.origin) @ (np.asarray(pose.target) - pose.origin) > 1e-3
    assert ahead.sum() > 50
    expected = np.array([pinhole(pose, p) for p in points[ahead]])
    np.testing.assert_allclose(xy[ahead], expected, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(distance, np.linalg.norm(points - pose.origin, axis=1))
    assert np.isnan(xy[(points - pose.origin) @ (np.asarray(pose.target) - pose.origin) < -1e-3]).all()


def test_the_target_is_in_the_middle_and_up_is_up() -> None:
    for pose in POSES:
        xy, _ = project(pose, np.array([pose.target, np.add(pose.target, (0, 0.01, 0))], float))
        np.testing.assert_allclose(xy[0], (pose.width / 2, pose.height / 2), atol=1e-9)
        assert xy[1, 1] < xy[0, 1]


def test_seen_points_are_the_inverse_of_the_projection(view: Callable[..., SceneView]) -> None:
    v = view("a", "b")
    points = seen_points(v.pictures, v.pose)
    row, column = np.nonzero(v.pictures.hit)
    xy, distance = project(v.pose, points)
    np.testing.assert_allclose(xy, np.stack([column, row], axis=1) + 0.5, atol=1e-4)
    np.testing.assert_allclose(distance, v.pictures.depth[row, column], rtol=1e-5)


def test_behind_a_surface_and_outside_is_hidden(view: Callable[..., SceneView]) -> None:
    """On rays through the middles of pixels: in front of the wall shown, behind it not."""
    v = view("a", "b")
    points = seen_points(v.pictures, v.pose)
    origin = np.asarray(v.pose.origin)
    for share, expected in ((0.5, True), (0.999, True), (1.1, False)):
        xy, distance = project(v.pose, origin + share * (points - origin))
        assert (visible(v.pictures, xy, distance) == expected).all()
    xy, distance = project(v.pose, np.array([[100.0, 0, 0], [2.0, 2.0, 20.0]]))
    assert not visible(v.pictures, xy, distance).any()


def test_only_probes_within_a_voxel_of_what_is_seen_light_it(view: Callable[..., SceneView]) -> None:
    """Against brute force over all pixels and probes."""
    v = view("a", "b")
    assert v.dots is not None
    sizes = voxel_sizes(v.dots)
    near = lighting(v.pictures, v.pose, v.dots, sizes)
    points = seen_points(v.pictures, v.pose)
    rng = np.random.default_rng(0)
    for i in rng.choice(len(v.dots.level), 60, replace=False):
        gap = np.linalg.norm(points - v.dots.positions[i], axis=1).min()
        assert near[i] == (gap <= sizes[int(v.dots.level[i])])
    assert near.any() and not near.all()


def test_voxel_sizes_are_read_off_the_lattice() -> None:
    axis = np.arange(5) * 0.25 + 7.0
    fine = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    coarse = np.array([[7.0, 7.0, 9.0], [9.0, 9.0, 7.0]])
    level = np.array([3] * len(fine) + [1, 1], np.int32)
    dots = ProbeDots(np.concatenate([fine, coarse]).astype(np.float32), level, np.zeros(len(level), np.uint8))
    assert voxel_sizes(dots) == pytest.approx({1: 1.0, 3: 0.25}, rel=1e-3)
    assert voxel_sizes(ProbeDots(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.uint8))) == {}


def test_levels_get_colours_from_coarse_to_fine() -> None:
    found = level_colours([4, 0, 2, 2])
    assert list(found) == [0, 2, 4]
    assert found[0] == LEVEL_STOPS[0] and found[4] == LEVEL_STOPS[-1]
    assert len(set(level_colours(list(range(9))).values())) == 9


def one(view: SceneView, position: tuple[float, float, float], kind: int) -> np.ndarray:
    empty = dataclasses.replace(view.dots, positions=np.zeros((0, 3), np.float32), level=np.zeros(0, np.int32),
                                kind=np.zeros(0, np.uint8))  # fmt: skip
    dots = ProbeDots(np.array([position], np.float32), np.array([3], np.int32), np.array([kind], np.uint8))
    drawn, plain = (draw_probes(view.pictures, view.pose, d).astype(int) for d in (dots, empty))
    return np.abs(drawn - plain).sum(axis=-1)


@pytest.mark.parametrize("kind", [REAL, VIRTUAL, INVALID])
def test_a_probe_is_drawn_where_it_projects(view: Callable[..., SceneView], kind: int) -> None:
    v = view("a", "b")
    place = (1.0, 1.5, 0.4)
    changed = np.argwhere(one(v, place, kind) > 20)
    xy, _ = project(v.pose, np.array([place]))
    scale = 4
    np.testing.assert_allclose(changed.mean(axis=0)[::-1], xy[0] * scale, atol=1.5)
    assert np.ptp(changed, axis=0).max() < 30


def test_a_hidden_probe_leaves_no_trace(view: Callable[..., SceneView]) -> None:
    assert one(view("a", "b"), (1.0, 1.5, -2.0), REAL).max() == 0


def test_thousands_of_probes_leave_the_picture_readable(view: Callable[..., SceneView]) -> None:
    """Probes in mid-air are faint: no pixel shouts, however many there are; at the walls they are in full colour."""
    v = view("a", "b")
    for z, shouting in ((1.5, False), (0.03, True)):
        x, y = np.meshgrid(np.arange(1.0, 3.0, 0.05), np.arange(1.0, 3.0, 0.05))
        places = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)
        dots = ProbeDots(places, np.full(x.size, 6, np.int32), np.full(x.size, REAL, np.uint8))
        drawn = draw_probes(v.pictures, v.pose, dots).astype(int)
        chroma = drawn.max(axis=-1) - drawn.min(axis=-1)
        assert (chroma.max() > 90) == shouting
        assert chroma.max() > 20


def test_marks_only_where_the_camera_sees_the_place(view: Callable[..., SceneView]) -> None:
    v = view("a", "b")
    points = seen_points(v.pictures, v.pose)
    middle = points[len(points) // 2]
    toward = np.asarray(v.pose.origin) - middle
    places = np.array([middle, middle + 0.3 * toward, middle - 0.3 * toward, [2.0, 2.0, 30.0]])
    marks = surface_marks(v.pictures, v.pose, places)
    assert [i for i, _, _ in marks] == [0]
    assert surface_marks(v.pictures, v.pose, np.zeros((0, 3))) == []


def test_nothing_to_draw_is_fine(view: Callable[..., SceneView]) -> None:
    v = view("a", "b")
    nothing = dataclasses.replace(v.pictures, hit=np.zeros_like(v.pictures.hit))
    assert v.dots is not None
    assert draw_probes(nothing, v.pose, v.dots).shape[1] >= 800
