"""Worlds for the fast path's bench: hills of any size as a real octree, its tiles, smooth light, and places to sample it.

    height(x, z) = three sines, at most 4 finest voxels up or down

Voxels are halved where the hills pass through them, to the finest level in places that an artist would have marked, one or two levels
less elsewhere. All worlds have the same hills about the same centre, on the same lattice: only how far they go on differs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...reference.datatypes import F32, F64, I32, I64, Bool
from ...reference.lattice import OCTANTS, Grid, Octree, cells, keys
from ...reference.placement.subdivision import NOTHING, all_children, corner_keys
from ...reference.texture_types import TileTable, VirtualTexture
from ...reference.volume.indirection import build_indirection
from ...reference.volume.layout import TileLayout, build_layout
from ...reference.volume.table import tile_table
from ...reference.volume.tiles import fill_tiles, probe_texels, with_copies

Floats = F32 | F64 | float
FINEST = 0.5  # m
THICKNESS = 16  # finest voxels from the floor to the ceiling of a world, its hills half way up
AMPLITUDE = 4.0 * FINEST
WIDTH, HEIGHT = 1920, 1080
NEAR, SLOPE = 1e-3, 1.05  # m; of the hills, at most
STEPS = 64
BURIED = 1.5  # voxels under the hills: probes there are invalid


@dataclass(frozen=True, eq=False)
class World:
    """tree: its octree. layout: its tiles. light (R, 4, 3) f32 radiance SH of the probes; light_from (R,) i32, -1 for invalid ones."""

    tree: Octree
    layout: TileLayout
    light: F32
    light_from: I32

    @property
    def grid(self) -> Grid:
        """Its lattice."""
        return self.layout.grid

    @property
    def table(self) -> TileTable:
        """All tiles, for streaming."""
        return tile_table(self.layout, self.light_from)

    @property
    def texture(self) -> VirtualTexture:
        """All tiles, filled, with their indirection."""
        grid = self.grid
        texels = fill_tiles(self.layout, probe_texels(*with_copies(self.light, self.light_from)))
        indirection = build_indirection(self.layout)
        return VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, indirection, texels)


def height(x: Floats, z: Floats) -> Any:
    """Of the hills, m."""
    crossing = 0.5 * np.sin(0.31 * x + 0.4) * np.cos(0.23 * z)
    return AMPLITUDE * (crossing + 0.3 * np.sin(0.53 * z + 1.0) + 0.2 * np.sin(0.71 * (x + z)))


def finest_wanted(x: F64, z: F64, level: int) -> I32:
    """Level that an artist asks for at a place: `level`, less one on two fifths of the ground, less two on one fifth or so."""
    mask = np.sin(0.11 * x) + np.sin(0.09 * z + 1.0)
    return np.asarray(level - (mask < -0.3) - (mask < -1.0), dtype=np.int32)


def grid_of(side: int) -> Grid:
    """The lattice of the world of `side` finest voxels."""
    level = max(4, math.ceil(math.log2(side)))
    origin = FINEST * np.array([-side / 2, -THICKNESS / 2, -side / 2])
    return Grid(origin, FINEST, level, np.array([side, THICKNESS, side]))


def build_world(side: int, sparse: bool = False) -> World:
    """The world of `side` finest voxels, an even number, by 16 by as many. sparse: only children that the hills pass through have
    probes ("child-only"), otherwise all eight."""
    grid = grid_of(side)
    tree = _octree(grid, sparse)
    up = tree.positions[:, 1] - height(tree.positions[:, 0], tree.positions[:, 2])
    size = FINEST * np.exp2(grid.level - tree.corner_level)
    number = np.arange(len(up), dtype=np.int32)
    return World(
        tree, build_layout(tree), _light(tree.positions), np.where(up > -BURIED * size, number, -1).astype(np.int32)
    )


def _octree(grid: Grid, sparse: bool) -> Octree:
    voxel = keys(np.zeros((1, 3), dtype=np.int64))
    voxels, placed = [voxel], NOTHING.plus(corner_keys(grid, 0, voxel))
    for level in range(1, grid.level + 1):
        voxel = all_children(grid, level, voxel[_crossed(grid, level - 1, cells(voxel), level)])
        if sparse:
            voxel = voxel[_crossed(grid, level, cells(voxel), level)]
        voxels.append(voxel)
        placed = placed.plus(corner_keys(grid, level, voxel))
    return Octree(grid, tuple(map(cells, voxels)), *placed.corners(), 0)


def _crossed(grid: Grid, level: int, voxels: I64, wanted: int) -> Bool:
    """Which voxels (N, 3) of `level` hold ground that wants the level `wanted` or finer."""
    size = grid.size(level)
    corners = grid.origin + size * (voxels[:, None] + np.concatenate([OCTANTS, [[0.5, 0.5, 0.5]]]))
    ground = height(corners[..., 0], corners[..., 2])
    reach = 0.25 * SLOPE * size if size < 8.0 else AMPLITUDE  # what the hills may do between the places looked at
    low, high = corners[:, 0, 1], corners[:, 0, 1] + size
    asked = finest_wanted(corners[..., 0], corners[..., 2], grid.level).max(axis=1)
    return (ground.min(axis=1) - reach < high) & (ground.max(axis=1) + reach > low) & (asked >= wanted)


def _light(p: F64) -> F32:
    """Radiance SH (R, 4, 3) that varies slowly, W·m⁻²·sr⁻¹."""
    base = 1.0 + 0.5 * np.sin(p @ np.array([[0.2, 0.3, 0.1], [0.1, 0.2, 0.4], [0.3, 0.1, 0.2]]))
    order1 = np.stack([0.3 * np.sin(0.4 * p[:, axis, None] + np.arange(3)) for axis in (1, 2, 0)], axis=1)
    return np.concatenate([base[:, None], order1], axis=1).astype(np.float32)


def view(grid: Grid, eye: F64, pixels: tuple[int, int] = (WIDTH, HEIGHT)) -> tuple[F32, F32]:
    """What each pixel of a camera sees, row by row: positions (N, 3) f32 m on the hills, or where the ray leaves the bounds
    of `grid`, and normals (N, 3) f32.

    The camera looks along +x and a little down, 70° wide.
    """
    width, high = pixels
    across, down = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, (np.arange(high) + 0.5) / high - 0.5)
    ray = np.stack([np.ones_like(across), -0.22 - 1.4 * high / width * down, 1.4 * across], axis=-1).reshape(-1, 3)
    ray = (ray / np.linalg.norm(ray, axis=1, keepdims=True)).astype(np.float32)
    low, top = grid.origin, grid.origin + grid.extent * grid.finest
    with np.errstate(divide="ignore"):
        leaves = (np.where(ray > 0.0, top, low) - eye) / ray
    end = leaves.min(axis=1).astype(np.float32)
    at, eye32 = np.zeros(len(ray), dtype=np.float32), eye.astype(np.float32)
    going = np.arange(len(ray))
    for _ in range(STEPS):  # no ray comes nearer to the hills than so much per metre, so this steps over none
        p = eye32 + ray[going] * at[going, None]
        gap = p[:, 1] - height(p[:, 0], p[:, 2])
        at[going] = np.minimum(at[going] + gap / math.hypot(1.0, SLOPE), end[going])
        going = going[(gap > NEAR) & (at[going] < end[going])]
    p = eye32 + ray * at[:, None]
    return p, _normals(p)


def scattered(grid: Grid, count: int, seed: int = 0) -> tuple[F32, F32]:
    """`count` positions (N, 3) f32 m anywhere within the bounds of `grid`, and normals anyhow."""
    rng = np.random.default_rng(seed)
    p = grid.origin + rng.random((count, 3)) * grid.extent * grid.finest
    n = rng.normal(size=(count, 3))
    return p.astype(np.float32), (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)


def _normals(p: F32) -> F32:
    """Of the hills, by differences over 2 mm."""
    x, z = p[:, 0].astype(np.float64), p[:, 2].astype(np.float64)
    along = [(height(x + a, z + b) - height(x - a, z - b)) / (2.0 * NEAR) for a, b in ((NEAR, 0.0), (0.0, NEAR))]
    n = np.stack([-along[0], np.ones_like(x), -along[1]], axis=1)
    return (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
