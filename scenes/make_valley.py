"""`valley`: half a kilometre outdoors, with small objects in it."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from bundle import bundle
from shapes import Point, Shape, heightfield, join, lathe, lump, polygons, smoothstep

HALF = 256.0
GRID = 64
PLAIN, RIVER, ROCK_HEIGHT = 34.0, 9.0, 42.0
# Along the valley (x), across from its middle line, length, width, height of the walls, turn in degrees.
HOUSES = (
    (-52.0, 22.0, 12.0, 8.0, 5.0, 10.0),
    (-30.0, 26.0, 9.0, 7.0, 3.5, -20.0),
    (-8.0, 20.0, 14.0, 8.0, 5.5, 5.0),
    (16.0, 28.0, 9.0, 7.0, 4.0, 75.0),
    (38.0, 21.0, 11.0, 8.0, 5.0, -10.0),
    (-20.0, -24.0, 10.0, 7.0, 4.0, 15.0),
    (30.0, -26.0, 12.0, 9.0, 5.5, -35.0),
)
TOWER = (3.0, 33.0, 5.0, 5.0, 10.0, 20.0)
TREES = (
    (-66.0, 30.0, 12.0),
    (-41.0, 36.0, 9.0),
    (27.0, 36.0, 13.0),
    (52.0, 30.0, 10.0),
    (-36.0, -22.0, 11.0),
    (8.0, -28.0, 14.0),
    (48.0, -22.0, 8.0),
    (-90.0, -30.0, 15.0),
)  # along, across, height
ROCKS = ((-110.0, 24.0, 4.5), (-75.0, -20.0, 3.0), (70.0, 18.0, 5.0), (95.0, -26.0, 6.5), (130.0, 22.0, 4.0))

TOML = """
description = "A valley of 512 m: hills, a river plain, a village of small objects; sun and sky"

[materials]
grass = { albedo = [0.2, 0.27, 0.11] }
rock = { albedo = [0.36, 0.34, 0.31] }
river = { albedo = [0.12, 0.16, 0.18] }
plaster = { albedo = [0.68, 0.64, 0.56] }
tiles = { albedo = [0.48, 0.22, 0.15] }
bark = { albedo = [0.25, 0.18, 0.12] }
needles = { albedo = [0.11, 0.2, 0.1] }

[meshes]
grass = { file = "grass.ply", material = "grass", probe_size = 16.0 }
hills = { file = "hills.ply", material = "rock", probe_size = 16.0 }
river = { file = "river.ply", material = "river", probe_size = 16.0 }
walls = { file = "walls.ply", material = "plaster", probe_size = 2.0 }
roofs = { file = "roofs.ply", material = "tiles", probe_size = 2.0 }
rocks = { file = "rocks.ply", material = "rock", probe_size = 2.0 }
trunks = { file = "trunks.ply", material = "bark", probe_size = 2.0 }
trees = { file = "trees.ply", material = "needles", probe_size = 2.0 }

[lights]
sun = { type = "directional", direction = [0.6, -0.5, -0.45], irradiance = [3.2, 2.9, 2.3], tag = "engine" }
sky = { type = "sky", radiance = [0.28, 0.36, 0.5], tag = "input" }

[volumes]
walkable = { min = [-200.0, $floor, -60.0], max = [200.0, $top, 60.0], probe_size = 8.0 }

[cameras]
overview = { origin = [-215.0, 75.0, 120.0], target = [10.0, 5.0, 5.0], fov_deg = 60.0 }
village = { origin = [-82.0, 9.0, -14.0], target = [0.0, 2.0, 16.0], fov_deg = 55.0 }

[placement]
min_voxel = 2.0
cull_error = 0.02

[sampling]
lod_distance = 100.0

[radiosity]
patch_size = 14.0

[truth]
noise = 0.04
points = 1000
"""

README = """
# valley

A valley of 512 × 512 m along x: hills of up to $peak m, a plain with a river in the middle, and in it 7 houses, a tower, 8 trees and 5
boulders, 3 to 15 m in size. $triangles triangles. A sun (direct) and a constant sky (input to the radiosity). All static, lit by probes.

- **Units**: metres, y up; the plain is at about y = 0. $licence
- **Geometry**: `grass`, `hills` and `river` are one height field of $grid × $grid cells, a single sheet facing up: a probe under it sees back
  faces. Houses, trees and boulders are closed above ground and stand a little in it; houses are solid (nothing inside) and have no underside.
- **Controls**: voxels of 16 m for the terrain, 2 m for objects; a walkable volume of 8 m voxels along the valley floor (parts of the box lie
  in the ground, at the foot of the hills). From 100 m on coarser levels of detail answer: half of what the cameras see, for an error of
  4.0 instead of 3.6 %.
- **Right answer**: the path-traced truth. Known beforehand: on the plain the indirect irradiance is close to π × sky radiance,
  [0.88, 1.13, 1.57], times the visible share of the sky, plus light from the sunlit slope.
- **Tests**: placement outdoors. Without a resolution per mesh an adaptive octree loses to a uniform grid here; with one it should need several
  times fewer probes at equal error. Small objects, not the hills, set the error. A scale 1,000 times Cornell's, so a test of tolerances too.
"""


def middle_line(x: float) -> float:
    """z of the middle of the valley."""
    return 26.0 * math.sin(x / 75.0)


def ground(x: float, z: float) -> float:
    """Height of the terrain, m."""
    off = abs(z - middle_line(x))
    hills = 50.0 + 16.0 * math.sin(x / 47.0 + 1.0) + 10.0 * math.sin(z / 31.0 + x / 90.0)
    rough = 1.8 * math.sin(x / 17.0) * math.sin(z / 19.0 + 0.7)
    slope = smoothstep(PLAIN, 190.0, off)
    return (
        slope * hills + smoothstep(PLAIN, 90.0, off) * rough - 1.5 * (1.0 - smoothstep(0.3, 1.0, off / (RIVER + 6.0)))
    )


def terrain() -> dict[str, Shape]:
    """The height field, its faces dealt out to three meshes."""
    lines = [-HALF + 2.0 * HALF * k / GRID for k in range(GRID + 1)]
    sheet = heightfield(lines, lines, ground)
    middles = sheet.vertices[sheet.faces].mean(axis=1)
    wet = abs(middles[:, 2] - [middle_line(x) for x in middles[:, 0]]) < RIVER
    bare = middles[:, 1] > ROCK_HEIGHT
    return {"grass": sheet.only(~wet & ~bare), "hills": sheet.only(bare), "river": sheet.only(wet)}


def lowest(x: float, z: float, reach: float) -> float:
    """Lowest ground within `reach`, m: where things stand, so that nothing floats."""
    steps = (-1.0, -0.5, 0.0, 0.5, 1.0)
    return min(ground(x + reach * a, z + reach * b) for a in steps for b in steps)


def house(along: float, across: float, length: float, width: float, height: float, turn: float) -> tuple[Shape, Shape]:
    """Walls with gables, and the two slopes of a saddle roof; no underside."""
    x, z = length / 2.0, width / 2.0
    ridge = height + 0.8 * z
    feet: list[Point] = [(-x, 0.0, -z), (x, 0.0, -z), (x, 0.0, z), (-x, 0.0, z)]
    points = feet + [(a, height, c) for a, _, c in feet] + [(-x, ridge, 0.0), (x, ridge, 0.0)]
    walls = polygons(points, (0, 4, 5, 1), (2, 6, 7, 3), (3, 7, 8, 4, 0), (1, 5, 9, 6, 2))
    roof = polygons(points, (4, 8, 9, 5), (6, 9, 8, 7))
    where = (along, lowest(along, middle_line(along) + across, 0.7 * length) - 0.3, middle_line(along) + across)
    return walls.moved(where, math.radians(turn)), roof.moved(where, math.radians(turn))


def tree(along: float, across: float, height: float) -> tuple[Shape, Shape]:
    """Trunk and a closed, nine-sided crown."""
    where = (along, lowest(along, middle_line(along) + across, 1.0) - 0.3, middle_line(along) + across)
    trunk = lathe([(0.05 * height, 0.0), (0.04 * height, 0.2 * height)], 7)
    profile = [(0.0, 0.18), (0.2, 0.22), (0.16, 0.5), (0.08, 0.8), (0.0, 1.0)]
    crown = lathe([(r * height, y * height) for r, y in profile], 9)
    return trunk.moved(where), crown.moved(where)


def boulders() -> Shape:
    """Lumps, a third of each in the ground."""
    rng = random.Random(7)
    parts = []
    for along, across, radius in ROCKS:
        z = middle_line(along) + across
        parts.append(lump(rng, radius, levels=1, rough=0.3).moved((along, ground(along, z) + 0.3 * radius, z)))
    return join(parts)


def objects() -> dict[str, Shape]:
    """All that stands on the terrain, one mesh per material."""

    def pairs(make: Callable[..., tuple[Shape, Shape]], rows: tuple[tuple[float, ...], ...]) -> tuple[Shape, Shape]:
        made = [make(*row) for row in rows]
        return join([a for a, _ in made]), join([b for _, b in made])

    walls, roofs = pairs(house, (*HOUSES, TOWER))
    trunks, trees = pairs(tree, TREES)
    return {"walls": walls, "roofs": roofs, "rocks": boulders(), "trunks": trunks, "trees": trees}


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    meshes = terrain() | objects()
    peak = round(float(meshes["hills"].vertices[:, 1].max()))
    return bundle(TOML, README, meshes, peak=peak, grid=GRID, floor=-1.0, top=5.0)
