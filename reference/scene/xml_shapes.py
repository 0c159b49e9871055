"""Mitsuba shapes to triangles in world space. The front is the side an area emitter on the shape shines to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from ..datatypes import F64
from .document import MeshArrays
from .obj import read_obj
from .paths import resolve_inside
from .ply import read_ply
from .primitives import PRIMITIVES
from .xml_transforms import invertible, transform, unit
from .xml_values import Context, properties

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

TURN_V = np.array([[1, -1], [0, 1]], np.float32)  # v ↦ 1 − v, as scale and offset
APPROXIMATED = {"disk": "64 sides", "sphere": "2,048 triangles", "cylinder": "48 sides"}


def shape_name(element: Element, ctx: Context) -> str:
    """What the shape is called before it is made unique: its id, its file's stem, or its type."""
    file = properties(element, ctx).get("filename")
    stem = PurePosixPath(str(file).replace("\\", "/")).stem if file else ""
    return element.get("id") or stem or str(element.get("type"))


def _from_file(element: Element, ctx: Context) -> MeshArrays:
    values = properties(element, ctx)
    name, where = str(values.get("filename", "")), f"{ctx.source}: <shape> filename"
    path = resolve_inside(ctx.folder, name, where)
    is_obj = element.get("type") == "obj"
    if is_obj:
        read = read_obj(path, where)
        # Mitsuba shades, and shines, to the side of the vertex normals; faces wound the other way are turned.
        turn = read.against_normals if not values.get("face_normals", False) else np.zeros(len(read.faces), bool)
        if turn.any():
            ctx.note(element, f"{int(turn.sum())} of {len(turn)} faces turned to the side of their vertex normals")
        mesh = MeshArrays(read.vertices, np.where(turn[:, None], read.faces[:, ::-1], read.faces), read.uvs)
    else:
        mesh = read_ply(path, where)
    # Mitsuba turns v over for OBJ and not for PLY, unless told; here v runs up for both.
    if mesh.uvs is not None and bool(values.get("flip_tex_coords", is_obj)) is False:
        mesh = replace(mesh, uvs=mesh.uvs * TURN_V[0] + TURN_V[1])
    return mesh


def _place_sphere(mesh: MeshArrays, values: dict[str, Any]) -> MeshArrays:
    radius = float(values.get("radius", 1.0))
    return replace(mesh, vertices=mesh.vertices * radius + np.array(values.get("center", [0.0, 0.0, 0.0])))


def _place_cylinder(mesh: MeshArrays, values: dict[str, Any], element: Element, ctx: Context) -> MeshArrays:
    p0, p1 = (np.array(values.get(n, d), np.float64) for n, d in (("p0", [0.0, 0, 0]), ("p1", [0.0, 0, 1])))
    axis = unit(p1 - p0, element, ctx, "p1 - p0")
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    side = unit(np.cross(helper, axis), element, ctx, "side")
    frame = np.stack([side, np.cross(axis, side), axis], axis=1)
    scale = np.array([values.get("radius", 1.0)] * 2 + [np.linalg.norm(p1 - p0)])
    return replace(mesh, vertices=(mesh.vertices * scale) @ frame.T + p0)


def _primitive(element: Element, ctx: Context) -> MeshArrays:
    kind, values = str(element.get("type")), properties(element, ctx)
    mesh = PRIMITIVES[kind]()
    if kind in ("sphere", "cylinder") and not float(values.get("radius", 1.0)) > 0.0:
        raise ctx.fail(element, f"radius must be positive, got {values.get('radius')}")
    if kind == "sphere":
        mesh = _place_sphere(mesh, values)
    elif kind == "cylinder":
        mesh = _place_cylinder(mesh, values, element, ctx)
    if kind in APPROXIMATED:
        ctx.note(element, f"approximated with {APPROXIMATED[kind]} of equal area")
    return mesh


def _map_uvs(mesh: MeshArrays, to_uv: F64 | None) -> MeshArrays:
    if mesh.uvs is None or to_uv is None:
        return mesh
    uvs = mesh.uvs.astype(np.float64) @ to_uv[:2, :2].T + to_uv[:2, 2]
    return replace(mesh, uvs=uvs.astype(np.float32))


def shape_arrays(element: Element, ctx: Context, to_uv: F64 | None) -> MeshArrays:
    """Triangles of a <shape> in world space. to_uv: the material's map of texture coordinates. Raises InputError.

    A mirroring to_world turns the winding of a primitive back, because its front is its normal's side, and leaves that
    of a mesh from a file, whose front is its winding's side (measured with Mitsuba 3.9.1).
    """
    from_file = element.get("type") in ("obj", "ply")
    mesh = _from_file(element, ctx) if from_file else _primitive(element, ctx)
    matrix = invertible(transform(element, "to_world", ctx), element, ctx)
    mirrored = bool(np.linalg.det(matrix[:3, :3]) < 0.0)
    turn = mirrored and not from_file
    if properties(element, ctx).get("flip_normals", False):
        turn = not turn
    faces = mesh.faces[:, ::-1].copy() if turn else mesh.faces
    with np.errstate(invalid="ignore", over="ignore"):  # broken vertices are refused later, by mesh and number
        vertices = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return _map_uvs(MeshArrays(vertices, faces, mesh.uvs), to_uv)
