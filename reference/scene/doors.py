"""What a scene must have before it is worth building, and what it must not: names that point nowhere, light that is no
number, nothing that shines, nothing that reflects."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from ..config import AreaLight, ConstantSky, DirectionalLight, ImageSky, Light, MaterialSettings, SceneSettings
from ..datatypes import Material, Mesh, Sky
from ..errors import InputError

# Largest radiometric value: products of several still fit into single precision.
MAX_LIGHT = 1e12
SHOWN = 8


def check_meshes(settings: SceneSettings, source: str) -> None:
    """Raises InputError if there are no meshes, if all of them move, or if one has a material that is not there."""
    if not settings.meshes:
        raise InputError(f"{source}: meshes: the scene is empty; add a mesh")
    if all(m.role == "moving" for m in settings.meshes.values()):
        raise InputError(f"{source}: meshes: all are moving, probes need static surfaces; make one static")
    for name, mesh in settings.meshes.items():
        if mesh.material not in settings.materials:
            known = ", ".join(list(settings.materials)[:SHOWN]) or "none"
            raise InputError(f"{source}: meshes.{name}.material: no material {mesh.material!r}; there are: {known}")


def check_area_lights(lights: Mapping[str, Light], meshes: Collection[str], source: str) -> None:
    """Raises InputError for an area light on a mesh that is not there, or that another one lights."""
    lit: dict[str, str] = {}
    for name, light in lights.items():
        if not isinstance(light, AreaLight):
            continue
        path = f"{source}: lights.{name}.mesh"
        if light.mesh not in meshes:
            raise InputError(f"{path}: no mesh {light.mesh!r}; there are: {', '.join(list(meshes)[:SHOWN])}")
        if light.mesh in lit:
            raise InputError(f"{path}: mesh {light.mesh!r} is lit by {lit[light.mesh]!r} already; keep one of them")
        lit[light.mesh] = name


def check_lit_twice(settings: SceneSettings, source: str) -> None:
    """Raises InputError for an area light on a mesh whose material emits."""
    for name, light in settings.lights.items():
        if isinstance(light, AreaLight):
            material = settings.meshes[light.mesh].material
            if any(settings.materials[material].emission):
                path = f"{source}: lights.{name}.mesh"
                raise InputError(f"{path}: material {material!r} emits too; remove its emission or this light")


def check_values(lights: Mapping[str, Light], materials: Mapping[str, MaterialSettings], source: str) -> None:
    """Raises InputError for light over MAX_LIGHT. Settings hold neither NaN nor infinity; products of them might."""
    named = [(f"lights.{name}.{key}", values) for name, light in lights.items() for key, values in _values(light)]
    named += [(f"materials.{name}.emission", m.emission) for name, m in materials.items()]
    for path, values in named:
        if max(values) > MAX_LIGHT:
            raise InputError(f"{source}: {path}: {max(values):g} is over the limit of {MAX_LIGHT:g}; check the unit")


def _values(light: Light) -> Iterator[tuple[str, Sequence[float]]]:
    if isinstance(light, ImageSky):
        yield "scale", (light.scale,)
    elif isinstance(light, DirectionalLight):
        yield "irradiance", light.irradiance
    elif isinstance(light, AreaLight | ConstantSky):
        yield "radiance", light.radiance
    else:
        yield "intensity", light.intensity


def check_surfaces(meshes: Sequence[Mesh], materials: Sequence[Material], source: str) -> None:
    """Raises InputError if every static mesh lets light pass, so that nothing reflects."""
    if not any(m.static and not materials[m.material].passes_light for m in meshes):
        names = ", ".join(m.name for m in meshes[:SHOWN] if m.static)
        raise InputError(f"{source}: meshes: no static mesh is opaque ({names} let light pass); add one that reflects")


def check_light(
    lights: Mapping[str, Light], meshes: Sequence[Mesh], materials: Sequence[Material], sky: Sky | None, source: str
) -> None:
    """Raises InputError if nothing shines, or if a picture shines more than MAX_LIGHT."""
    if sky is not None and float(sky.image.max()) > MAX_LIGHT:
        raise InputError(
            f"{source}: lights: the sky reaches {float(sky.image.max()):g}, over the limit of {MAX_LIGHT:g}"
        )
    shining = sky is not None and bool(sky.image.any())
    for mesh in meshes:
        glow = materials[mesh.material].emission_texture
        emitted = mesh.emission if glow is None else mesh.emission * glow.max(axis=(0, 1)).astype(np.float64)
        if emitted.max() > MAX_LIGHT:
            name = materials[mesh.material].name
            raise InputError(
                f"{source}: materials.{name}: emits up to {emitted.max():g}, over the limit of {MAX_LIGHT:g}"
            )
        shining |= bool(emitted.any())
    shining |= any(
        any(v) for light in lights.values() for key, v in _values(light) if key in ("irradiance", "intensity")
    )
    if not shining:
        raise InputError(
            f"{source}: lights: no light and no emission, everything is black; add a light, "
            'for example [lights.sky] type = "sky" radiance = [1, 1, 1]'
        )
