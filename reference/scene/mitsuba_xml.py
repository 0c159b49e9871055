"""Mitsuba scene files, the dialects of 0.5 / 0.6 and of 2 / 3, read here and never handed to Mitsuba."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..datatypes import F32, F64
from ..errors import InputError
from .defaults import default_camera
from .document import Document, MeshArrays
from .names import unique
from .xml_camera import convert_sensor
from .xml_lights import convert_emitter, power
from .xml_materials import Surface, convert
from .xml_shapes import shape_arrays, shape_name
from .xml_textures import colour
from .xml_values import IGNORED_TAGS, Context, children, parse

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

DEFAULT_MATERIAL = "default"


@dataclass
class _Reader:
    """Tables as they grow."""

    ctx: Context
    materials: dict[str, Any] = field(default_factory=dict)
    meshes: dict[str, Any] = field(default_factory=dict)
    lights: dict[str, Any] = field(default_factory=dict)
    cameras: dict[str, Any] = field(default_factory=dict)
    geometry: dict[str, MeshArrays] = field(default_factory=dict)
    textures: dict[str, F32] = field(default_factory=dict)
    surfaces: dict[str, Surface] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)

    def add_material(self, element: Element, fallback: str) -> str:
        """Name of the material of a <bsdf>, converted at its first use."""
        if id(element) in self.names:
            return self.names[id(element)]
        name = unique(element.get("id") or fallback, self.materials, "material")
        self.ctx.subject = f"material {name}"
        surface = convert(element, self.ctx)
        self.names[id(element)] = name
        self.surfaces[name] = surface
        self.textures |= surface.textures
        self.materials[name] = {"albedo": list(surface.colour.rgb), "two_sided": surface.two_sided}
        if surface.colour.texture:
            self.materials[name]["texture"] = surface.colour.texture
        return name

    def _material_of(self, shape: Element, mesh: str) -> str:
        found = children(shape, "bsdf", self.ctx)
        if found:
            return self.add_material(found[0][1], f"{mesh} material")
        if DEFAULT_MATERIAL not in self.materials:
            self.materials[DEFAULT_MATERIAL] = {"albedo": [0.5, 0.5, 0.5]}
        return DEFAULT_MATERIAL

    def _glowing(self, material: str, mesh: str, emitter: Element) -> tuple[str, F64 | None]:
        """Name of a copy of the material that emits the bitmap of an area emitter, and the picture's map of uvs."""
        glow = colour(emitter, ("radiance",), 1.0, self.ctx)
        if glow.texture is None or "checkerboard" in glow.texture:
            raise self.ctx.fail(emitter, "a textured radiance must be a bitmap")
        surface = self.surfaces.get(material)
        if surface is not None and _pictured(surface) and not _same(surface.colour.to_uv, glow.to_uv):
            raise self.ctx.fail(emitter, "its to_uv differs from that of the shape's texture; bake it into the mesh")
        name = unique(f"{material} of {mesh}", self.materials, "material")
        self.materials[name] = {**self.materials[material], "emission": [1.0] * 3, "emission_texture": glow.texture}
        self.textures |= glow.images
        if surface is not None:
            self.surfaces[name] = surface
        self.ctx.note(emitter, "its radiance is a picture: input to the radiosity, all its light counts as indirect")
        return name, glow.to_uv

    def add_shape(self, element: Element) -> None:
        """A <shape>, with its material and its area emitter."""
        name = unique(shape_name(element, self.ctx), self.meshes, "mesh")
        material = self._material_of(element, name)
        surface = self.surfaces.get(material)
        to_uv = surface.colour.to_uv if surface else None
        self.ctx.subject = f"mesh {name}"
        for _, emitter in children(element, "emitter", self.ctx):
            if emitter.get("type") != "area":
                raise self.ctx.fail(emitter, "only an area emitter may stand inside a shape")
            if any(n == "radiance" for n, _ in children(emitter, "texture", self.ctx)):
                material, to_uv = self._glowing(material, name, emitter)
                continue
            light = {"type": "area", "mesh": name, "radiance": power(emitter, "radiance", self.ctx), "tag": "engine"}
            self.lights[unique(name, self.lights)] = light
        self.geometry[name] = shape_arrays(element, self.ctx, to_uv)
        self.meshes[name] = {"material": material}

    def add(self, element: Element) -> None:
        """One child of <scene>."""
        self.ctx.subject = ""
        if element.tag == "shape":
            self.add_shape(element)
        elif element.tag == "emitter":
            kind = {"envmap": "sky", "constant": "sky"}.get(str(element.get("type")), str(element.get("type")))
            name = unique(element.get("id") or kind, self.lights, "light")
            self.lights[name] = convert_emitter(element, self.ctx, self.textures)
        elif element.tag == "sensor":
            name = unique(element.get("id") or "camera", self.cameras, "camera")
            self.cameras[name] = convert_sensor(element, self.ctx)
        elif element.tag in IGNORED_TAGS:
            self.ctx.note(element, "ignored")


def _pictured(surface: Surface) -> bool:
    """It needs texture coordinates."""
    return surface.colour.texture is not None or (surface.opacity is not None and surface.opacity.size > 1)


def _same(a: F64 | None, b: F64 | None) -> bool:
    return np.array_equal(np.eye(3) if a is None else a, np.eye(3) if b is None else b)


def _notes(reader: _Reader) -> list[str]:
    source = reader.ctx.source
    notes = list(reader.ctx.notes)
    if any(light["type"] == "area" for light in reader.lights.values()):
        notes.append(f"{source}: area emitters are tagged `engine`: their first light counts as direct")
    if any(light["tag"] == "input" for light in reader.lights.values()):
        notes.append(f"{source}: the sky is tagged `input`: all its light counts as indirect")
    if DEFAULT_MATERIAL in reader.materials:
        notes.append(f"{source}: shapes without a bsdf are diffuse 0.5, front only")
    return notes


def read_mitsuba_xml(path: Path) -> Document:
    """A Mitsuba XML scene through the whitelist. Raises InputError naming the file and the element."""
    root, ctx = parse(path)
    reader = _Reader(ctx)
    for element in root:
        reader.add(element)
    if not reader.meshes:
        raise InputError(f"{path}: the scene is empty (no <shape>); add one")
    notes = _notes(reader)
    if not reader.cameras:
        reader.cameras["view"], more = default_camera(reader.geometry.values())
        notes += more
    tables = ("materials", "meshes", "lights", "cameras")
    return Document(
        source=path,
        folder=path.parent,
        raw={table: getattr(reader, table) for table in tables},
        geometry=reader.geometry,
        textures=reader.textures,
        opacity={n: s.opacity for n, s in reader.surfaces.items() if s.opacity is not None},
        truth_bsdfs={n: s.truth for n, s in reader.surfaces.items() if s.truth is not None},
        passes_light=frozenset(n for n, s in reader.surfaces.items() if s.passes_light),
        notes=tuple(notes),
    )
