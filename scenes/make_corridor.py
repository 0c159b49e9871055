"""`corridor`: light from two opposite directions, which L1 cannot represent."""

from __future__ import annotations

from bundle import bundle
from cells import Cells
from shapes import Point, Shape

LENGTH, HEIGHT, WIDTH = 12.0, 2.5, 2.0
NICHE, PIER = 0.6, 0.25  # depths
NICHES = (2.4, 3.6), (8.4, 9.6)  # x of the niche on the +z side, and of the one on the -z side
PIERS = (5.8, 6.2)
PANEL_Y, PANEL_Z = (0.3, 2.2), (0.3, 1.7)

TOML = """
description = "A closed corridor of $length m, lit from its two ends in different colours"

[materials]
plaster = { albedo = [0.6, 0.6, 0.58] }
floor = { albedo = [0.35, 0.3, 0.25] }
brick = { albedo = [0.5, 0.25, 0.18] }
warm = { albedo = [0.2, 0.2, 0.2], emission = [6.0, 3.6, 1.6] }
cool = { albedo = [0.2, 0.2, 0.2], emission = [1.6, 3.2, 6.0] }

[meshes]
walls = { file = "walls.ply", material = "plaster" }
floor = { file = "floor.ply", material = "floor" }
niches = { file = "niches.ply", material = "brick" }
panel_warm = { file = "panel_warm.ply", material = "warm" }
panel_cool = { file = "panel_cool.ply", material = "cool" }

[volumes]
walk = { min = [0.4, 0.3, 0.4], max = [11.6, 2.2, 1.6], probe_size = 0.5 }

[cameras]
along = { origin = [0.8, 1.5, 1.0], target = [12.0, 1.2, 1.0], fov_deg = 75.0 }
middle = { origin = [4.6, 1.6, 0.5], target = [8.6, 1.0, 1.2], fov_deg = 75.0 }

[placement]
min_voxel = 0.25

[sampling]
normal_offset = 0.25

[radiosity]
patch_size = 0.3

[truth]
noise = 0.04
points = 800
"""

README = """
# corridor

A closed corridor, $length × $height × $width m, with a glowing panel in each end wall: warm at x = 0, cool at x = $length. One niche on each
side, a pair of piers in the middle. $triangles triangles facing inwards. No other light, no sky.

- **Units**: metres, y up. $licence
- **Geometry**: one closed surface (the meshes share their vertices); from outside only back faces are seen.
- **Right answer**: the path-traced truth; no closed form. The panels are emissive surfaces, so they are *input*: all their light is indirect in
  this project's words and must go through the probes.
- **Tests**: light from opposite directions (failure-catalogue C3). In the middle the radiance is large towards +x and towards -x and small
  across; its L1 part nearly cancels, while the irradiance of a surface that faces an end stays high. So the L1 floor is bad by
  construction (the two faces of the piers show it), and inside the volume the report must blame the representation (over floor about 1); next to the panels the bundled voxels are
  too coarse, and there it must blame the placement (surfaces at about twice their floor).
  The falloff along x is steep near the panels and flat in the middle.
"""


def named(label: int, side: int, middle: Point) -> str | None:
    """Which mesh a face belongs to; the block's outside is left out."""
    x, y, z = middle
    if not (0.0 <= x <= LENGTH and 0.0 <= y <= HEIGHT and -NICHE <= z <= WIDTH + NICHE):
        return None
    panel = PANEL_Y[0] < y < PANEL_Y[1] and PANEL_Z[0] < z < PANEL_Z[1]
    if side == 2:
        return "floor"
    if panel and side == 0 and abs(x) < 1e-9:
        return "panel_warm"
    if panel and side == 1 and abs(x - LENGTH) < 1e-9:
        return "panel_cool"
    in_niche = (z > WIDTH or z < 0.0) and side != 3
    return "niches" if in_niche else "walls"


def surface() -> dict[str, Shape]:
    """The corridor, cut out of one block."""
    cells = Cells(
        (-1.0, 0.0, *NICHES[0], *PIERS, *NICHES[1], LENGTH, LENGTH + 1.0),
        (-1.0, 0.0, *PANEL_Y, HEIGHT, HEIGHT + 1.0),
        (-NICHE - 1.0, -NICHE, 0.0, PIER, *PANEL_Z, WIDTH - PIER, WIDTH, WIDTH + NICHE, WIDTH + NICHE + 1.0),
    )
    cells.labels[:] = 1
    cells.fill(0, ((0.0, 0.0, 0.0), (LENGTH, HEIGHT, WIDTH)))
    cells.fill(0, ((NICHES[0][0], 0.0, WIDTH), (NICHES[0][1], HEIGHT, WIDTH + NICHE)))
    cells.fill(0, ((NICHES[1][0], 0.0, -NICHE), (NICHES[1][1], HEIGHT, 0.0)))
    cells.fill(1, ((PIERS[0], 0.0, 0.0), (PIERS[1], HEIGHT, PIER)))
    cells.fill(1, ((PIERS[0], 0.0, WIDTH - PIER), (PIERS[1], HEIGHT, WIDTH)))
    return cells.surface(named)


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    return bundle(TOML, README, surface(), length=LENGTH, height=HEIGHT, width=WIDTH)
