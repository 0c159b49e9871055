"""Where the truth is asked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.config import CameraSettings
from lightgauge.reference.datatypes import Scene
from lightgauge.reference.errors import InputError
from lightgauge.reference.truth.points import camera_directions, choose_points, inside_share, pixel_view
from lightgauge.reference.visibility import build_geometry
from small_scenes import box, material, quad, scene

CAMERA: dict[str, Any] = {"origin": (2, 1, 1.5), "target": (0, 1, 1.5), "fov_deg": 90, "width": 16, "height": 12}


def room(**settings: Any) -> Scene:
    crate = box((0.5, 0.0, 0.5), (1.0, 0.5, 1.0), inward=False, mat=1)
    return scene([box((0, 0, 0), (4, 3, 3)), crate], [material(), material()], **{"cameras": {"c": CAMERA}, **settings})


def test_camera_rays() -> None:
    """Full horizontal angle of 90°, x to the right, y down, height by the picture's shape."""
    c = CameraSettings.model_validate(
        {"origin": (0, 0, 0), "target": (0, 0, -5), "fov_deg": 90, "width": 20, "height": 10}
    )
    d = camera_directions(c, np.array([[0.5, 0.5], [1.0, 0.5], [0.0, 0.5], [0.5, 0.0], [0.5, 1.0]]))
    h = 1 / math.sqrt(2)
    up = np.array([0, 0.5, -1]) / math.hypot(0.5, 1)
    np.testing.assert_allclose(d, [[0, 0, -1], [h, 0, -h], [-h, 0, -h], up, up * [1, -1, 1]], atol=1e-12)


def test_pixels_see_the_surfaces_in_front_of_them() -> None:
    s = room()
    g = build_geometry(s)
    view = pixel_view(s, g, "c", 1)
    assert view.hit.all() and len(view.points.positions) == 16 * 12
    to_camera = np.array(CAMERA["origin"]) - view.points.positions
    assert (np.einsum("ni,ni->n", to_camera, view.points.normals) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(to_camera, axis=1), view.depth, rtol=1e-5)
    assert {0, 1} == set(view.points.mesh.tolist())
    other = pixel_view(s, g, "c", 2)
    assert not np.array_equal(view.points.positions, other.points.positions), "jittered by seed"


def test_points_know_the_camera_that_sees_them() -> None:
    """By its number in the scene, in the pixels of a view as in the set of all cameras."""
    s = room(cameras={"c": CAMERA, "back": {**CAMERA, "target": (4, 1, 1.5)}})
    g = build_geometry(s)
    for number, name in enumerate(s.settings.cameras):
        seen = pixel_view(s, g, name, 1).points
        assert seen.camera is not None and seen.camera.dtype == np.int32 and (seen.camera == number).all()
        assert len(seen.camera) == len(seen.positions)
    chosen = choose_points(s, g, 100, 1)["camera"]
    assert chosen.camera is not None and chosen.camera.tolist() == [0] * 50 + [1] * 50
    # One looks at the wall x = 0 and the other at x = 4: none sees what the other does.
    assert (np.sign(chosen.positions[:, 0] - 2.0) == np.where(chosen.camera == 0, -1.0, 1.0)).all()


def test_camera_in_a_wall_or_that_sees_nothing_is_named() -> None:
    for origin, target, text in (((0.7, 0.2, 0.7), (3, 1, 1), r"cameras\.c: origin .* is inside a wall"),
                                 ((9, 9, 9), (20, 20, 20), r"cameras\.c: (sees no surface|origin .* is inside a wall)")):  # fmt: skip
        s = room(cameras={"c": {**CAMERA, "origin": origin, "target": target}})
        with pytest.raises(InputError, match=text):
            pixel_view(s, build_geometry(s), "c", 1)


def test_three_sets_of_the_right_size_and_place() -> None:
    s = room(volumes={"v": {"min": (0.1, 0.1, 0.1), "max": (3.9, 2.9, 2.9)}})
    sets = choose_points(s, build_geometry(s), 600, 1)
    assert {k: len(v.positions) for k, v in sets.items()} == {"camera": 600, "surface": 300, "volume": 300}
    inside = ((sets["volume"].positions > [0.5, 0, 0.5]) & (sets["volume"].positions < [1, 0.5, 1])).all(axis=1)
    assert not inside.any() and (sets["volume"].mesh == -1).all()
    for p in sets.values():
        np.testing.assert_allclose(np.linalg.norm(p.normals, axis=1), 1.0)
    # the crate's bottom lies on the floor: points there see nothing but are on the outside of a closed mesh
    assert (sets["surface"].mesh >= 0).all()
    # uniform by area: 66 m² of room, 1.5 m² of crate; binomial of 300 with 2.2 %: 4 sd
    share = (sets["surface"].mesh == 1).mean()
    assert abs(share - 1.5 / 67.5) < 4 * math.sqrt(0.022 * 0.978 / 300)


def test_sets_without_a_place_are_absent() -> None:
    s = room(cameras={})
    assert set(choose_points(s, build_geometry(s), 100, 1)) == {"surface"}


def test_only_probe_lit_surfaces_are_asked() -> None:
    s = scene(
        [box((0, 0, 0), (4, 3, 3), lit_by_probes=False), box((0.5, 0, 0.5), (1, 0.5, 1), inward=False)],
        cameras={"c": CAMERA},
    )
    sets = choose_points(s, build_geometry(s), 200, 1)
    assert set(sets["surface"].mesh.tolist()) == {1} and set(sets["camera"].mesh.tolist()) <= {1}


def test_both_sides_of_a_two_sided_sheet() -> None:
    s = scene([quad([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]])], [material(two_sided=True)])
    up = choose_points(s, build_geometry(s), 400, 1)["surface"].normals[:, 1]
    assert abs((up > 0).mean() - 0.5) < 0.05


def test_inside_share() -> None:
    s = room()
    g = build_geometry(s)
    p = np.array([[0.75, 0.25, 0.75], [2, 1, 1.5], [4.5, 1.5, 1.5]])
    share = inside_share(g, p, None)
    assert share[0] == 1.0 and share[1] == 0.0 and 0 < share[2] < 1
