"""The one sky among a scene's lights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..config import ConstantSky, ImageSky, Light
from ..datatypes import F32, Sky
from ..errors import InputError
from .images import read_sky
from .paths import resolve_inside


def make_sky(
    lights: Mapping[str, Light], folder: Path, pictures: Mapping[str, F32], source: str
) -> tuple[Sky | None, list[str]]:
    """The sky, if there is one, and notes. pictures: those that are no files, by key; all others lie in `folder`.

    Raises InputError if there are two, or its picture cannot be used.
    """
    found = {name: light for name, light in lights.items() if isinstance(light, ConstantSky | ImageSky)}
    if len(found) > 1:
        raise InputError(f"{source}: lights: only one sky is possible, got {', '.join(found)}; remove the others")
    for name, light in found.items():
        engine = light.tag == "engine"
        if isinstance(light, ConstantSky):
            return Sky(np.array(light.radiance, np.float32).reshape(1, 1, 3), 0.0, engine), []
        where = f"{source}: lights.{name}.file"
        image, notes = pictures.get(light.file), list[str]()
        if image is None:
            image, notes = read_sky(resolve_inside(folder, light.file, where), where)
        return Sky(image * np.float32(light.scale), light.rotation_deg, engine), notes
    return None, []
