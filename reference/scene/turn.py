"""`scene.rotation` applied to what settings hold as points and directions: lights, cameras, cubemaps.

Meshes are turned as they are built; boxes stay as they are written, since they are axis-aligned there: `reference/turned.py`
gives them in the world. Sky pictures turn about y only, as they stand on the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..config import DirectionalLight, ImageSky, Light, PointLight, SceneSettings, SpotLight
from ..config_base import Vec3
from ..datatypes import F64
from ..errors import InputError
from ..turned import rotation_matrix, turned, turns
from .sky_turn import rotation_about_y

EXACT = 1e-9


def turned_settings(settings: SceneSettings, source: str) -> SceneSettings:
    """Settings with lights, cameras and cubemaps turned by `scene.rotation`; the same object if that turns nothing.

    Raises InputError for a sky picture that would be tilted.
    """
    matrix = rotation_matrix(settings.scene.rotation)
    if not turns(matrix):
        return settings
    cameras = {
        name: c.model_copy(update={key: _triple(getattr(c, key), matrix) for key in ("origin", "target", "up")})
        for name, c in settings.cameras.items()
    }
    cubemaps = {
        name: c.model_copy(update={"position": _triple(c.position, matrix)}) for name, c in settings.cubemaps.items()
    }
    lights = turned_lights(settings.lights, matrix, source)
    return settings.model_copy(update={"lights": lights, "cameras": cameras, "cubemaps": cubemaps})


def turned_lights(lights: Mapping[str, Light], matrix: F64, source: str) -> dict[str, Light]:
    """Lights turned by `matrix` (3, 3). Raises InputError for a sky picture that would be tilted."""
    return {name: turned_light(light, matrix, f"{source}: lights.{name}") for name, light in lights.items()}


def turned_light(light: Light, matrix: F64, where: str) -> Light:
    """One light turned by `matrix` (3, 3). Raises InputError, which names `where`, for a sky picture that would be tilted."""
    if not turns(matrix):
        return light
    change: dict[str, Any] = {}
    if isinstance(light, PointLight | SpotLight):
        change["position"] = _triple(light.position, matrix)
    if isinstance(light, SpotLight | DirectionalLight):
        change["direction"] = _triple(light.direction, matrix)
    if isinstance(light, ImageSky):
        change["rotation_deg"] = light.rotation_deg + _about_y(matrix, where)
    return light.model_copy(update=change)


def _about_y(matrix: F64, where: str) -> float:
    degrees = rotation_about_y(matrix)
    if degrees is None or np.abs(matrix - rotation_matrix(degrees)).max() > EXACT:
        raise InputError(
            f"{where}: scene.rotation would tilt a sky picture, which turns about y only; turn the scene about y, as in "
            'scene.rotation=30, or use a sky of one colour (type = "sky")'
        )
    return degrees


def _triple(point: Vec3, matrix: F64) -> Vec3:
    x, y, z = (float(v) for v in turned(np.asarray(point, dtype=np.float64), matrix))
    return (x, y, z)
