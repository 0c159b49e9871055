"""Mitsuba emitters to lights. Those that a game engine would light with are tagged `engine`, skies `input`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..datatypes import F32
from .images import read_sky
from .paths import resolve_inside
from .sky_turn import rotation_about_y, turned
from .xml_transforms import transform, unit
from .xml_values import Context, children, properties

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


def power(element: Element, name: str, ctx: Context) -> list[float]:
    """Three non-negative numbers of a radiometric parameter, 1 where it is not given. Raises InputError."""
    if any(n == name for n, _ in children(element, "texture", ctx)):
        raise ctx.fail(element, f"a textured {name} is not supported; give an <rgb>")
    value: Any = properties(element, ctx).get(name, 1.0)
    rgb = [float(x) for x in (value if isinstance(value, list) else [value] * 3)]
    if min(rgb) < 0.0:
        raise ctx.fail(element, f"{name} must not be negative, got {rgb}")
    return rgb


def _point(element: Element, ctx: Context) -> dict[str, Any]:
    matrix = transform(element, "to_world", ctx)
    position = properties(element, ctx).get("position", matrix[:3, 3].tolist())
    return {"type": "point", "position": position, "intensity": power(element, "intensity", ctx)}


def _spot(element: Element, ctx: Context) -> dict[str, Any]:
    matrix, values = transform(element, "to_world", ctx), properties(element, ctx)
    cutoff = float(values.get("cutoff_angle", 20.0))
    if children(element, "texture", ctx):
        ctx.note(element, "picture projected by the spot light ignored")
    return {
        "type": "spot",
        "position": matrix[:3, 3].tolist(),
        "direction": unit(matrix[:3, 2], element, ctx, "direction").tolist(),
        "intensity": power(element, "intensity", ctx),
        "cutoff_deg": cutoff,
        "beam_deg": float(values.get("beam_width", 0.75 * cutoff)),
    }


def _directional(element: Element, ctx: Context) -> dict[str, Any]:
    direction = properties(element, ctx).get("direction", transform(element, "to_world", ctx)[:3, 2].tolist())
    direction = unit(np.array(direction, np.float64), element, ctx, "direction").tolist()
    return {"type": "directional", "direction": direction, "irradiance": power(element, "irradiance", ctx)}


def _envmap(element: Element, ctx: Context, textures: dict[str, F32]) -> dict[str, Any]:
    values, matrix = properties(element, ctx), transform(element, "to_world", ctx)[:3, :3]
    name, where = str(values.get("filename", "")), f'{ctx.source}: <emitter type="envmap">'
    out: dict[str, Any] = {"type": "image_sky", "file": name, "scale": float(values.get("scale", 1.0))}
    path = resolve_inside(ctx.folder, name, where)
    degrees = rotation_about_y(matrix)
    if degrees is not None:
        return out | {"rotation_deg": degrees}
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3) or np.linalg.det(matrix) < 0:
        raise ctx.fail(element, "to_world of a sky must be a rotation; remove scale and mirroring")
    image, notes = read_sky(path, where)
    ctx.notes += notes
    ctx.note(element, "resampled, because it is rotated about an axis other than y")
    textures[f"turned:{name}"] = turned(image, matrix)
    return out | {"file": f"turned:{name}"}


def convert_emitter(element: Element, ctx: Context, textures: dict[str, F32]) -> dict[str, Any]:
    """Settings of a light that stands for itself (not on a shape). Raises InputError."""
    kind = str(element.get("type"))
    if kind == "area":
        raise ctx.fail(element, "an area emitter must stand inside a shape")
    if kind == "constant":
        return {"type": "sky", "radiance": power(element, "radiance", ctx), "tag": "input"}
    if kind == "envmap":
        return _envmap(element, ctx, textures) | {"tag": "input"}
    return {"point": _point, "spot": _spot, "directional": _directional}[kind](element, ctx) | {"tag": "engine"}
