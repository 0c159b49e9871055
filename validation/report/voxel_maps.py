"""Maps of a placement: the finest voxel in each column, seen from above and from the side, and of a section through the
middle (from above all of a closed room is its floor), for bitmap and octree.

A map is a table of octree levels over two axes of the world, with the scene's outline: what the record keeps and the page
draws (`bitmap_pictures.py`). Tables are packed as base64 of zlib of bytes, some kilobytes each.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from ...reference.datatypes import F64, I64, U8, Bool, Mesh, Scene
from ...reference.lattice import Grid, Octree, cells
from ...reference.placement.voxel_bitmap import VoxelBitmap
from ..plane_section import plane_section
from ..record_models import JsonObject

# Axes to the right and down, and whether down is negative: from above x and z, from the side (+z looking along -z) x and -y.
VIEWS: dict[str, tuple[int, int, bool]] = {"above": (0, 2, False), "side": (0, 1, True), "section": (0, 1, True)}
CUT = 2  # axis across the section
MOST_CELLS = 256  # along the longer side; finer voxels share a cell
PIXELS, LINE = 1024, 2  # along the longer side of the outline at most; width of its lines
MAX_LINES = 20_000
CREASE = np.cos(np.radians(35.0))  # faces that meet at a larger angle have an outline between them


def voxel_maps(scene: Scene, octree: Octree, bitmap: VoxelBitmap) -> list[JsonObject]:
    """The maps of a scene for its record: bitmap and octree in all VIEWS, on the lattice of `octree`."""
    grid = octree.grid
    middle = int(grid.extent[CUT]) // 2
    at = float(grid.origin[CUT] + (middle + 0.5) * grid.finest)
    whole = outline(scene.meshes)
    every = {"bitmap": [cells(k) for k in bitmap.occupied], "octree": list(octree.voxels)}
    maps = []
    for view, (across, down, upward) in VIEWS.items():
        cut = view == "section"
        shown = {w: sliced(grid, v, middle) for w, v in every.items()} if cut else every
        lines = (section(scene.meshes, at) if cut else whole) - grid.origin
        coarse = max(0, int(np.ceil(np.log2(max(grid.extent[[across, down]]) / MOST_CELLS))))
        shape = [-(-int(grid.extent[axis]) >> coarse) for axis in (down, across)]
        cell_m = grid.finest * (1 << coarse)
        scale = max(1, PIXELS // max(shape))
        turn = slice(None, None, -1 if upward else 1)
        maps.append(
            {
                "view": view,
                "voxel_m": [grid.size(n) for n in range(grid.level + 1)],
                "cells_by_level": [1 << max(0, grid.level - n - coarse) for n in range(grid.level + 1)],
                "width": shape[1],
                "height": shape[0],
                "scale": scale,
                "at_m": at if cut else None,
                **{what: packed(finest_levels(grid, v, (down, across), coarse)[turn]) for what, v in shown.items()},
                "outline": packed(np.packbits(draw_lines(lines[:, :, [across, down]] / cell_m, shape, scale)[turn])),
            }
        )
    return maps


def sliced(grid: Grid, voxels: Sequence[I64], index: int) -> list[I64]:
    """Per level those of the voxels (N, 3) that the layer `index` of finest cells across CUT runs through."""
    return [v[v[:, CUT] == index >> (grid.level - level)] for level, v in enumerate(voxels)]


def section(meshes: Sequence[Mesh], at: float) -> F64:
    """Lines (E, 2, 3) m along which triangles cross the plane at `at`, m, on the axis CUT."""
    corners = np.concatenate([np.zeros((0, 3, 3)), *(m.vertices[m.faces] for m in meshes)])
    return plane_section(corners, CUT, at)[:MAX_LINES]


def finest_levels(grid: Grid, voxels: Sequence[I64], axes: tuple[int, int], coarse: int) -> U8:
    """1 + the finest level with a voxel in each column of cells, 0 where there is none: (H, W) u8.

    voxels: per level (N, 3). axes: of rows and of columns. coarse: a cell is 2^coarse finest voxels wide.
    """
    height, width = (-(-int(grid.extent[axis]) >> coarse) for axis in axes)
    found = np.zeros((height, width), dtype=np.uint8)
    for level, v in enumerate(voxels):
        spread = grid.level - level - coarse
        rows, columns = v[:, axes[0]], v[:, axes[1]]
        if spread <= 0:
            found[rows >> -spread, columns >> -spread] = level + 1
            continue
        block = np.zeros((-(-height >> spread), -(-width >> spread)), dtype=np.bool_)
        block[rows, columns] = True
        wide = block.repeat(1 << spread, axis=0).repeat(1 << spread, axis=1)[:height, :width]
        found[wide] = level + 1
    return found


def outline(meshes: Sequence[Mesh]) -> F64:
    """Ends (E, 2, 3) m of edges where a mesh ends or is creased, longest first, MAX_LINES of them at most."""
    parts = [np.zeros((0, 2, 3))]
    for mesh in meshes:
        places, welded = np.unique(mesh.vertices, axis=0, return_inverse=True)
        faces = welded.reshape(-1)[mesh.faces]
        a, b, c = (places[faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        edges, of, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
        total = np.zeros((len(edges), 3))
        np.add.at(total, of.reshape(-1), np.repeat(normal, 3, axis=0))
        # Two unit normals at an angle α add up to 2 cos(α/2).
        flat = (count == 2) & (np.linalg.norm(total, axis=1) ** 2 > 2.0 + 2.0 * CREASE)
        parts.append(places[edges[~flat]])
    lines = np.concatenate(parts)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    return np.asarray(lines[np.argsort(-length, kind="stable")[:MAX_LINES]])


def draw_lines(lines: F64, shape: Sequence[int], scale: int) -> Bool:
    """Lines (E, 2, 2), in cells to the right and down, as pixels: `shape` (H, W) cells of `scale` × `scale`."""
    image = Image.new("1", (shape[1] * scale, shape[0] * scale))
    draw = ImageDraw.Draw(image)
    for (x0, y0), (x1, y1) in (lines * scale).tolist():
        draw.line((x0, y0, x1, y1), fill=1, width=LINE)
    return np.array(image, dtype=np.bool_)


def packed(values: U8) -> str:
    """Bytes as text: base64 of zlib."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(values).tobytes(), 9)).decode("ascii")
