"""What a file that is only a mesh lacks: light, sky and a camera."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .document import MeshArrays

SUN: dict[str, Any] = {
    "type": "directional",
    "direction": [-0.4, -1.0, -0.3],
    "irradiance": [3.0, 3.0, 3.0],
    "tag": "engine",
}
SKY: dict[str, Any] = {"type": "sky", "radiance": [0.5, 0.6, 0.8], "tag": "input"}
FOV_DEG, WIDTH, HEIGHT = 60.0, 256, 192
VIEW_FROM = (1.0, 0.7, 1.0)


def default_lights() -> tuple[dict[str, Any], list[str]]:
    """A sun and a sky, and the note that says so."""
    note = "the file brings no lights: added `sun` (directional, irradiance 3, engine) and `sky` (0.5 0.6 0.8, input)"
    return {"sun": dict(SUN), "sky": dict(SKY)}, [note]


def default_camera(geometry: Iterable[MeshArrays]) -> tuple[dict[str, Any], list[str]]:
    """A three-quarter view from outside that frames the bounding sphere of all finite vertices, and its note."""
    points = np.concatenate([m.vertices for m in geometry])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.ones(3))
    with np.errstate(over="ignore"):
        radius = float(np.linalg.norm(high - low)) / 2 or 1.0
    half = math.atan(math.tan(math.radians(FOV_DEG) / 2) * HEIGHT / WIDTH)
    away = np.array(VIEW_FROM) / np.linalg.norm(VIEW_FROM)
    centre = low / 2 + high / 2
    origin = centre + away * radius / math.sin(half)
    if not np.isfinite(origin).all():  # the mesh is refused later, with a better message than the camera's
        origin, centre = away, np.zeros(3)
    camera = {
        "origin": origin.tolist(),
        "target": centre.tolist(),
        "fov_deg": FOV_DEG,
        "width": WIDTH,
        "height": HEIGHT,
    }
    return camera, ["the file brings no camera: added `view`, from outside towards the centre"]
