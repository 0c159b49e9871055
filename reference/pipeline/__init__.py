"""The one place that chains the stages: scene → patches → form factors; scene → bitmap → octree → probes → layout;
lights → radiosity → probe lighting → tiles. `bake` is independent of lighting, `update` is new lighting through it."""

from .culling import bake_probes, cull_probes
from .probes import (
    LEAST_PROBE_RAYS,
    Culled,
    Probes,
    Update,
    bitmap,
    check_placement,
    lifted,
    place,
    place_uniform,
    probe_bounds,
    punctual_input,
    tile_texels,
    trace_probes,
    update,
    virtual_texture,
)
from .surfaces import (
    PatchLight,
    SurfaceReceivers,
    Surfaces,
    allocated,
    bake_receivers,
    bake_surfaces,
    gather_at_points,
    light_patches,
)

__all__ = [
    "LEAST_PROBE_RAYS",
    "Culled",
    "PatchLight",
    "Probes",
    "SurfaceReceivers",
    "Surfaces",
    "Update",
    "allocated",
    "bake_probes",
    "bake_receivers",
    "bake_surfaces",
    "bitmap",
    "check_placement",
    "cull_probes",
    "gather_at_points",
    "lifted",
    "light_patches",
    "place",
    "place_uniform",
    "probe_bounds",
    "punctual_input",
    "tile_texels",
    "trace_probes",
    "update",
    "virtual_texture",
]
