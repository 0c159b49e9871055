"""`two-rooms`: one room lit, its neighbour sealed; whatever light the second one shows has leaked."""

from __future__ import annotations

from bundle import bundle
from cells import Cells
from shapes import Point, Shape

WALL = 0.2
LENGTH, HEIGHT, DEPTH = 4.0, 2.6, 3.0
FAR = 2.0 * LENGTH + WALL  # x of the sealed room's far wall
LAMP_X, LAMP_Z = (1.6, 2.4), (1.1, 1.9)
BUILDING, LAMP, RED, BLUE = "building", "lamp", "wall_red", "wall_blue"

TOML = """
description = "Two closed rooms with a wall of $wall m between them: one is lit, the other sealed and exactly dark"

[materials]
plaster = { albedo = [0.7, 0.7, 0.68] }
red = { albedo = [0.6, 0.15, 0.1] }
blue = { albedo = [0.15, 0.25, 0.55] }
glass = { albedo = [0.5, 0.5, 0.5] }

[meshes]
building = { file = "building.ply", material = "plaster" }
wall_red = { file = "wall_red.ply", material = "red" }
wall_blue = { file = "wall_blue.ply", material = "blue" }
lamp = { file = "lamp.ply", material = "glass" }

[lights]
ceiling = { type = "area", mesh = "lamp", radiance = [14.0, 13.0, 11.0], tag = "engine" }
shelf = { type = "point", position = [3.2, 0.6, 2.4], intensity = [1.5, 1.2, 0.7], tag = "engine" }

[volumes]
lit_room = { min = [0.2, 0.2, 0.2], max = [3.8, 2.4, 2.8], probe_size = 0.6 }
dark_room = { min = [4.4, 0.2, 0.2], max = [8.0, 2.4, 2.8], probe_size = 0.6 }

[cameras]
lit = { origin = [0.4, 1.5, 0.4], target = [4.0, 1.0, 2.2], fov_deg = 75.0 }
dark = { origin = [7.8, 1.5, 0.4], target = [4.2, 1.0, 2.2], fov_deg = 75.0 }

[placement]
# Walls are axis-aligned: leak-free needs voxels of at most the wall's thickness, $wall m (failure-catalogue C7).
min_voxel = 0.18
probe_noise = 0.01

[radiosity]
patch_size = 0.25

[truth]
noise = 0.04
points = 1000

[expect.dark]
sealed_room = { min = [4.2, 0.0, 0.0], max = [8.2, 2.6, 3.0] }
"""

README = """
# two-rooms

A building of two closed rooms, $length × $height × $depth m each, side by side along x, with solid walls of $wall m around and
between them. $triangles triangles. The room at x = 0 to 4 has a ceiling lamp and a small point light (both direct), a red and a blue
wall; the room at x = 4.2 to 8.2 has no light and no opening. No sky.

- **Units**: metres, y up. $licence
- **Geometry**: `building`, `wall_red`, `wall_blue` and `lamp` (flush with the ceiling) together are the boundary of one solid: watertight, with
  shared vertices, facing into the rooms and outwards, so a probe inside a wall sees back faces only. `wall_blue` is the lit face of the
  partition at x = 4; its other face, at x = 4.2, belongs to `building`.
- **Right answer**: in the sealed room (`expect.dark`) every light, direct or indirect, is exactly 0: no path leads in. In the
  lit room the path-traced truth.
- **Tests**: leaks through a thin wall. The wall is axis-aligned, so voxels of h ≤ $wall m can be leak-free (t ≥ h(|nx|+|ny|+|nz|)); leak under
  1e-3 is asked of the bundled settings, together with the overdark on the lit side, and `placement.min_voxel = 1` shows a leak. Also a
  relative error where the reference is 0, and a second light type.
"""


def named(label: int, side: int, middle: Point) -> str | None:
    """Which mesh a face of the building belongs to."""
    inside = 0.0 <= middle[0] <= LENGTH and 0.0 <= middle[2] <= DEPTH and 0.0 <= middle[1] <= HEIGHT
    lamp = LAMP_X[0] < middle[0] < LAMP_X[1] and LAMP_Z[0] < middle[2] < LAMP_Z[1]
    if inside and side == 3 and lamp and abs(middle[1] - HEIGHT) < 1e-9:
        return LAMP
    if inside and side == 0 and abs(middle[0]) < 1e-9:
        return RED
    if inside and side == 1 and abs(middle[0] - LENGTH) < 1e-9:
        return BLUE
    return BUILDING


def solid() -> dict[str, Shape]:
    """Both rooms, cut out of one block."""
    cells = Cells(
        (-WALL, 0.0, *LAMP_X, LENGTH, LENGTH + WALL, FAR, FAR + WALL),
        (-WALL, 0.0, HEIGHT, HEIGHT + WALL),
        (-WALL, 0.0, *LAMP_Z, DEPTH, DEPTH + WALL),
    )
    cells.labels[:] = 1
    cells.fill(0, ((0.0, 0.0, 0.0), (LENGTH, HEIGHT, DEPTH)))
    cells.fill(0, ((LENGTH + WALL, 0.0, 0.0), (FAR, HEIGHT, DEPTH)))
    return cells.surface(named)


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    return bundle(TOML, README, solid(), wall=WALL, length=LENGTH, height=HEIGHT, depth=DEPTH)
