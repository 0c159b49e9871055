"""From a ray's hit to its column: patches, then the sky's bins, then one column that absorbs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..device_arrays import to_f32, to_u32
from ..sky import SKY_BINS, device_bin
from ..visibility import Geometry
from .patches import Patches


@dataclass(frozen=True, eq=False)
class DevicePatches:
    """What a kernel needs to find the patch of a hit. columns: patches + SKY_BINS + 1.

    plane (T,) Vector4f: normal, and the bits of the triangle's first element. cuts (T,) u32: twice the cuts per edge, plus
    1 where the back is the inside of something. sides (E,) Vector2u: column of an element's front and back.
    """

    columns: int
    plane: Any
    cuts: Any
    sides: Any


def upload_patches(g: Geometry, p: Patches) -> DevicePatches:
    """Put the patches' tables into device memory."""
    import drjit as dr

    absorbed = p.count + SKY_BINS
    first = p.first_element[:-1].astype(np.uint32).view(np.float32)
    sides = np.column_stack([p.element_patch, p.element_back]).astype(np.int64)
    made = DevicePatches(
        absorbed + 1,
        to_f32(np.column_stack([g.normals.astype(np.float32), first])),
        to_u32(2 * p.cuts.astype(np.int64) + g.counts_as_back),
        to_u32(np.where(sides < 0, absorbed, sides)),
    )
    dr.eval(made.plane, made.cuts, made.sides)
    return made


def columns_of_rays(g: Geometry, p: DevicePatches, origins: Any, directions: Any) -> tuple[Any, Any]:
    """Column (mi.UInt32) each ray ends in, and whether it met the inside of something (mask). Not evaluated: a part of
    the caller's kernel. origins: mi.Point3f in the unit box."""
    import drjit as dr
    import mitsuba as mi

    found = g.caster.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions)), coherent=False)
    hit = found.is_valid()
    triangle = dr.select(hit, found.prim_index, 0)
    plane = dr.gather(mi.Vector4f, p.plane, triangle)
    cuts = dr.gather(mi.UInt32, p.cuts, triangle)
    element = element_at(cuts >> 1, dr.reinterpret_array(mi.UInt32, plane.w), found.prim_uv.x, found.prim_uv.y)
    sides = dr.gather(mi.Vector2u, p.sides, element, hit)
    faces = plane.x * directions.x + plane.y * directions.y + plane.z * directions.z < 0
    first_sky = dr.opaque(mi.UInt32, p.columns - 1 - SKY_BINS)
    column = dr.select(hit, dr.select(faces, sides.x, sides.y), first_sky + device_bin(directions))
    return column, hit & ~faces & ((cuts & 1) == 1)


def element_at(cuts: Any, first: Any, u: Any, v: Any) -> Any:
    """`elements.element_of` inside a kernel; cuts, first: of the triangle hit."""
    import drjit as dr
    import mitsuba as mi

    k = mi.Float(cuts)
    uk, vk = u * k, v * k
    j = dr.minimum(mi.UInt32(dr.maximum(vk, 0.0)), cuts - 1)
    i = dr.minimum(mi.UInt32(dr.maximum(uk, 0.0)), cuts - 1 - j)
    upper = ((uk - mi.Float(i)) + (vk - mi.Float(j)) > 1.0) & (i + j < cuts - 1)
    return first + j * (2 * cuts - j) + 2 * i + dr.select(upper, mi.UInt32(1), mi.UInt32(0))
