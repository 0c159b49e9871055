"""The probe half of the chain: scene → bitmap → octree → probes → layout, and new light through them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..clock import Clock
from ..datatypes import F32, F64, I32, I64, Bool, Scene
from ..errors import InputError
from ..lattice import SHIFT, Grid, Octree, deepened, distinct, make_grid
from ..placement.addressable import refuse_unaddressable
from ..placement.dead_edges import light_from
from ..placement.octree import build_octree, uniform_octree
from ..placement.touching import leading_level, touched_voxels
from ..placement.voxel_bitmap import VoxelBitmap, build_bitmap
from ..progress import Progress, silent
from ..reconstruction import order_for
from ..sh import Order, basis, coefficient_count, order_of
from ..texture_types import Indirection, VirtualTexture
from ..transport.adaptive import Allocation
from ..transport.direct import arriving, punctual_lights, visible
from ..transport.form_factors import FormFactors, form_factors
from ..transport.gather import DeviceRows, gather, upload
from ..transport.radiosity import Radiosity
from ..transport.receivers import probe_receivers
from ..truth.points import Points
from ..turned import turned_boxes
from ..visibility import Geometry
from ..volume.indirection import build_indirection
from ..volume.layout import TileLayout, build_layout
from ..volume.tiles import fill_tiles, probe_texels, with_copies
from .surfaces import PatchLight, Surfaces, allocated

LEAST_PROBE_RAYS = 128  # for their validity and direction, which the mean light does not show


@dataclass(frozen=True, eq=False)
class Culled:
    """What culling took away. probes: how many; able: that had eight valid parents; by_level (L + 1,) i64. norm: its name;
    threshold: most damage that one probe was predicted to do. odds_over, raise_lightings, raise_expected: see
    `placement.judge.Verdict`, at points of culling's own. bytes: of rows that were freed."""

    probes: int
    able: int
    by_level: I64
    norm: str
    threshold: float
    odds_over: float
    raise_lightings: float
    raise_expected: float
    bytes: int


@dataclass(frozen=True, eq=False)
class Probes:
    """The probe half of a bake. valid (R,) bool; rows: SH form factors in octree corner order. light_from (R,) i32: whose light
    each probe uses: its own number where it is valid, a valid neighbour's where that is copied, else -1. culled: what culling took
    away, None where it was not asked for."""

    octree: Octree
    rows: FormFactors
    device_rows: DeviceRows
    allocation: Allocation
    valid: Bool
    light_from: I32
    layout: TileLayout
    indirection: Indirection
    seconds: Mapping[str, float]
    culled: Culled | None = None


@dataclass(frozen=True, eq=False)
class Update:
    """New lighting through a bake: coefficients (R, K, 3) f32 radiance SH of real probes, texels (tiles, 27, C) f32; K = 4 and C = 13,
    with sampling.reconstruction = "l2" 9 and 28."""

    radiosity: Radiosity
    coefficients: F32
    texels: F32
    seconds: Mapping[str, float]


def place(scene: Scene, surfaces: Surfaces, seed: int, shift: F64 | float = SHIFT) -> Octree:
    """The adaptive octree under the scene's controls. shift: of the lattice, in finest voxels (see `make_grid`).

    The lattice is that of placement.min_voxel. A layer of the bitmap file with smaller cells makes it deeper, for that layer
    alone: what asks for no size of its own, and the sample offset, still go by placement.min_voxel.
    """
    s, g = scene.settings.placement, surfaces.geometry
    grid = _lattice(scene, g, shift)
    marks = bitmap(scene, grid)
    margin = scene.settings.sampling.normal_offset * grid.wanted
    finest = grid.level if s.touching else leading_level(scene, grid)
    touched = touched_voxels(scene, grid, marks.occupied, margin, finest)
    given = [distinct(np.concatenate(keys)) for keys in zip(*filter(None, (touched, marks.placed)), strict=True)]
    return build_octree(g, grid, marks, s, seed, given)


def check_placement(scene: Scene, g: Geometry) -> None:
    """What `place` can refuse without tracing a ray, to be said before anything else is traced.

    Raises InputError if nothing wants probes, or more than the virtual texture can address.
    """
    grid = _lattice(scene, g, SHIFT)
    refuse_unaddressable(grid, bitmap(scene, grid).occupied, scene.settings.placement.subdivision == "plain")


def _lattice(scene: Scene, g: Geometry, shift: F64 | float) -> Grid:
    marking = scene.settings.volumes or scene.marks or scene.bitmap
    if not marking and not any(m.lit_by_probes for m in scene.meshes):
        raise InputError(
            f"scene '{scene.name}': no probe placed: no mesh has lit_by = \"probes\" and there is no volume, mark or bitmap file; "
            "add one of them"
        )
    grid = make_grid(*probe_bounds(scene, g), scene.settings.placement.min_voxel, shift)
    sizes = [layer.size for layer in scene.bitmap if layer.mode != "remove" and len(layer.cells)]
    return deepened(grid, min(sizes, default=grid.finest))


def bitmap(scene: Scene, grid: Grid) -> VoxelBitmap:
    """Where the scene wants probes, and how finely, on the lattice of `grid`; surfaces reach as far as they are sampled."""
    return build_bitmap(scene, grid, scene.settings.sampling.normal_offset * grid.wanted)


def place_uniform(scene: Scene, surfaces: Surfaces, voxel: float) -> Octree:
    """A uniform grid of `voxel` m over the same bounds."""
    return uniform_octree(make_grid(*probe_bounds(scene, surfaces.geometry), voxel))


def probe_bounds(scene: Scene, g: Geometry) -> tuple[F64, F64]:
    """Bounds (3,), (3,) m of static geometry, moving meshes and volumes."""
    volumes = [v.bounds for v in turned_boxes(scene.settings.volumes.values(), scene.settings.scene.rotation)]
    lower = [g.lower, *(m.vertices.min(axis=0) for m in scene.meshes), *(low for low, _ in volumes)]
    upper = [g.upper, *(m.vertices.max(axis=0) for m in scene.meshes), *(high for _, high in volumes)]
    return np.min(lower, axis=0), np.max(upper, axis=0)


def trace_probes(scene: Scene, surfaces: Surfaces, octree: Octree, seed: int, progress: Progress = silent) -> Probes:
    """Form factors and validity of all real probes, and the virtual texture's layout; none is culled yet.

    Raises InputError if every probe is invalid: the volume would be black.
    """
    clock = Clock()
    s = scene.settings.placement
    order = order_for(scene.settings.sampling.reconstruction)
    receivers = probe_receivers(surfaces.geometry, octree.positions, order)
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
    source = light_from(surfaces.geometry, octree, valid, s.backface_tolerance, seed + 7)
    clock.lap("dead_edges")
    layout = build_layout(octree)
    indirection = build_indirection(layout)
    clock.lap("virtual_texture")
    return Probes(octree, rows, upload(rows), allocation, valid, source, layout, indirection, clock.seconds)


def probe_light(scene: Scene, surfaces: Surfaces, probes: Probes, light: PatchLight) -> F32:
    """Radiance SH (R, 4 or 9, 3) f32 of the real probes from patch light."""
    coefficients = gather(probes.device_rows, light.radiosity.light)
    order = order_of(coefficients.shape[1])
    return coefficients + punctual_input(scene, surfaces.geometry, probes.octree.positions, order)


def update(scene: Scene, surfaces: Surfaces, probes: Probes, light: PatchLight) -> Update:
    """Probe lighting from patch light, then the tile cache's texels, the plain way (a device fills its own, see fastpath)."""
    clock = Clock()
    coefficients = probe_light(scene, surfaces, probes, light)
    clock.lap("probes")
    texels = tile_texels(probes, coefficients, probes.light_from)
    clock.lap("tiles")
    return Update(light.radiosity, coefficients, texels, clock.seconds)


def tile_texels(probes: Probes, coefficients: F32, source: I32) -> F32:
    """Texels (tiles, 27, 13 or 28) f32 of the tile cache from probes' radiance SH (R, 4 or 9, 3); source (R,) i32: whose light each
    uses, -1 for none, as `Probes.light_from`."""
    return fill_tiles(probes.layout, probe_texels(*with_copies(coefficients, source)))


def punctual_input(scene: Scene, g: Geometry, positions: F64, order: Order = 1) -> F32:
    """Radiance SH (R, 4, 3) f32, of order 2 (R, 9, 3), at probes (R, 3) of punctual lights tagged `input`: Y(ω) E⊥ where not
    shadowed."""
    total = np.zeros((len(positions), coefficient_count(order), 3))
    for light in punctual_lights(scene, "input"):
        towards, distance, facing = arriving(light, positions)
        seen = visible(g, positions, None, towards, distance)
        total += basis(towards, order)[:, :, None] * (facing * seen[:, None])[:, None, :]
    return total.astype(np.float32)


def virtual_texture(probes: Probes, texels: F32) -> VirtualTexture:
    """What a sampler reads."""
    grid = probes.octree.grid
    return VirtualTexture(
        grid.origin,
        grid.finest,
        grid.level,
        grid.extent,
        probes.indirection,
        texels,
        grid.wanted if grid.extra else None,
    )


def lifted(scene: Scene, texture: VirtualTexture, points: Points, voxels: float | None = None) -> F64:
    """Where a receiver is sampled, (N, 3) m: off its surface along the normal by as many finest voxels as the scene asks for, or by
    `voxels` of them; free points stay."""
    asked = scene.settings.sampling.normal_offset if voxels is None else voxels
    offset = asked * (texture.offset_voxel or texture.finest)
    on_surface = points.mesh >= 0
    return np.asarray(points.positions + np.where(on_surface[:, None], offset, 0.0) * points.normals)
