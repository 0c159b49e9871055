"""Transforms of Mitsuba XML: the steps are applied in the order in which they are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..datatypes import F64
from .xml_values import Context, numbers, triple

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MIN_LENGTH = 1e-12


def unit(v: F64, element: Element, ctx: Context, what: str) -> F64:
    """v / |v|. Raises InputError if it has no length."""
    length = float(np.linalg.norm(v))
    if length < MIN_LENGTH:
        raise ctx.fail(element, f"{what} has no length")
    return v / length


def _matrix(element: Element, ctx: Context) -> F64:
    values = numbers(element.get("value"), ctx, element)
    if len(values) == 9:
        out = np.eye(4)
        out[:3, :3] = np.array(values).reshape(3, 3)
        return out
    if len(values) != 16:
        raise ctx.fail(element, f"expected 9 or 16 numbers, got {len(values)}")
    out = np.array(values, np.float64).reshape(4, 4)
    if not np.allclose(out[3], [0, 0, 0, 1]):
        raise ctx.fail(element, "the last row of the matrix must be 0 0 0 1")
    return out


def _rotate(element: Element, ctx: Context) -> F64:
    """Rodrigues' formula about the axis (x, y, z) by `angle` degrees."""
    axis = unit(np.array(triple(element, ctx)), element, ctx, "the axis of rotation")
    angle = np.radians(numbers(element.get("angle"), ctx, element)[0])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return out


def _lookat(element: Element, ctx: Context) -> F64:
    """Local +z looks from origin to target; columns left, up, direction, origin as in Mitsuba."""
    points = {
        k: np.array(numbers(element.get(k, d), ctx, element))
        for k, d in (("origin", ""), ("target", ""), ("up", "0 1 0"))
    }
    if any(p.shape != (3,) for p in points.values()):
        raise ctx.fail(element, "origin, target and up need three numbers each")
    direction = unit(points["target"] - points["origin"], element, ctx, "target - origin")
    left = unit(np.cross(points["up"], direction), element, ctx, "up × direction")
    out = np.eye(4)
    out[:3, :] = np.stack([left, np.cross(direction, left), direction, points["origin"]], axis=1)
    return out


def _step(element: Element, ctx: Context) -> F64:
    if element.tag == "matrix":
        return _matrix(element, ctx)
    if element.tag == "rotate":
        return _rotate(element, ctx)
    if element.tag == "lookat":
        return _lookat(element, ctx)
    out = np.eye(4)
    if element.tag == "translate":
        out[:3, 3] = triple(element, ctx)
    elif element.tag == "scale":
        out[:3, :3] = np.diag(triple(element, ctx, default=1.0))
    else:
        raise ctx.fail(element, "not a step of a transform")
    return out


def transform(element: Element, name: str, ctx: Context) -> F64:
    """(4, 4) f64 of the <transform name=…> inside `element`, the identity if there is none. Raises InputError."""
    out = np.eye(4)
    for child in element:
        if child.tag == "transform" and child.get("name") == name:
            for step in child:
                out = _step(step, ctx) @ out
    return out


def invertible(matrix: F64, element: Element, ctx: Context) -> F64:
    """The matrix itself. Raises InputError if it flattens space."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if scale.min() < MIN_LENGTH or abs(np.linalg.det(matrix[:3, :3] / scale)) < 1e-9:
        raise ctx.fail(element, "to_world flattens the shape to nothing; correct it")
    return matrix
