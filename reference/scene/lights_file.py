"""A lights file: other light for a scene that is baked already.

scene = "house"                  # the scene it was made for
off = ["lamp"]                   # lights of the scene that it turns off
[lights.sun]                     # laid over the scene's light of this name; keys that are not given stay
irradiance = [1.0, 0.5, 0.2]     # a new name, or another `type`, is a new light
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from ..config import ImageSky, Light
from ..config_base import Frozen, Vec3
from ..datatypes import F32, Sky
from ..errors import InputError
from ..turned import rotation_matrix
from .doors import check_area_lights, check_values
from .names import clean
from .paths import MAX_DOCUMENT_BYTES, read_bytes
from .settings import merge, validate
from .skies import make_sky
from .turn import turned_lights


class LightsFile(Frozen):
    """The file. Lights have the models of scene.toml."""

    scene: str
    off: tuple[str, ...] = ()
    lights: dict[str, Light] = Field(default_factory=dict)


class Lighting(NamedTuple):
    """lights: settings by name, the sky's too, in the scene's order, new ones last. sky: the radiance of the one among
    them, or None. notes: what was converted, one sentence each."""

    lights: dict[str, Light]
    sky: Sky | None
    notes: tuple[str, ...]


def load_lights(
    path: Path,
    scene_name: str,
    base_lights: Mapping[str, Light],
    mesh_names: Collection[str],
    base_sky: Sky | None = None,
    rotation: float | Vec3 = 0.0,
) -> Lighting:
    """The lights of a scene with those of a file laid over them.

    mesh_names: meshes that an area light may stand on. base_sky: the scene's own, for files that leave its picture as it
    is. rotation: the scene's `scene.rotation`, which turned base_lights and turns the file's. Pictures that the file names
    lie in its own folder.
    Raises InputError naming the file and the key: another scene, unknown keys and names, values out of range.
    """
    source = str(path)
    raw = _read(path)
    _check_scene(raw.get("scene"), scene_name, source)
    given = raw.get("lights")
    tables: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    if isinstance(given, Mapping):
        as_written = turned_lights(
            {n: v for n, v in base_lights.items() if n in tables}, rotation_matrix(rotation).T, source
        )
        raw = raw | {"lights": {name: _over(as_written.get(name), table) for name, table in tables.items()}}
    read = validate(raw, source, LightsFile)
    _check_off(read, base_lights, source)
    given_lights = turned_lights(read.lights, rotation_matrix(rotation), source)
    lights = {name: light for name, light in {**base_lights, **given_lights}.items() if name not in read.off}
    check_area_lights(lights, mesh_names, source)
    check_values(lights, {}, source)
    with_file = [name for name, table in tables.items() if "file" in table]
    pictures = {
        light.file: _picture(name, base_lights[name], base_sky, source)
        for name, light in lights.items()
        if isinstance(light, ImageSky) and name not in with_file
    }
    sky, notes = make_sky(lights, path.parent, pictures, source)
    return Lighting(lights, sky, tuple(notes))


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_bytes(path, str(path), MAX_DOCUMENT_BYTES).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error


def _check_scene(made_for: object, scene_name: str, source: str) -> None:
    """Raises InputError for a file of another scene: of all that may be wrong with it this explains the most."""
    if isinstance(made_for, str) and made_for != scene_name:
        raise InputError(
            f"{source}: scene: the file lights {clean(made_for)!r}, but this is {scene_name!r}; take a lights file for "
            f"{scene_name!r}, or correct the line"
        )


def _over(base: Light | None, table: Any) -> Any:
    """The table of a light with the keys it leaves out taken from the scene's light of the same name and type."""
    if base is None or not isinstance(table, Mapping) or table.get("type", base.type) != base.type:
        return table
    return merge(base.model_dump(mode="json"), table)


def _check_off(read: LightsFile, base_lights: Mapping[str, Light], source: str) -> None:
    for name in read.off:
        if name in read.lights:
            raise InputError(f"{source}: off: {clean(name)!r} stands under [lights] too; keep one of them")
        if name not in base_lights:
            known = ", ".join(base_lights) or "none"
            raise InputError(f"{source}: off: the scene has no light {clean(name)!r}; there are: {known}")


def _picture(name: str, base: Light, sky: Sky | None, source: str) -> F32:
    """(H, W, 3) the scene's own sky as its picture held it, before `scale`. Raises InputError if it is not known."""
    if sky is None or not isinstance(base, ImageSky) or base.scale == 0.0:
        raise InputError(f"{source}: lights.{name}.file: missing; the scene's own picture is not at hand")
    return np.asarray(sky.image / np.float32(base.scale), np.float32)
