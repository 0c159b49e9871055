"""`house`: the talk's example: rolling terrain, two trees and a house one can walk into."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from bundle import bundle
from cells import Cells
from shapes import Point, Shape, heightfield, join, lathe, lump, smoothstep

HALF = 20.0  # half the terrain's side
GRID = 32
X, Z = 4.0, 3.0  # half the house's outline
WALL, PARTITION, EAVES, ROOF = 0.25, (0.9, 1.05), 0.5, 0.2
BASE, FLOOR, SILL, HEAD, EAVE, PITCH = -0.02, 0.15, 0.9, 2.1, 2.6, 0.55
DOOR, WINDOW, SIDE_WINDOW, DOORWAY = (-0.4, 0.6), (-3.0, -1.4), (-1.0, 0.8), (-1.6, -0.7)
WALLS, TILES, WOOD, SCREEN = 1, 2, 3, 4
NAMES = {WALLS: "house_walls", TILES: "house_roof", WOOD: "house_floor", SCREEN: "house_partition"}
TREES = {"tree_a": ((-8.5, 4.0), 6.2, 11), "tree_b": ((8.5, -5.5), 7.0, 12)}  # x and z, height, seed

TOML = """
description = "The talk's example: rolling terrain, two trees and a house with a door, two windows and two rooms; sun and sky"

[materials]
grass = { albedo = [0.18, 0.26, 0.1] }
bark = { albedo = [0.25, 0.18, 0.12] }
leaves = { albedo = [0.16, 0.3, 0.1] }
plaster = { albedo = [0.7, 0.67, 0.6] }
tiles = { albedo = [0.45, 0.2, 0.14] }
wood = { albedo = [0.42, 0.29, 0.18] }
teal = { albedo = [0.25, 0.45, 0.5] }

[meshes]
terrain = { file = "terrain.ply", material = "grass", probe_size = 1.0 }
tree_a_trunk = { file = "tree_a_trunk.ply", material = "bark", probe_size = 0.25 }
tree_a_crown = { file = "tree_a_crown.ply", material = "leaves", probe_size = 0.5 }
tree_b_trunk = { file = "tree_b_trunk.ply", material = "bark", probe_size = 0.25 }
tree_b_crown = { file = "tree_b_crown.ply", material = "leaves", probe_size = 0.5 }
house_walls = { file = "house_walls.ply", material = "plaster", probe_size = 0.25 }
house_roof = { file = "house_roof.ply", material = "tiles", probe_size = 0.25 }
house_floor = { file = "house_floor.ply", material = "wood", probe_size = 0.5, lumel_size = 0.5 }
house_partition = { file = "house_partition.ply", material = "teal", probe_size = 0.5 }

[lights]
sun = { type = "directional", direction = [-0.45, -0.55, -0.7], irradiance = [3.2, 2.9, 2.4], tag = "engine" }
sky = { type = "sky", radiance = [0.28, 0.36, 0.5], tag = "input" }

[volumes]
walkable = { min = [-19.0, -1.0, -19.0], max = [19.0, 2.0, 19.0], probe_size = 4.0 }
indoors = { min = [-3.6, 0.3, -2.6], max = [3.6, 2.5, 2.6], probe_size = 0.5 }

[cubemaps]
indoors = { position = [0.4, 1.5, 0.3], size = 16 }

[cameras]
outside = { origin = [11.0, 4.5, 15.0], target = [0.8, 1.6, 0.0], fov_deg = 62.0, width = 336, height = 252 }
inside = { origin = [-3.4, 1.7, -2.3], target = [1.0, 1.0, 1.2], fov_deg = 85.0, width = 336, height = 252 }

[placement]
min_voxel = 0.25
cull_error = 0.02
probe_noise = 0.04

[radiosity]
patch_size = 1.1

[truth]
noise = 0.04
points = 1000
"""

EVENING = """
# Other light for the baked house: a low warm sun that shines in by the door and the windows, and a dim blue sky.
scene = "house"

[lights.sun]
direction = [-0.55, -0.22, -0.8]
irradiance = [1.9, 0.95, 0.4]

[lights.sky]
radiance = [0.05, 0.08, 0.16]
"""

README = """
# house

The talk's example: rolling terrain of 40 × 40 m, two trees, and a house of 8 × 6 m with a door and a window to the front (+z), a window to
the side (+x), two rooms open to the roof, and a doorway between them. $triangles triangles. A sun (direct) and a constant sky (input to the
radiosity). Everything is static and lit by probes.

- **Units**: metres, y up. $licence
- **Geometry**: the four `house_*` meshes together are one surface without gaps, T-junctions or faces inside walls: walls of $wall m, a
  partition of 0.15 m, a roof slab with eaves. It is open only underneath, along its outline at y = $base: the terrain is level
  there (y = 0) and reaches halfway under the walls, and there is no terrain under the floor. `terrain` is a single sheet facing up;
  a probe under it sees back faces, and under its edge the sky. Crowns are closed lumps that do not touch each other.
- **Controls**: voxels of 1 m for the terrain, 0.5 m for the trees' crowns, the house's floor and its partition, 0.25 m for the trunks
  and the rest of the house. The talk's control, the right-hand tree at half the resolution, is
  `--set meshes.tree_b_crown.probe_size=1.0`: 4 % fewer probes, and the outdoor error rises by 7 % of itself. A walkable volume of 4 m
  over the terrain, up to y = 2 m (its lower part lies in the ground; at 2 m: 0.7 % more probes, the error within 1 % of itself the same,
  in the volume too), and a volume of 0.5 m indoors.
- **Bake**: `lightgauge bake house` also keeps lumels of 0.5 m on the floor and a cubemap in the larger room.
- **Evening**: `evening.toml` is a lights file, other light for a bake of this scene: a low warm sun and a dim blue sky.
- **Right answer**: the path-traced truth. Known beforehand: on open level ground the indirect irradiance is close to π × sky radiance,
  [0.88, 1.13, 1.57], times the visible share of the sky, plus a few percent from the hills; indoors it is an order of magnitude less.
- **Tests**: adaptivity (one number hides the room: read indoors and outdoors apart), per-mesh resolution, foliage. By
  t ≥ h(|nx|+|ny|+|nz|) the walls ($wall m, axis-aligned) need voxels of 0.25 m, which they have; the partition (0.15 m) needs 0.15 m
  and the sloping roof (0.175 m) 0.13 m, so a little light may leak there and must be reported. (At 0.25 m the
  partition leaves the room's error as it is at 0.5 m, for 4 % more probes.) Coarser `meshes.house_walls.probe_size` (the talk's walls are thinner than its voxels) shows the leak grow.
"""


def ground(x: float, z: float) -> float:
    """Height of the terrain, m: level around the house, up to 2 m high farther out."""
    beyond = math.hypot(max(abs(x) - X - 1.2, 0.0), max(abs(z) - Z - 1.2, 0.0))
    waves = 0.9 * math.sin(0.23 * x + 0.6) * math.cos(0.19 * z - 0.4) + 0.5 * math.sin(0.37 * z + 0.13 * x + 1.0)
    return smoothstep(0.0, 9.0, beyond) * (0.4 + waves)


def terrain() -> Shape:
    """Sheet with a hole under the house, whose rim lies in the middle of the walls."""
    xs, zs = ([-HALF + 2.0 * HALF * k / GRID for k in range(GRID + 1)] for _ in range(2))
    rim_x, rim_z = X - WALL / 2.0, Z - WALL / 2.0
    for lines, rim in ((xs, rim_x), (zs, rim_z)):
        for side in (-rim, rim):
            lines[min(range(GRID + 1), key=lambda k: abs(lines[k] - side))] = side
    sheet = heightfield(xs, zs, ground)
    middle = abs(sheet.vertices[sheet.faces].mean(axis=1))
    return sheet.only((middle[:, 0] > rim_x) | (middle[:, 2] > rim_z))


def roof_slope(point: Point) -> Point:
    """Lift everything at and above the eaves towards the ridge at z = 0."""
    x, y, z = point
    return (x, y + PITCH * (Z - abs(z)), z) if y >= EAVE else point


def house() -> dict[str, Shape]:
    """Walls, openings, floor slab, partition and roof."""
    cells = Cells(
        (-X - EAVES, -X, -X + WALL, *WINDOW, *DOOR, *PARTITION, X - WALL, X, X + EAVES),
        (BASE, FLOOR, SILL, HEAD, EAVE, EAVE + ROOF),
        (-Z - EAVES, -Z, -Z + WALL, *DOORWAY, *SIDE_WINDOW, 0.0, Z - WALL, Z, Z + EAVES),
    )
    inner_x, inner_z = X - WALL, Z - WALL
    cells.fill(WALLS, ((-X, BASE, -Z), (X, EAVE, Z)))
    cells.fill(0, ((-inner_x, FLOOR, -inner_z), (inner_x, EAVE, inner_z)))
    cells.fill(WOOD, ((-inner_x, BASE, -inner_z), (inner_x, FLOOR, inner_z)))
    cells.fill(SCREEN, ((PARTITION[0], FLOOR, -inner_z), (PARTITION[1], EAVE, inner_z)))
    cells.fill(0, ((PARTITION[0], FLOOR, DOORWAY[0]), (PARTITION[1], HEAD, DOORWAY[1])))
    cells.fill(0, ((DOOR[0], FLOOR, inner_z), (DOOR[1], HEAD, Z)))
    cells.fill(0, ((WINDOW[0], SILL, inner_z), (WINDOW[1], HEAD, Z)))
    cells.fill(0, ((inner_x, SILL, SIDE_WINDOW[0]), (X, HEAD, SIDE_WINDOW[1])))
    cells.fill(TILES, ((-X - EAVES, EAVE, -Z - EAVES), (X + EAVES, EAVE + ROOF, Z + EAVES)))

    def named(label: int, side: int, middle: Point) -> str | None:
        return None if side == 3 and middle[1] == BASE else NAMES[label]

    return cells.surface(named, roof_slope)


def crown(rng: random.Random, centre: Point, size: Point, free: Callable[[Point, float], bool]) -> Shape:
    """Up to 110 lumps in an ellipsoid of half axes `size`; none touches another or what `free` keeps."""
    lumps: list[tuple[Point, float]] = []
    for _ in range(4000):
        x, y, z = (2.0 * rng.random() - 1.0 for _ in range(3))
        radius = 0.22 + 0.3 * rng.random()
        where = (centre[0] + x * size[0], centre[1] + y * size[1], centre[2] + z * size[2])
        fits = x * x + y * y + z * z < 1.0 and free(where, radius)
        if fits and all(math.dist(where, p) > radius + r for p, r in lumps):
            lumps.append((where, radius))
        if len(lumps) == 110:
            break
    return join([lump(rng, radius).moved(where) for where, radius in lumps])


def tree(place: tuple[float, float], height: float, seed: int) -> tuple[Shape, Shape]:
    """Trunk and crown."""
    x, z = place
    foot = ground(x, z) - 0.15
    top = 0.75 * height
    trunk = lathe([(0.0, 0.0), (0.28, 0.0), (0.2, 0.4 * top), (0.06, top), (0.0, top)], 7).moved((x, foot, z))

    def free(p: Point, radius: float) -> bool:
        return math.hypot(p[0] - x, p[2] - z) > radius + 0.2 or p[1] - radius > foot + top

    middle = (x, foot + 0.64 * height, z)
    return trunk, crown(random.Random(seed), middle, (0.3 * height, 0.34 * height, 0.3 * height), free)


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    meshes = {"terrain": terrain()} | house()
    for name, settings in TREES.items():
        meshes[f"{name}_trunk"], meshes[f"{name}_crown"] = tree(*settings)
    return bundle(TOML, README, meshes, {"evening.toml": EVENING}, wall=WALL, base=BASE)
