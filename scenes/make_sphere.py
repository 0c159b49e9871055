"""`sphere`: the inside of a closed sphere, whose radiosity has a closed form."""

from __future__ import annotations

import math

from bundle import bundle
from shapes import icosphere

RADIUS = 1.0
LEVELS = 3
ALBEDO = 0.5
RADIANCE = (1.0, 0.6, 0.3)

TOML = """
description = "The inside of a closed sphere of radius $radius m: the upper half glows, both halves reflect alike"

[materials]
glowing = { albedo = [$albedo, $albedo, $albedo], emission = $radiance }
plain = { albedo = [$albedo, $albedo, $albedo] }

[meshes]
upper = { file = "upper.ply", material = "glowing" }
lower = { file = "lower.ply", material = "plain" }

[volumes]
middle = { min = [-0.5, -0.5, -0.5], max = [0.5, 0.5, 0.5], probe_size = 0.25 }

[cameras]
inside = { origin = [0.0, 0.1, 0.8], target = [0.0, 0.0, -1.0], fov_deg = 80.0 }

[placement]
min_voxel = 0.15
probe_noise = 0.01

[sampling]
normal_offset = 1.0

[radiosity]
patch_size = 0.2
rays = 16384
noise = 0.002

[truth]
noise = 0.04
points = 1000

[expect]
closed_sphere = true
"""

README = """
# sphere

The inside of a closed sphere of radius $radius m, $triangles triangles facing inwards. The upper half (`upper`) emits radiance
L = $radiance W·m⁻²·sr⁻¹, which is input to the radiosity; the lower half (`lower`) emits nothing. Albedo ρ = $albedo everywhere.

- **Units**: metres, y up, centre at the origin. $licence
- **Right answer**, exact: seen from any point of a sphere's inside, every other piece of it has the form factor A_j / A (the
  cosines and the distance cancel). So each point receives the same irradiance H, the mean of all radiosities, and with
  the exitance M = πL above and 0 below, mean M̄ = πL / 2:

      B = M + ρ H,   H = mean(B) = M̄ + ρ H   →   H = M̄ / (1 - ρ) = $irradiance W·m⁻²
      upper half: B = M + ρ H = $upper       lower half: B = ρ H = $lower

  H is indirect light in this project's words (the emission is input). It does not depend on where the point is nor on its
  height, although L1 probes near the wall see a bright and a dark half.
- **Facets**: an icosphere of $levels subdivisions, corners at radius $radius, a corner at each pole. No triangle crosses the
  equator and the halves are point images of each other, so M̄ is exact; the flat facets leave an error that falls with the square of
  their size, and it is well under 1 %.
- **Tests**: radiosity against a closed form (within 1 %), energy balance, row sums of the form factors, a scene without direct light.
"""


def build() -> dict[str, bytes]:
    """Files of the scene folder."""
    ball = icosphere(LEVELS).flipped()
    above = ball.vertices[ball.faces].mean(axis=1)[:, 1] > 0.0
    irradiance = [math.pi * v / 2.0 / (1.0 - ALBEDO) for v in RADIANCE]
    upper = [math.pi * v + ALBEDO * h for v, h in zip(RADIANCE, irradiance, strict=True)]
    return bundle(
        TOML,
        README,
        {"upper": ball.only(above), "lower": ball.only(~above)},
        radius=RADIUS,
        levels=LEVELS,
        albedo=ALBEDO,
        radiance=RADIANCE,
        irradiance=tuple(round(v, 4) for v in irradiance),
        upper=tuple(round(v, 4) for v in upper),
        lower=tuple(round(ALBEDO * v, 4) for v in irradiance),
    )
