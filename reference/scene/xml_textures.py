"""Colours of Mitsuba materials: constant, bitmap or checkerboard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..datatypes import F32, F64
from .images import Picture, read_picture, shrunk
from .paths import resolve_inside
from .surfaces import MAX_ALBEDO
from .xml_transforms import transform
from .xml_values import Context, children, properties

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

LUMINANCE = np.array([0.212671, 0.715160, 0.072169], np.float32)  # Rec. 709, as in Mitsuba
CHECKER_TEXELS = 64


@dataclass(frozen=True, eq=False)
class Colour:
    """rgb where `texture` is None. texture: key of a picture. images: pictures that are no files, by key.
    to_uv: (3, 3) map of texture coordinates (v up), or None."""

    rgb: list[float]
    texture: str | None = None
    images: Mapping[str, F32] = field(default_factory=dict)
    to_uv: F64 | None = None


def _file(element: Element, ctx: Context) -> tuple[str, Path, bool]:
    """File name as written, where it is, and whether its numbers are linear already."""
    values = properties(element, ctx)
    name = str(values.get("filename", ""))
    raw = values.get("raw") is True or values.get("gamma") == 1.0
    return name, resolve_inside(ctx.folder, name, f"{ctx.where(element)} filename"), raw


def _to_uv(element: Element, ctx: Context) -> F64 | None:
    """Map of texture coordinates: `to_uv`, or uscale, vscale, uoffset, voffset of the old dialect.

    Mitsuba's v runs down the picture, ours up: v → 1 − v before and after.
    """
    m = transform(element, "to_uv", ctx)[np.ix_([0, 1, 3], [0, 1, 3])]
    values = properties(element, ctx)
    old = {k: values[k] for k in ("uscale", "vscale", "uoffset", "voffset") if isinstance(values.get(k), float)}
    if old:
        m = np.diag([old.get("uscale", 1.0), old.get("vscale", 1.0), 1.0])
        m[:2, 2] = old.get("uoffset", 0.0), old.get("voffset", 0.0)
    if np.array_equal(m, np.eye(3)):
        return None
    flip = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])
    return flip @ m @ flip


def _checkerboard(element: Element, ctx: Context) -> Colour:
    values = properties(element, ctx)
    a, b = (np.broadcast_to(np.array(values.get(n, d), np.float32), 3) for n, d in (("color0", 0.4), ("color1", 0.2)))
    half = np.arange(CHECKER_TEXELS) >= CHECKER_TEXELS // 2
    same = (half[:, None] == half[None, :])[..., None]
    key = f"checkerboard:{a.tolist()}:{b.tolist()}"
    image = np.clip(np.where(same, a, b), 0.0, MAX_ALBEDO).astype(np.float32)
    return Colour([0.5] * 3, key, {key: image}, _to_uv(element, ctx))


def _textured(element: Element, ctx: Context) -> Colour:
    if element.get("type") == "checkerboard":
        return _checkerboard(element, ctx)
    name, path, raw = _file(element, ctx)
    to_uv = _to_uv(element, ctx)
    if not raw:  # read when the scene is built, as pictures of a scene.toml are
        return Colour([0.5] * 3, name, {}, to_uv)
    key = f"raw:{name}"
    return Colour([0.5] * 3, key, {key: shrunk(read_picture(path, ctx.where(element), raw=True)).rgb}, to_uv)


def colour(element: Element, names: tuple[str, ...], default: float, ctx: Context) -> Colour:
    """The first of the parameters `names` that the plugin has: number, rgb or texture. Raises InputError."""
    textures = dict(children(element, "texture", ctx))
    values: dict[str, Any] = properties(element, ctx)
    for name in names:
        if name in textures:
            return _textured(textures[name], ctx)
        if isinstance(values.get(name), list | float | int):
            value = values[name]
            return Colour(list(value) if isinstance(value, list) else [float(value)] * 3)
    return Colour([default] * 3)


def opacity_of(element: Element, texture: str | None, ctx: Context) -> tuple[F32, Picture | None]:
    """(H, W) f32 opacity of a mask; and its picture, if it is the one the reflectance takes its colour from.

    A picture's alpha channel counts where it has one, else its luminance as in Mitsuba.
    """
    textures = dict(children(element, "texture", ctx))
    found = textures.get("opacity")
    if found is None:
        c = colour(element, ("opacity",), 0.5, ctx)
        return np.full((1, 1), np.clip(np.dot(c.rgb, LUMINANCE), 0.0, 1.0), np.float32), None
    if found.get("type") != "bitmap":
        raise ctx.fail(element, "the opacity must be a number or a bitmap")
    name, path, raw = _file(found, ctx)
    picture = shrunk(read_picture(path, ctx.where(found), raw))
    if _to_uv(found, ctx) is not None:
        raise ctx.fail(element, "an opacity picture with its own to_uv is not supported; bake it into the mesh")
    if picture.alpha is None:
        return np.clip(picture.rgb @ LUMINANCE, 0.0, 1.0).astype(np.float32), None
    ctx.note(element, f"opacity from the alpha channel of {name}")
    return picture.alpha, picture if name == texture else None


def fill_transparent(picture: Picture) -> F32:
    """The picture's colour, with the mean of what can be seen wherever it is fully transparent."""
    if picture.alpha is None or not picture.alpha.any():
        return picture.rgb
    weight = picture.alpha[..., None].astype(np.float64)
    mean = (picture.rgb * weight).sum(axis=(0, 1)) / weight.sum()
    return np.where(weight > 0.0, picture.rgb, mean).astype(np.float32)
