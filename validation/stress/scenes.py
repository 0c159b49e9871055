"""Small scenes in memory, without files: rooms, plates, balls, quads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...reference.config import SceneSettings
from ...reference.datatypes import F32, F64, I64, Material, Mesh, Scene, Sky
from ...reference.transport.patches import Patches
from ...reference.visibility import Geometry
from ..benchmarks.places import split

QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def grey(albedo: float | Sequence[float] = 0.5, two_sided: bool = False, texture: F32 | None = None) -> Material:
    """A diffuse material of albedo 0 … 1, one number or three."""
    return Material("grey", np.full(3, 1.0) * np.asarray(albedo, np.float64), texture=texture, two_sided=two_sided)


def mesh(
    vertices: Any, faces: Any, material: int = 0, exitance: float = 0.0, closed: bool = False, engine: bool = False,
    uvs: F32 | None = None, name: str = "mesh", **more: Any,
) -> Mesh:  # fmt: skip
    """Triangles: static and lit by probes, unless `more` of Mesh's fields says otherwise. exitance: W·m⁻², what its front sends by
    itself; engine: that is a lamp of the engine's."""
    light = np.full(3, exitance / np.pi)
    corners, triangles = np.asarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32)
    plain: dict[str, Any] = {"static": True, "lit_by_probes": True, "probe_size": None}
    return Mesh(name=name, vertices=corners, faces=triangles, uvs=uvs, material=material, emission=light,
                engine_lit=engine, closed=closed, **{**plain, **more})  # fmt: skip


def quads_mesh(
    quads: Sequence[F64] | F64, material: int = 0, exitance: float = 0.0, closed: bool = False, **more: Any
) -> Mesh:
    """Quadrilaterals (N, 4, 3) m, counter-clockwise from their fronts, as one mesh with corners of their own."""
    corners = np.asarray(quads, np.float64).reshape(-1, 3)
    faces = (QUAD[None] + 4 * np.arange(len(corners) // 4)[:, None, None]).reshape(-1, 3)
    return mesh(corners, faces, material, exitance, closed, **more)


def quad(corner: npt.ArrayLike, along: npt.ArrayLike, across: npt.ArrayLike, **more: Any) -> Mesh:
    """A parallelogram at `corner` with edges `along`, `across` (3,), m; its front is where along × across points."""
    a, u, v = (np.asarray(x, np.float64) for x in (corner, along, across))
    return mesh(np.array([a, a + u, a + u + v, a + v]), QUAD, **more)


def box_faces(lower: npt.ArrayLike, upper: npt.ArrayLike, inward: bool = True, cuts: int = 1) -> list[F64]:
    """The six faces (cuts², 4, 3) m of a box in the order -x, +x, -y, +y, -z, +z."""
    lo, hi, faces = np.asarray(lower, np.float64), np.asarray(upper, np.float64), []
    for axis in range(3):
        for side in (0, 1):
            ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
            at = np.full((4, 3), side)
            at[:, (axis + 1) % 3], at[:, (axis + 2) % 3] = (ring[::-1] if (side == 1) == inward else ring).T
            faces.append(split(lo + at * (hi - lo), cuts))
    return faces


def box(
    lower: npt.ArrayLike, upper: npt.ArrayLike, inward: bool = True, cuts: int = 1, material: int = 0,
    exitance: float = 0.0, **more: Any,
) -> Mesh:  # fmt: skip
    """A closed box, seen from inside or outside, each face cut cuts × cuts."""
    return quads_mesh(np.concatenate(box_faces(lower, upper, inward, cuts)), material, exitance, True, **more)


def plate(x: tuple[float, float], z: tuple[float, float], y: float, up: bool) -> F64:
    """A level rectangle (4, 3) m whose front looks up or down."""
    ring = np.array([[x[0], y, z[0]], [x[0], y, z[1]], [x[1], y, z[1]], [x[1], y, z[0]]])
    return ring if up else ring[::-1]


def ball(
    subdivisions: int, material: int = 0, exitance: float = 0.0, centre: npt.ArrayLike = (0, 0, 0), radius: float = 1.0,
    inward: bool = True,
) -> Mesh:  # fmt: skip
    """An icosphere with its corners at `radius` m, seen from inside or outside."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    faces = np.asarray(made.faces)[:, ::-1] if inward else made.faces
    return mesh(made.vertices * radius + np.asarray(centre), faces, material, exitance, closed=True)


def even_sky(radiance: float) -> Sky:
    """A sky of one radiance, W·m⁻²·sr⁻¹, that is input to the radiosity."""
    return Sky(np.full((1, 1, 3), radiance, dtype=np.float32), 0.0, False)


def scene_of(
    meshes: Sequence[Mesh], materials: Sequence[Material] | None = None, sky: Sky | None = None, **settings: Any
) -> Scene:
    """A scene of these meshes, grey where no materials are given; `settings` as the tables of scene.toml."""
    tables: Mapping[str, Any] = {"materials": {}, "meshes": {}, **settings}
    made = tuple(materials) if materials is not None else (grey(),)
    return Scene("stress", SceneSettings.model_validate(tables), tuple(meshes), made, sky, (), "0")


def owners(g: Geometry, p: Patches) -> I64:
    """The mesh (P,) of each patch, backs included, for patches that do not reach over meshes."""
    owner = np.zeros(p.front, np.int64)
    owner[p.element_patch] = g.mesh[p.element_triangle]
    return owner[p.twin]
