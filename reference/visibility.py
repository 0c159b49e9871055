"""Ray casting against the static geometry, and where hits lie.

One merged Embree mesh, so that the primitive index is the triangle's number in the whole scene. Rays are cast in a
unit box (centre 0, half extent 1): epsilons are then relative to the scene, and closed edges far from the origin do
not leak (failure-catalogue A1, A2, A11). Dr.Jit arrays inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .datatypes import F32, F64, I32, Bool, Mesh, Scene
from .device_arrays import to_f32
from .variant import ensure_variant

# Origins are lifted off their surface by this share of the unit box: 16 ulp of float32 at 1.
LIFT = 2e-6


@dataclass(frozen=True, eq=False)
class Geometry:
    """Triangles of the static, opaque meshes, and the ray caster over them.

    vertices: (V, 3) f64 m. faces: (T, 3) i32. normals: (T, 3) f64 unit. areas: (T,) f64 m².
    mesh: (T,) i32, index into Scene.meshes. counts_as_back: (T,) bool, its back face is the inside of something
    (one-sided material or closed mesh). two_sided: (T,) bool.
    centre (3,), scale: world = centre + scale · unit box. caster: the Mitsuba scene. device_normals: `normals` as a
    flat mi.Float.
    """

    vertices: F64
    faces: I32
    normals: F64
    areas: F64
    mesh: I32
    counts_as_back: Bool
    two_sided: Bool
    centre: F64
    scale: float
    caster: Any
    device_normals: Any

    @property
    def lower(self) -> F64:
        """Smallest corner of the bounds, (3,) m."""
        return self.vertices.min(axis=0)

    @property
    def upper(self) -> F64:
        """Largest corner of the bounds, (3,) m."""
        return self.vertices.max(axis=0)


@dataclass(frozen=True, eq=False)
class Hits:
    """Dr.Jit arrays, one lane per ray. t: m, infinite where nothing is hit. triangle: valid where `hit`. u, v:
    barycentric weights of the triangle's second and third vertex. front: the ray meets the front face."""

    hit: Any
    t: Any
    triangle: Any
    u: Any
    v: Any
    front: Any


def mitsuba_mesh(
    name: str, vertices: F64, faces: I32, properties: dict[str, Any] | None = None, uvs: F32 | None = None
) -> Any:
    """A Mitsuba mesh without vertex normals from (V, 3) vertices, (F, 3) faces and (V, 2) texture coordinates."""
    import mitsuba as mi

    props = mi.Properties()
    for key, value in (properties or {}).items():
        props[key] = value
    mesh = mi.Mesh(name, len(vertices), len(faces), has_vertex_texcoords=uvs is not None, props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    if uvs is not None:
        params["vertex_texcoords"] = mi.Float(uvs.astype(np.float32).ravel())
    params.update()
    return mesh


def triangle_frames(vertices: F64, faces: I32) -> tuple[F64, F64]:
    """Unit normals (T, 3) and areas (T,) of triangles; degenerate ones get normal 0."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, np.finfo(np.float64).tiny)[:, None], 0.5 * length


def build_geometry(scene: Scene, moving: bool = False) -> Geometry:
    """Merge the opaque meshes: the static ones, which the bake sees, and on request those that move.

    Raises ValueError if there is none.
    """
    ensure_variant()
    import mitsuba as mi

    opaque = [(i, m) for i, m in enumerate(scene.meshes) if not scene.materials[m.material].passes_light]
    used = [(i, m) for i, m in opaque if m.static or moving]
    if not used:
        raise ValueError(f"scene '{scene.name}' has no static, opaque mesh: nothing reflects light")
    vertices, faces, owner = merge([m for _, m in used], [i for i, _ in used])
    normals, areas = triangle_frames(vertices, faces)
    two_sided = np.array([scene.materials[m.material].two_sided for m in scene.meshes])
    closed = np.array([m.closed for m in scene.meshes])
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    centre, scale = 0.5 * (lower + upper), float(0.5 * np.max(upper - lower))
    mesh = mitsuba_mesh("static", (vertices - centre) / scale, faces)
    caster = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "mesh": mesh})
    back = (~two_sided | closed)[owner]
    device_normals = to_f32(normals)
    return Geometry(
        vertices, faces, normals, areas, owner, back, two_sided[owner], centre, scale, caster, device_normals
    )


def merge(meshes: Sequence[Mesh], owners: Sequence[int]) -> tuple[F64, I32, I32]:
    """Vertices (V, 3), faces (T, 3) and owner (T,) of several meshes as one."""
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    vertices = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([m.faces + o for m, o in zip(meshes, offsets[:-1], strict=True)]).astype(np.int32)
    owner = np.repeat(np.asarray(owners, dtype=np.int32), [len(m.faces) for m in meshes])
    return vertices, faces, owner


def points_on_triangles(g: Geometry, triangle: npt.NDArray[np.integer], uv: npt.NDArray[np.floating]) -> F64:
    """Points (N, 3) m with barycentric weights `uv` (N, 2) of second and third vertex."""
    a, b, c = (g.vertices[g.faces[triangle, i]] for i in range(3))
    return np.asarray(a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a))


def cast(g: Geometry, origins: Any, directions: Any, reach: float | None = None) -> Hits:
    """Nearest hit of each ray. `origins`, `directions`: mi.Point3f / mi.Vector3f in *unit-box* coordinates; `reach`
    in unit-box lengths."""
    import drjit as dr
    import mitsuba as mi

    ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
    if reach is not None:
        ray.maxt = mi.Float(reach)
    found = g.caster.ray_intersect_preliminary(ray, coherent=False)
    hit = found.is_valid()
    triangle = dr.select(hit, found.prim_index, 0)
    normal = dr.gather(mi.Vector3f, g.device_normals, triangle, hit)
    front = dr.dot(normal, mi.Vector3f(directions)) < 0
    hits = Hits(hit, dr.select(hit, found.t * g.scale, dr.inf), triangle, found.prim_uv.x, found.prim_uv.y, hit & front)
    dr.eval(hits.hit, hits.t, hits.triangle, hits.u, hits.v, hits.front)  # one by one would trace the rays again
    return hits


def occluded(g: Geometry, origins: Any, directions: Any, distance: Any) -> Any:
    """Whether anything lies between: Dr.Jit mask. `distance` in unit-box lengths (may be infinite), Dr.Jit or NumPy."""
    import mitsuba as mi

    ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
    ray.maxt = to_f32(distance) if isinstance(distance, np.ndarray) else mi.Float(distance)
    return g.caster.ray_test(ray, coherent=False)


def to_box(g: Geometry, points: npt.NDArray[np.floating], normals: npt.NDArray[np.floating] | None = None) -> Any:
    """World points (N, 3) as mi.Point3f in the unit box, lifted along `normals` (N, 3) if given."""
    import mitsuba as mi

    p = (np.asarray(points, dtype=np.float64) - g.centre) / g.scale
    if normals is not None:
        p = p + LIFT * normals
    return mi.Point3f(*(to_f32(p[:, axis]) for axis in range(3)))


def vectors(directions: npt.NDArray[np.floating]) -> Any:
    """Directions (N, 3) as mi.Vector3f."""
    import mitsuba as mi

    d = np.asarray(directions)
    return mi.Vector3f(*(to_f32(d[:, axis]) for axis in range(3)))
