"""Small scenes built in memory, without files: quads, boxes, spheres, and textures over a given octree."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from lightgauge.reference.config import MeshSettings, SceneSettings
from lightgauge.reference.datatypes import F64, Material, Mesh, Scene, Sky
from lightgauge.reference.lattice import OCTANTS, Grid, Octree, keys, unique_cells
from lightgauge.reference.placement.subdivision import NOTHING, corner_keys
from lightgauge.reference.texture_types import VirtualTexture
from lightgauge.reference.transport.patches import Patches, build_patches
from lightgauge.reference.visibility import Geometry, build_geometry
from lightgauge.reference.volume.indirection import build_indirection
from lightgauge.reference.volume.layout import TileLayout, build_layout
from lightgauge.reference.volume.tiles import fill_tiles

GREY = (0.5, 0.5, 0.5)
Array = npt.NDArray[Any]


def material(albedo: float | Sequence[float] = 0.5, two_sided: bool = False, **more: Any) -> Material:
    value = np.full(3, albedo) if np.ndim(albedo) == 0 else np.asarray(albedo, float)
    return Material("m", value, two_sided=two_sided, **more)


def mesh(
    vertices: Any, faces: Any, name: str = "mesh", mat: int = 0, emission: float | Sequence[float] = 0.0,
    engine: bool = False, closed: bool = False, probe_size: float | None = None, static: bool = True,
    lit_by_probes: bool = True, uvs: Any = None,
) -> Mesh:  # fmt: skip
    light = np.full(3, emission, float) if np.ndim(emission) == 0 else np.asarray(emission, float)
    return Mesh(
        name, np.asarray(vertices, np.float64), np.asarray(faces, np.int32), uvs, mat, static, lit_by_probes, probe_size,
        light, engine, closed,
    )  # fmt: skip


def polygon_mesh(vertices: Any, faces: Sequence[Sequence[int]], **more: Any) -> Mesh:
    """Polygons cut into fans of triangles (convex ones)."""
    triangles = [(f[0], f[i], f[i + 1]) for f in faces for i in range(1, len(f) - 1)]
    return mesh(vertices, triangles, **more)


def quad(corners: Any, **more: Any) -> Mesh:
    """A flat quadrilateral, counter-clockwise from its front."""
    return polygon_mesh(corners, [[0, 1, 2, 3]], **more)


def grid_quad(corners: Any, n: int, **more: Any) -> Mesh:
    """The same quad cut into n × n small ones."""
    a, b, _, d = np.asarray(corners, float)
    t = np.linspace(0.0, 1.0, n + 1)
    vertices = np.array([a + u * (b - a) + v * (d - a) for v in t for u in t])
    faces = [(j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i + 1, (j + 1) * (n + 1) + i)
             for j in range(n) for i in range(n)]  # fmt: skip
    return polygon_mesh(vertices, faces, **more)


def box_quads(lower: Sequence[float], upper: Sequence[float], inward: bool = True) -> list[F64]:
    """Corners (4, 3) of the six faces in the order -x, +x, -y, +y, -z, +z."""
    lo, hi = np.asarray(lower, float), np.asarray(upper, float)
    faces = []
    for axis in range(3):
        for side in (0, 1):
            b, c = (axis + 1) % 3, (axis + 2) % 3
            ring = [(0, 0), (1, 0), (1, 1), (0, 1)]  # counter-clockwise seen from +axis
            if (side == 1) == inward:
                ring = ring[::-1]
            corners = np.zeros((4, 3))
            corners[:, axis] = hi[axis] if side else lo[axis]
            for i, (x, y) in enumerate(ring):
                corners[i, b], corners[i, c] = (hi if x else lo)[b], (hi if y else lo)[c]
            faces.append(corners)
    return faces


def box(lower: Sequence[float], upper: Sequence[float], inward: bool = True, **more: Any) -> Mesh:
    quads = box_quads(lower, upper, inward)
    return polygon_mesh(np.concatenate(quads), [[4 * i + k for k in range(4)] for i in range(6)], closed=True, **more)


def sphere_mesh(radius: float = 1.0, subdivisions: int = 3, inward: bool = True, **more: Any) -> Mesh:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    faces = ball.faces[:, ::-1] if inward else ball.faces
    return mesh(ball.vertices, faces, closed=True, **more)


def scene(
    meshes: Sequence[Mesh], materials: Sequence[Material] | None = None, sky: Sky | None = None, **settings: Any
) -> Scene:
    """A scene of these meshes; `settings` as in scene.toml."""
    tables: Mapping[str, Any] = {"materials": {}, "meshes": {}, **settings}
    made = tuple(materials) if materials is not None else (material(),)
    return Scene("test", SceneSettings.model_validate(tables), tuple(meshes), made, sky, (), "0")


def with_lumels(s: Scene, sizes: Mapping[str, float]) -> Scene:
    """The same scene whose settings ask for lumels, edge in m by name of mesh."""
    tables = {name: MeshSettings(material="m", lumel_size=size) for name, size in sizes.items()}
    return dataclasses.replace(s, settings=s.settings.model_copy(update={"meshes": tables}))


def surfaces(s: Scene, size: float) -> tuple[Geometry, Patches]:
    g = build_geometry(s)
    return g, build_patches(s, g, size)


def one_patch_each(quads: Sequence[Any]) -> tuple[Geometry, Patches, Array]:
    """Every quadrilateral (4, 3) is a patch; third: the number of the patch that each became."""
    s = scene([quad(q, mat=i) for i, q in enumerate(quads)], [material(0.5)] * len(quads))
    g, p = surfaces(s, 1e9)
    number = np.zeros(len(quads), np.int64)
    number[g.mesh[p.element_triangle]] = p.element_patch
    return g, p, number


def random_units(n: int, seed: int) -> F64:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _corners(grid: Grid, voxels: Sequence[Array]) -> tuple[Array, Array]:
    """Distinct corners of the voxels (N_l, 3) of all levels on the finest lattice, and the coarsest level of each."""
    placed = NOTHING
    for level, cell in enumerate(voxels):
        placed = placed.plus(corner_keys(grid, level, keys(cell)))
    return placed.corners()


def tree_of(levels: Sequence[Array], finest: float = 1.0, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> Octree:
    """An octree with the given voxels per level; the grid covers the whole root."""
    top = len(levels) - 1
    grid = Grid(np.asarray(origin, float), finest, top, np.full(3, 1 << top, dtype=np.int64))
    voxels = [unique_cells(np.asarray(v, dtype=np.int64).reshape(-1, 3)) for v in levels]
    corners, level_of = _corners(grid, voxels)
    return Octree(grid, tuple(voxels), corners, level_of, 0)


def masked_tree(mask: int) -> Octree:
    """Levels 0 … 4: everything to level 2, then the children of one inner voxel of level 2 chosen by `mask`'s bits, each
    with all its own children."""
    two = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    children = 2 * np.array([1, 2, 1]) + OCTANTS[[bool(mask >> i & 1) for i in range(8)]]
    grandchildren = (2 * children[:, None, :] + OCTANTS[None]).reshape(-1, 3)
    return tree_of([[[0, 0, 0]], OCTANTS, two, children, grandchildren[: 8 * max(1, len(children) // 2)]][:5])


def random_tree(levels: int, share: float, seed: int) -> Octree:
    """Every voxel to level 1, then each child kept with probability `share`."""
    rng = np.random.default_rng(seed)
    voxels: list[Array] = [np.zeros((1, 3), np.int64), OCTANTS]
    for _ in range(2, levels + 1):
        children = (2 * voxels[-1][:, None, :] + OCTANTS[None]).reshape(-1, 3)
        keep = rng.random(len(children)) < share
        keep[0] = True
        voxels.append(children[keep])
    return tree_of(voxels)


def random_probes(count: int, invalid: float, seed: int) -> Array:
    """Texels (R, 13) f32 of probes: positive light, a share of them invalid (light and weight 0)."""
    rng = np.random.default_rng(seed)
    light = rng.random((count, 12)) + 0.5
    valid = rng.random(count) >= invalid
    return np.concatenate([light * valid[:, None], valid[:, None]], axis=1).astype(np.float32)


def texture_of(tree: Octree, probes: Array) -> tuple[VirtualTexture, TileLayout]:
    layout = build_layout(tree)
    grid = tree.grid
    texels = fill_tiles(layout, probes)
    return VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, build_indirection(layout), texels), layout
