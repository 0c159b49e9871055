"""`cornell`: the measured Cornell box. See `cornell_data` for the source of every number."""

from __future__ import annotations

import cornell_data
from bundle import bundle
from shapes import Point, Shape, join, polygons

TOML = """
description = "The measured Cornell box: published geometry and reflectances, one lamp, open towards the camera"

[materials]
white = { albedo = $white }
green = { albedo = $green }
red = { albedo = $red }
lamp = { albedo = [$glass, $glass, $glass] }

[meshes]
floor = { file = "floor.ply", material = "white", probe_size = 0.035 }
ceiling = { file = "ceiling.ply", material = "white", probe_size = 0.035 }
back = { file = "back.ply", material = "white", probe_size = 0.035 }
right = { file = "right.ply", material = "green", probe_size = 0.035 }
left = { file = "left.ply", material = "red", probe_size = 0.035 }
short_block = { file = "short_block.ply", material = "white", probe_size = 0.035 }
tall_block = { file = "tall_block.ply", material = "white", probe_size = 0.035 }
lamp = { file = "lamp.ply", material = "lamp", probe_size = 0.035 }

[lights]
lamp = { type = "area", mesh = "lamp", radiance = $radiance, tag = "engine" }

[volumes]
above_blocks = { min = [0.04, 0.35, 0.04], max = [0.51, 0.52, 0.52], probe_size = 0.07 }
# The ceiling's creases: light changes there within a voxel. Without them the placement-only error (mean over lattices) is 6 % higher,
# for 3 % fewer probes.
ceiling_back = { min = [0.0, 0.54, 0.55], max = [0.556, 0.5488, 0.5592], probe_size = 0.0175 }
ceiling_left = { min = [0.54, 0.54, 0.0], max = [0.556, 0.5488, 0.5592], probe_size = 0.0175 }
ceiling_right = { min = [0.0, 0.54, 0.0], max = [0.01, 0.5488, 0.5592], probe_size = 0.0175 }

[cameras]
# Published: at 278 273 -800 mm looking along +z; 35 mm lens, 25 mm film: 2 atan(12.5 / 35).
front = { origin = [0.278, 0.273, -0.8], target = [0.278, 0.273, 0.0], fov_deg = 39.3077, width = 224, height = 224 }

[placement]
min_voxel = 0.0175
cull_error = 0.02

[sampling]
normal_offset = 1.0  # finest voxels: half of one of 0.035 m

[radiosity]
patch_size = 0.03

[truth]
noise = 0.02
points = 1500
"""

README = """
# cornell

The measured Cornell box: five walls, two blocks, one lamp; open towards the camera, black outside. $triangles triangles.

- **Units**: the published millimetres, divided by 1,000: metres. y up; the lamp faces down; the room is seen along +z.
- **Origin**: geometry, reflectances and lamp spectrum are measurements published by Cornell University's Program of
  Computer Graphics, "Cornell Box Data", <https://www.graphics.cornell.edu/online/box/data.html>, for public use; the
  files here are written from those numbers by `scenes/generate.py` and are Apache-2.0.
- **Geometry**: the published coordinates, all of them, among them the walls' small errors (the left wall is not quite
  flat). What cannot be seen is cut out instead of lying under something else: the floor under both blocks, the ceiling above
  the lamp, which therefore closes the ceiling at exactly y = 0.5488 m. No two faces share a place, and floor, blocks,
  lamp and ceiling share their vertices: the only open edge is the front.
- **Colour**: the spectra become linear Rec. 709 by the CIE 1931 2° observer. Reflectances are seen under D65 with a perfect
  white at (1, 1, 1): white $white, green $green, red $red. Other published triples (0.57, 0.04, 0.04 for red)
  leave white unbalanced. The lamp, 400 nm: 0, 500: 8, 600: 15.6, 700: 18.4, linear between, becomes $radiance, a spectrum of 1 having
  luminance 1; it is taken as W·m⁻²·sr⁻¹. RGB transport is not spectral transport: this is a model error of the scene, the same
  in truth and in probes. The lamp's own reflectance is the published $glass.
- **Right answer**: no closed form; the path-traced truth. Known beforehand: the lamp is a direct light (`engine`), so all
  that the probes hold has been reflected at least once; the floor beside the left wall is redder and beside the right
  wall greener than in the middle; at the open front, light is lost and none comes in.
- **Controls**: voxels of 0.035 m on surfaces, 0.0175 m along the three creases of the ceiling, 0.07 m above the blocks.
- **Tests**: the whole chain on the field's best-known scene, its error against the L1 floor (at most 1.4 ×), reference noise under 2 %,
  blocks that stand oblique to the voxels.
"""

FLOOR = ((552.8, 0.0), (0.0, 0.0), (0.0, 559.2), (549.6, 559.2))
CEILING = ((556.0, 0.0), (556.0, 559.2), (0.0, 559.2), (0.0, 0.0))
SHORT = ((130.0, 65.0), (82.0, 225.0), (240.0, 272.0), (290.0, 114.0))
TALL = ((423.0, 247.0), (265.0, 296.0), (314.0, 456.0), (472.0, 406.0))
LAMP = ((343.0, 227.0), (343.0, 332.0), (213.0, 332.0), (213.0, 227.0))
HEIGHT, SHORT_HEIGHT, TALL_HEIGHT = 548.8, 165.0, 330.0
# Delaunay triangles of the floor around the blocks' feet (corners 0-3 floor, 4-7 short, 8-11 tall), facing up, and of
# the ceiling around the lamp (0-3 ceiling, 4-7 lamp), facing down.
FLOOR_FACES = (
    (1, 2, 5),
    (1, 4, 0),
    (0, 4, 7),
    (1, 5, 4),
    (9, 7, 6),
    (2, 9, 6),
    (2, 6, 5),
    (0, 7, 8),
    (9, 8, 7),
    (2, 10, 9),
    (2, 3, 10),
    (3, 11, 10),
    (0, 11, 3),
    (0, 8, 11),
)
CEILING_FACES = ((3, 6, 2), (1, 5, 0), (7, 6, 3), (5, 4, 0), (5, 1, 2), (6, 5, 2), (4, 7, 3), (4, 3, 0))
Corners = tuple[tuple[float, float], ...]


def at(height: float, corners: Corners) -> list[Point]:
    """Published millimetres (x, z) at a height, as metres."""
    return [(x / 1000.0, height / 1000.0, z / 1000.0) for x, z in corners]


def block(feet: Corners, height: float) -> Shape:
    """A block without its underside: top and four sides, facing out."""
    points = at(0.0, feet) + at(height, feet)
    sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    return join([polygons(points, (4, 5, 6, 7), *sides)])


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    floor, ceiling = at(0.0, FLOOR), at(HEIGHT, CEILING)
    f, c = floor, ceiling
    meshes = {
        "floor": polygons(floor + at(0.0, SHORT) + at(0.0, TALL), *FLOOR_FACES),
        "ceiling": polygons(ceiling + at(HEIGHT, LAMP), *CEILING_FACES),
        "back": polygons((f[3], f[2], c[2], c[1]), (0, 1, 2, 3)),
        "right": polygons((f[2], f[1], c[3], c[2]), (0, 1, 2, 3)),
        "left": polygons((f[0], f[3], c[1], c[0]), (0, 1, 2, 3)),
        "short_block": block(SHORT, SHORT_HEIGHT),
        "tall_block": block(TALL, TALL_HEIGHT),
        "lamp": polygons(at(HEIGHT, LAMP), (0, 1, 2, 3)),
    }
    return bundle(
        TOML,
        README,
        meshes,
        white=cornell_data.albedo(cornell_data.WHITE),
        green=cornell_data.albedo(cornell_data.GREEN),
        red=cornell_data.albedo(cornell_data.RED),
        radiance=cornell_data.lamp_radiance(),
        glass=cornell_data.LAMP_REFLECTANCE,
    )
