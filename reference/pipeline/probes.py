"""The probe half of the chain: scene → bitmap → octree → probes → layout, and new light through them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..clock import Clock
from ..datatypes import F32, F64, Bool, Indirection, Scene, VirtualTexture
from ..errors import InputError
from ..lattice import SHIFT, Octree, make_grid
from ..placement.octree import build_octree, uniform_octree
from ..placement.voxel_bitmap import build_bitmap
from ..progress import Progress, silent
from ..sh import basis
from ..transport.adaptive import Allocation
from ..transport.direct import arriving, punctual_lights, visible
from ..transport.form_factors import FormFactors, form_factors
from ..transport.gather import DeviceRows, gather, upload
from ..transport.radiosity import Radiosity
from ..transport.receivers import probe_receivers
from ..visibility import Geometry
from ..volume.indirection import build_indirection
from ..volume.layout import TileLayout, build_layout
from ..volume.tiles import fill_tiles, probe_texels
from .surfaces import PatchLight, Surfaces, allocated

LEAST_PROBE_RAYS = 128  # for their validity and direction, which the mean light does not show


@dataclass(frozen=True, eq=False)
class Probes:
    """The probe half of a bake. valid (R,) bool; rows: SH form factors in octree corner order."""

    octree: Octree
    rows: FormFactors
    device_rows: DeviceRows
    allocation: Allocation
    valid: Bool
    layout: TileLayout
    indirection: Indirection
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Update:
    """New lighting through a bake: coefficients (R, 4, 3) f32 radiance SH of real probes, texels (tiles, 27, 13) f32."""

    radiosity: Radiosity
    coefficients: F32
    texels: F32
    seconds: Mapping[str, float]


def place(scene: Scene, surfaces: Surfaces, seed: int, shift: F64 | float = SHIFT) -> Octree:
    """The adaptive octree under the scene's controls. shift: of the lattice, in finest voxels (see `make_grid`)."""
    s = scene.settings.placement
    if not scene.settings.volumes and not any(m.lit_by_probes for m in scene.meshes):
        raise InputError(
            f"scene '{scene.name}': no probe placed: no mesh has lit_by = \"probes\" and there is no volume; add one of them"
        )
    grid = make_grid(*probe_bounds(scene, surfaces.geometry), s.min_voxel, shift)
    margin = scene.settings.sampling.normal_offset * grid.finest
    return build_octree(surfaces.geometry, grid, build_bitmap(scene, grid, margin), s, seed)


def place_uniform(scene: Scene, surfaces: Surfaces, voxel: float) -> Octree:
    """A uniform grid of `voxel` m over the same bounds."""
    return uniform_octree(make_grid(*probe_bounds(scene, surfaces.geometry), voxel))


def probe_bounds(scene: Scene, g: Geometry) -> tuple[F64, F64]:
    """Bounds (3,), (3,) m of static geometry, moving meshes and volumes."""
    volumes = scene.settings.volumes.values()
    lower = [g.lower, *(m.vertices.min(axis=0) for m in scene.meshes), *(np.asarray(v.min) for v in volumes)]
    upper = [g.upper, *(m.vertices.max(axis=0) for m in scene.meshes), *(np.asarray(v.max) for v in volumes)]
    return np.min(lower, axis=0), np.max(upper, axis=0)


def bake_probes(scene: Scene, surfaces: Surfaces, octree: Octree, seed: int, progress: Progress = silent) -> Probes:
    """Form factors and validity of the real probes, and the virtual texture's layout.

    Raises InputError if every probe is invalid: the volume would be black.
    """
    clock = Clock()
    s = scene.settings.placement
    receivers = probe_receivers(surfaces.geometry, octree.positions)
    allocation = allocated(surfaces, receivers, s.probe_noise, s.probe_rays, seed + 3, LEAST_PROBE_RAYS)
    rows = form_factors(
        surfaces.geometry, surfaces.patches, receivers, allocation.rays, seed + 3, progress, "form factors of probes"
    )
    valid = rows.back_share <= s.backface_tolerance
    clock.lap("probe_form_factors")
    if not valid.any():
        raise InputError(
            f"scene '{scene.name}': no probe placed: all {len(valid)} see back faces (placement.backface_tolerance "
            f"{s.backface_tolerance}); are the meshes inside out, or two_sided meant?"
        )
    layout = build_layout(octree)
    indirection = build_indirection(layout)
    clock.lap("virtual_texture")
    return Probes(octree, rows, upload(rows), allocation, valid, layout, indirection, clock.seconds)


def update(scene: Scene, surfaces: Surfaces, probes: Probes, light: PatchLight) -> Update:
    """Probe lighting from patch light, then the tile cache's texels."""
    clock = Clock()
    coefficients = gather(probes.device_rows, light.radiosity.light)
    coefficients = coefficients + punctual_input(scene, surfaces.geometry, probes.octree.positions)
    clock.lap("probes")
    texels = fill_tiles(probes.layout, probe_texels(coefficients, probes.valid))
    clock.lap("tiles")
    return Update(light.radiosity, coefficients, texels, clock.seconds)


def punctual_input(scene: Scene, g: Geometry, positions: F64) -> F32:
    """Radiance SH (R, 4, 3) f32 at probes (R, 3) of punctual lights tagged `input`: Y(ω) E⊥ where not shadowed."""
    total = np.zeros((len(positions), 4, 3))
    for light in punctual_lights(scene, "input"):
        towards, distance, facing = arriving(light, positions)
        seen = visible(g, positions, None, towards, distance)
        total += basis(towards)[:, :, None] * (facing * seen[:, None])[:, None, :]
    return total.astype(np.float32)


def virtual_texture(probes: Probes, texels: F32) -> VirtualTexture:
    """What a sampler reads."""
    grid = probes.octree.grid
    return VirtualTexture(grid.origin, grid.finest, grid.level, grid.extent, probes.indirection, texels)
