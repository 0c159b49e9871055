"""Mitsuba sensors to cameras."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .xml_transforms import transform, unit
from .xml_values import Context, children, properties

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_WIDTH = 512
DEFAULT_SIZE = (768, 576)
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


def horizontal_fov(fov_deg: float, axis: str, aspect: float) -> float:
    """Full horizontal angle, degrees, of a field of view along `axis` (Mitsuba's fov_axis); aspect = width / height."""
    half = math.tan(math.radians(fov_deg) / 2)
    if axis == "y" or (axis == "smaller" and aspect > 1) or (axis == "larger" and aspect < 1):
        half *= aspect
    elif axis == "diagonal":
        half *= aspect / math.hypot(aspect, 1.0)
    return math.degrees(2 * math.atan(half))


def _fov(element: Element, ctx: Context, aspect: float) -> float:
    values = properties(element, ctx)
    axis = str(values.get("fov_axis", "x"))
    if axis not in ("x", "y", "diagonal", "smaller", "larger"):
        raise ctx.fail(element, "fov_axis must be x, y, diagonal, smaller or larger")
    fov = values.get("fov")
    if fov is None:
        try:
            millimetres = float(str(values.get("focal_length", "50mm")).removesuffix("mm"))
            fov, axis = math.degrees(2 * math.atan(FILM_DIAGONAL_MM / 2 / millimetres)), "diagonal"
        except (ValueError, ZeroDivisionError) as error:
            raise ctx.fail(element, "focal_length must read like 50mm") from error
    if not isinstance(fov, float | int) or not 0.0 < fov < 180.0:
        raise ctx.fail(element, f"fov must be between 0 and 180 degrees, got {fov}")
    return horizontal_fov(float(fov), axis, aspect)


def _size(element: Element, ctx: Context) -> tuple[int, int]:
    films = children(element, "film", ctx)
    values = properties(films[0][1], ctx) if films else {}
    width, height = (values.get(n, d) for n, d in zip(("width", "height"), DEFAULT_SIZE, strict=True))
    if not all(isinstance(n, int) and 1 <= n <= 1 << 20 for n in (width, height)):
        raise ctx.fail(element, "width and height of the film must be whole numbers from 1")
    if any(k.startswith("crop") for k in values):
        ctx.note(element, "crop window ignored")
    if width > MAX_WIDTH:
        small = MAX_WIDTH, max(8, round(height * MAX_WIDTH / width))
        ctx.note(element, f"picture reduced from {width} x {height} to {small[0]} x {small[1]}")
        return small
    return int(width), int(height)


def convert_sensor(element: Element, ctx: Context) -> dict[str, Any]:
    """Settings of a camera: local +z looks ahead, +y up. Raises InputError."""
    matrix = transform(element, "to_world", ctx)
    width, height = _size(element, ctx)
    forward = unit(matrix[:3, 2], element, ctx, "the direction of view")
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        ctx.note(element, "the camera mirrors its picture; ours does not")
    if element.get("type") == "thinlens":
        ctx.note(element, "depth of field ignored")
    origin = matrix[:3, 3]
    return {
        "origin": origin.tolist(),
        "target": (origin + forward).tolist(),
        "up": unit(matrix[:3, 1], element, ctx, "up").tolist(),
        "fov_deg": _fov(element, ctx, width / height),
        "width": width,
        "height": height,
    }
