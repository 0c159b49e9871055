"""Scores of pictures, biased blocks and worst places on the page: shown with their noise, marked where a camera sees them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from lightgauge.validation.record_models import SceneResult
from lightgauge.validation.report.pictures import SceneView
from lightgauge.validation.report.place_tables import marks, place_rows
from lightgauge.validation.report.score_tables import biased_context, images_context

BLOCK = {
    "position": [0.0, 0.0, 0.0], "size_m": 0.5, "points": 20, "ours": [1.1] * 3, "truth": [1.0] * 3, "relative": 0.1, "noise": 0.01,
    "p": 1e-6,
}  # fmt: skip
PLACE = {
    "metric": "seam_sup", "position": [1.0, 2.0, 3.0], "value": 2e-6, "level": 3, "voxel_m": 0.25,
    "probes": [{"position": [1.0, 2.0, 3.0], "weight": 0.2}] * 5,
}  # fmt: skip


def record() -> dict[str, Any]:
    metrics = {
        "flip_camera_eye": {"value": 0.2, "n": 100, "noise": 0.1},
        "ssim_camera_eye": {"value": 0.9, "n": 100, "noise": 0.8, "below_noise": True},
        "biased_blocks": {"value": 0.25, "se": 0.1, "n": 40},
        "equal_blocks": {"value": 0.5, "se": 0.1, "n": 40},
        "block_noise": {"value": 0.02, "n": 40},
    }
    image = {
        "camera": "eye", "exposure_start": -1.0, "exposure_stop": 2.0, "exposures": 3, "pixels_per_degree": 67.0, "paths_per_pixel": 32,
    }  # fmt: skip
    made = {"name": "a", "status": "ok", "metrics": metrics, "images": [image], "biased": [BLOCK], "places": [PLACE]}
    SceneResult.model_validate(made)
    return made


def test_scores_stand_beside_their_noise() -> None:
    found = images_context(record())
    flip, ssim, relmse = found["rows"][0]["cells"]
    assert (flip["value"], flip["noise"], flip["below"]) == ("0.200", "0.100", False)
    assert ssim["below"] and relmse is None
    assert found["rows"][0]["exposures"] == "3, -1.00 to +2.00 stops"
    assert all("lind" in says for _, says in found["legend"]), "each says what it is blind to"
    assert images_context({"metrics": {}}) == {}


def test_biased_blocks_are_counted_and_lettered() -> None:
    found = biased_context(record())
    assert (found["count"], found["of"], found["rows"][0]["index"], found["rows"][0]["relative"]) == (
        10,
        40,
        "A",
        "+10.0 %",
    )
    assert biased_context({"metrics": {}}) == {}


def test_places_name_voxel_and_probes() -> None:
    row = place_rows(record())[0]
    assert row["letter"] == "a" and row["voxel"] == "level 3, 0.250 m" and len(row["probes"]) == 4 and row["more"] == 1
    assert place_rows({"places": [{**PLACE, "level": 0, "voxel_m": None}]})[0]["voxel"] == "none answers"


def test_marks_are_drawn_where_a_camera_sees_them(view: Callable[..., SceneView]) -> None:
    """A place half way to the surface in the picture's middle is marked, one behind the camera is not; a block only on the surface."""
    v = view("a", "eye")
    origin, target = np.array(v.pose.origin), np.array(v.pose.target)
    ahead = (target - origin) / np.linalg.norm(target - origin)
    row, column = (n // 2 for n in v.pictures.hit.shape)
    surface = float(v.pictures.depth[row, column])
    before, behind, on = origin + 0.5 * surface * ahead, origin - ahead, origin + surface * ahead
    scene = {
        "places": [{"position": before.tolist()}, {"position": behind.tolist()}],
        "biased": [{"position": before.tolist()}, {"position": on.tolist()}],
    }
    assert [label for label, _, _ in marks(scene, v.pictures, v.pose)] == ["B", "a"]
