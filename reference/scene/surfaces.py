"""Materials of a scene, from settings, pictures and what the loader kept for the ground truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..config import MaterialSettings
from ..datatypes import F32, Material
from ..errors import InputError
from .document import Document
from .images import MAX_TEXTURE_SIDE, read_picture, shrink
from .paths import resolve_inside

# What reflects more is clamped, and said. At 0.95 the truth's paths may still end by roulette, whose variance is unbounded
# from 0.975 on; at 0.98 each would have to run for 456 bounces.
MAX_ALBEDO = 0.95


def clamp_albedo(rgb: Iterable[float], where: str) -> tuple[list[float], list[str]]:
    """Reflectance of a foreign file, brought into 0..MAX_ALBEDO, and a note if it was not. InputError for NaN."""
    values = [float(x) for x in rgb]
    if not all(math.isfinite(x) for x in values):
        raise InputError(f"{where}: reflectance is not finite: {values}; correct it")
    inside = [min(max(x, 0.0), MAX_ALBEDO) for x in values]
    notes = [] if inside == values else [f"{where}: albedo {max(values):.3f} clamped to {MAX_ALBEDO}"]
    return inside, notes


def _texture(key: str, document: Document, where: str) -> tuple[F32, list[str]]:
    """(H, W, 3) f32 diffuse albedo under MAX_ALBEDO, and notes."""
    notes = []
    image = document.textures.get(key)
    if image is None:
        picture = read_picture(resolve_inside(document.folder, key, where), where)
        image = picture.rgb
        if picture.alpha is not None and picture.alpha.min() < 1.0 and not document.opacity:
            notes.append(f"{where}: {key}: alpha ignored")
    top = float(image.max())
    if top > MAX_ALBEDO or float(image.min()) < 0.0:
        notes.append(f"{where}: {key}: albedo up to {top:.3f} clamped to {MAX_ALBEDO}")
        image = np.clip(image, 0.0, MAX_ALBEDO).astype(np.float32)
    return shrink(image, MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE), notes


def _emission_texture(settings: MaterialSettings, document: Document, where: str) -> tuple[F32 | None, list[str]]:
    """(H, W, 3) f32 factor of the emission, None where it changes nothing, and notes. Raises InputError."""
    key = settings.emission_texture
    if key is None:
        return None, []
    if not any(settings.emission):
        return None, [f"{where}: {key}: emission is 0, so the picture has no effect"]
    image = document.textures.get(key)
    if image is None:
        image = read_picture(resolve_inside(document.folder, key, where), where).rgb
    if float(image.min()) < 0.0:
        raise InputError(f"{where}: {key}: the picture holds negative radiance; repair it")
    return shrink(image, MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE), []


def masked(body: Mapping[str, Any], opacity: F32) -> dict[str, Any]:
    """Mitsuba's `mask` around a bsdf: a constant opacity as a number, a picture as "@opacity"."""
    value = float(opacity[0, 0]) if opacity.size == 1 else "@opacity"
    return {"type": "mask", "opacity": value, "bsdf": body}


def make_material(
    name: str, settings: MaterialSettings, document: Document, overridden: bool
) -> tuple[Material, list[str]]:
    """One material. overridden: the user changed its reflectance, so what the file says of gloss no longer holds."""
    where = f"{document.source}: materials.{name}"
    texture, notes = None, list[str]()
    albedo = np.array(settings.albedo, np.float64)
    if settings.texture is not None:
        texture, notes = _texture(settings.texture, document, f"{where}.texture")
        albedo = texture.mean(axis=(0, 1), dtype=np.float64)
    glow, more = _emission_texture(settings, document, f"{where}.emission_texture")
    notes += more
    truth = document.truth_bsdfs.get(name)
    if overridden and truth is not None:
        truth = None
        notes.append(f"{where}: reflectance overridden, the ground truth sees it as diffuse too")
    material = Material(
        name=name,
        albedo=albedo,
        texture=texture,
        two_sided=settings.two_sided,
        passes_light=name in document.passes_light,
        truth_bsdf=truth,
        opacity=document.opacity.get(name),
        emission_texture=glow,
    )
    return material, notes


def _without_pictures(value: Any, colour: list[float], opacity: float) -> Any:
    if isinstance(value, Mapping):
        return {k: _without_pictures(v, colour, opacity) for k, v in value.items()}
    if value == "@texture":
        return {"type": "rgb", "value": colour}
    return opacity if value == "@opacity" else value


def plain_twin(material: Material) -> Material:
    """The material for meshes without texture coordinates: mean colour and mean opacity instead of pictures."""
    opacity = 1.0 if material.opacity is None else float(material.opacity.mean())
    truth = material.truth_bsdf
    if truth is not None:
        truth = _without_pictures(truth, [float(x) for x in material.albedo], opacity)
    constant = None if material.opacity is None else np.full((1, 1), opacity, np.float32)
    name = f"{material.name} (plain)"
    return replace(material, name=name, texture=None, truth_bsdf=truth, opacity=constant, emission_texture=None)
