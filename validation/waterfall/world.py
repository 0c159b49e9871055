"""Everything the stages of the waterfall are read from: the scene baked as a run bakes it, and its exact counterparts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ...fastpath.device import OpenDevice
from ...fastpath.sampler import Sampler
from ...reference import pipeline
from ...reference.datatypes import F32, F64, Material, Scene
from ...reference.progress import Progress, silent
from ...reference.reconstruction import order_for
from ...reference.sh import Order
from ...reference.texture_types import Storage, VirtualTexture
from ...reference.transport.baked_albedo import baked_albedo
from ...reference.transport.form_factors import patch_form_factors
from ...reference.transport.gather import upload
from ...reference.transport.hits import DevicePatches, upload_patches
from ...reference.transport.patch_light import direct_on_patches
from ...reference.transport.radiosity import solve
from ...reference.transport.ray_gather import ray_gather
from ...reference.transport.reconcile import reconcile
from ...reference.transport.solvers import METHODS
from ...reference.volume.linear import texel_matrix
from ...reference.volume.tiles import fill_tiles, probe_texels, with_copies
from ..bake import Baked, bake
from ..cache import Arrays
from ..ground_truth import GroundTruth, ground_truth
from .kept import Parts

EXACT_RAYS = 8  # times the bake's rays, of patches and shadows: what noise they still have counts as the bake's
MOST_PATCH_RAYS = 1 << 20
# Probes come in batches whose noise cancels from every figure; it is only seen in pictures, at half of the bake's own.
PROBE_TIMES, PROBE_RAYS = 4, (1024, 4096)  # times the bake's rays; least and most of a retraced probe
SEED = 4000  # apart from all that the bake draws

Made = tuple[GroundTruth, Baked]  # the bake with what culling took away: `traced`


@dataclass(frozen=True, eq=False)
class World:
    """A scene, baked. exact (columns, 3): light on patches from better form factors. traced, probes: before and after culling;
    uncut, culled, kept: their textures in float32, and culled as stored. probe_light (B, R, 4 or 9, 3) f64: light that the uncut
    placement's probes should hold, from `probe_rays` rays each, in independent batches."""

    scene: Scene
    truth: GroundTruth
    surfaces: pipeline.Surfaces
    light: pipeline.PatchLight
    exact: F64
    traced: pipeline.Probes
    probes: pipeline.Probes
    coefficients: F32
    uncut: VirtualTexture
    culled: VirtualTexture
    kept: VirtualTexture
    sampler: Sampler
    storage: Storage
    probe_light: F64
    probe_rays: int
    seed: int

    @property
    def order(self) -> Order:
        """SH order that the scene reconstructs from."""
        return order_for(self.scene.settings.sampling.reconstruction)

    @cached_property
    def patches(self) -> DevicePatches:
        """Patch tables on the device."""
        return upload_patches(self.surfaces.geometry, self.surfaces.patches)

    @cached_property
    def texels(self) -> sparse.csr_array:
        """Texels of the uncut texture from its probes."""
        return texel_matrix(self.traced.layout, self.traced.light_from)


def world(
    scene: Scene,
    device: OpenDevice,
    seed: int,
    progress: Progress,
    parts: Parts | None = None,
    made: Made | None = None,
) -> World:
    """Bake and light the scene with the seeds of a run, recall or trace its truth, and compute the exact counterparts.

    parts: keeps those. made: what the run itself baked just before, with the same seed, instead of a bake like it. Raises InputError as
    `measure_scene` does.
    """
    truth, baked = made or _made(scene, device, seed, progress)
    surfaces, light, probes = baked.surfaces, baked.light, baked.probes
    traced = baked.traced or probes  # the very same where nothing was culled
    uncut = baked.texture if baked.uncut is None else baked.uncut
    parts = parts or Parts()
    exact = parts.arrays("patches", lambda: {"light": exact_light(scene, surfaces, seed, progress)})["light"]
    kept = parts.arrays("probes", lambda: _probe_light(scene, surfaces, traced, light, seed))
    stored = _texture(probes, baked.coefficients, baked.storage)
    return World(
        scene, truth, surfaces, light, exact, traced, probes, baked.coefficients, uncut, baked.texture, stored,
        baked.sampler, baked.storage, kept["light"], int(kept["rays"]), seed,
    )  # fmt: skip


def _made(scene: Scene, device: OpenDevice, seed: int, progress: Progress) -> Made:
    """Truth and bake as `measure_scene` has them."""
    truth = ground_truth(scene, seed, progress)
    surfaces = pipeline.bake_surfaces(scene, seed, progress)
    light = pipeline.light_patches(scene, surfaces, seed, progress)
    octree = pipeline.place(scene, surfaces, seed)
    return truth, bake(scene, device, (surfaces, light), octree, seed, progress, keep_traced=True)


def _texture(probes: pipeline.Probes, coefficients: F32, storage: Storage) -> VirtualTexture:
    """The texture as a cache filled in place holds it."""
    light = probe_texels(*with_copies(coefficients, probes.light_from))
    return pipeline.virtual_texture(probes, fill_tiles(probes.layout, light, storage))


def exact_light(scene: Scene, surfaces: pipeline.Surfaces, seed: int, progress: Progress = silent) -> F64:
    """Light of the same patches (columns, 3) from EXACT_RAYS times the rays, drawn anew, and as many more shadow rays."""
    g, p, s = surfaces.geometry, surfaces.patches, scene.settings.radiosity
    rays = np.minimum(EXACT_RAYS * surfaces.allocation.rays, MOST_PATCH_RAYS)
    rows = reconcile(patch_form_factors(g, p, rays, seed + SEED, progress), p.area).rows
    device_rows = upload(rows)
    samples = EXACT_RAYS * s.shadow_rays
    direct = direct_on_patches(scene, g, p, samples, seed + SEED, progress, device_rows)
    return solve(scene, p, device_rows, direct, s.tolerance, METHODS[s.solver], rows).light


def _probe_light(
    scene: Scene, surfaces: pipeline.Surfaces, traced: pipeline.Probes, light: pipeline.PatchLight, seed: int
) -> Arrays:
    """light (B, R, K, 3) f64 at the probes by rays of their own, and how many each: rays."""
    order = order_for(scene.settings.sampling.reconstruction)
    g, positions = surfaces.geometry, traced.octree.positions
    mean = float(np.mean(traced.rows.rays))
    rays = int(np.clip(1 << int(np.ceil(np.log2(PROBE_TIMES * mean))), *PROBE_RAYS))
    device_patches = upload_patches(g, surfaces.patches)
    found = ray_gather(g, device_patches, positions, None, [light.radiosity.light], rays, seed + SEED + 1, order)
    return {"light": found.radiance + pipeline.punctual_input(scene, g, positions, order), "rays": np.array(rays)}


def as_baked(scene: Scene) -> Scene | None:
    """The scene as the bake sees it: diffuse, no masks, nothing that moves or passes light. None where that is the scene itself."""
    materials = tuple(_diffuse(m) for m in scene.materials)
    meshes = tuple(m for m in scene.meshes if m.static and not scene.materials[m.material].passes_light)
    used = {m.material for m in meshes}
    plain = all(scene.materials[i].truth_bsdf is None and scene.materials[i].opacity is None for i in used)
    if plain and len(meshes) == len(scene.meshes):
        return None
    return dataclasses.replace(scene, materials=materials, meshes=meshes)


def _diffuse(m: Material) -> Material:
    texture = None if m.texture is None else baked_albedo(m, m.texture).astype(np.float32)
    return dataclasses.replace(m, albedo=baked_albedo(m, m.albedo), texture=texture, truth_bsdf=None, opacity=None)
