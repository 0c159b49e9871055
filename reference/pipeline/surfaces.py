"""The patch half of the chain: scene → patches → form factors; lights → radiosity; lumels, cubemaps, points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..clock import Clock
from ..datatypes import F64, Scene
from ..errors import InputError
from ..progress import Progress, silent
from ..transport.adaptive import LEAST, Allocation, Pilot, allocate, guess_light, raised, trace_pilot
from ..transport.direct import punctual_irradiance, punctual_lights
from ..transport.form_factors import FormFactors, form_factors, patch_form_factors, point_form_factors
from ..transport.gather import DeviceRows, gather, upload
from ..transport.hybrid import few_cells, hybrid_form_factors
from ..transport.lumels import Lumels, build_lumels, lumel_receivers
from ..transport.patch_light import direct_on_patches, near_lamp
from ..transport.patches import Patches, auto_patch_size, build_patches
from ..transport.radiosity import Radiosity, solve
from ..transport.receivers import Receivers, patch_receivers, texel_receivers
from ..transport.reconcile import Reconciled, reconcile
from ..transport.solvers import METHODS
from ..transport.subdivide import subdivided_patches
from ..visibility import Geometry, build_geometry

PILOT_SHADOW_RAYS = 16
CLOSED_FORMS_BELOW = 1e-3  # radiosity.noise: rays alone would need millions for less


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The patch half of a bake: what placement does not change.

    rows: reciprocal, closed form factors of the patches; laws: what reconciling them changed. guess: (columns,) mean
    colour of the light that a pilot finds on patches and sky; it decides where rays go, not what they find. method: "rays", or
    "closed forms and rays".
    """

    geometry: Geometry
    patches: Patches
    patch_size: float
    rows: FormFactors
    laws: Reconciled
    device_rows: DeviceRows
    guess: F64
    allocation: Allocation
    method: str
    seconds: Mapping[str, float]


def bake_surfaces(scene: Scene, seed: int, progress: Progress = silent) -> Surfaces:
    """Geometry, patches and patch form factors.

    Raises InputError where the albedo is too high to converge, or too many patches are asked for as a reference.
    """
    clock = Clock()
    geometry = build_geometry(scene)
    settings = scene.settings.radiosity
    size = settings.patch_size or auto_patch_size(geometry)
    patches = _patches(scene, geometry, size, seed)
    clock.lap("patches")
    pilot = trace_pilot(geometry, patches, patch_receivers(geometry, patches), seed)
    guess = guess_light(scene, patches, pilot, _pilot_direct(scene, geometry, patches, seed))
    allocation = _patch_rays(scene, patches, pilot, guess)
    clock.lap("pilot")
    exact = settings.noise < CLOSED_FORMS_BELOW
    try:
        if exact:
            cells = few_cells(geometry, patches)  # before anything is traced
            raw = patch_form_factors(geometry, patches, allocation.rays, seed, progress)
            laws = hybrid_form_factors(geometry, patches, raw, settings.noise, seed, progress, cells).laws
        else:
            laws = reconcile(patch_form_factors(geometry, patches, allocation.rays, seed, progress), patches.area)
    except ValueError as error:
        raise InputError(f"scene '{scene.name}': {error}") from error
    clock.lap("patch_form_factors")
    rows = upload(laws.rows)
    method = "closed forms and rays" if exact else "rays"
    return Surfaces(geometry, patches, size, laws.rows, laws, rows, guess, allocation, method, clock.seconds)


def _patch_rays(scene: Scene, patches: Patches, pilot: Pilot, guess: F64) -> Allocation:
    """Rays of the patches. Engine lamps are not in the light that others gather, but in that of patches near them."""
    s = scene.settings.radiosity
    found = allocate(pilot, guess, patches.area, s.noise, s.rays)
    for lamp in np.unique(patches.emitter[patches.engine_exitance.any(axis=1)]):
        near = near_lamp(patches, pilot, lamp)
        if near.any():
            seen = guess.copy()
            seen[: patches.count] += np.where(patches.emitter == lamp, patches.engine_exitance.mean(axis=1), 0.0)
            found = raised(found, allocate(pilot, seen, patches.area, s.noise, s.rays), near)
    return found


def _patches(scene: Scene, g: Geometry, size: float, seed: int) -> Patches:
    """Patches of the wanted size, cut further where their light varies if the scene asks for that."""
    tolerance = scene.settings.radiosity.patch_error
    if tolerance is None:
        return build_patches(scene, g, size)

    def direct(p: Patches) -> F64:
        return _pilot_direct(scene, g, p, seed)

    def guess(p: Patches) -> F64:
        return guess_light(scene, p, trace_pilot(g, p, patch_receivers(g, p), seed), direct(p))

    return subdivided_patches(scene, g, size, tolerance, seed, guess, lambda p: direct(p).mean(axis=1))


def _pilot_direct(scene: Scene, g: Geometry, p: Patches, seed: int) -> F64:
    return direct_on_patches(scene, g, p, PILOT_SHADOW_RAYS, seed + 11, silent)


def _solved(scene: Scene, surfaces: Surfaces, direct: F64) -> Radiosity:
    """The radiosity. Raises InputError where the albedo is too high to converge."""
    s = scene.settings.radiosity
    try:
        return solve(
            scene, surfaces.patches, surfaces.device_rows, direct, s.tolerance, METHODS[s.solver], surfaces.rows
        )
    except ValueError as error:
        raise InputError(f"scene '{scene.name}': {error}") from error


def allocated(
    surfaces: Surfaces, receivers: Receivers, noise: float, most: int, seed: int, least: int = LEAST
) -> Allocation:
    """Rays of receivers other than patches, for the light that the surfaces' pilot found."""
    pilot = trace_pilot(surfaces.geometry, surfaces.patches, receivers, seed)
    return allocate(pilot, surfaces.guess, np.ones(receivers.count), noise, most, least)


@dataclass(frozen=True, eq=False)
class SurfaceReceivers:
    """What else a bake keeps: lumels with their rows, and the rows of each cubemap's texels by name."""

    lumels: Lumels
    lumel_rows: FormFactors
    cubemap_rows: Mapping[str, FormFactors]


def bake_receivers(scene: Scene, surfaces: Surfaces, seed: int, progress: Progress = silent) -> SurfaceReceivers:
    """Form factors of lumels and cubemap texels."""
    g, p, s = surfaces.geometry, surfaces.patches, scene.settings.radiosity
    lumels = build_lumels(scene, g)
    receivers = lumel_receivers(g, lumels)
    rays = allocated(surfaces, receivers, s.noise, s.rays, seed + 17).rays
    lumel_rows = form_factors(g, p, receivers, rays, seed + 17, progress, "form factors of lumels")
    cubemaps = {
        name: form_factors(
            g, p, texel_receivers(g, np.array([c.position]), c.size), c.rays, seed + 19, progress, f"cubemap {name}"
        )
        for name, c in scene.settings.cubemaps.items()
    }
    return SurfaceReceivers(lumels, lumel_rows, cubemaps)


@dataclass(frozen=True, eq=False)
class PatchLight:
    """Radiosity of a scene, shared by all placements."""

    direct: F64
    radiosity: Radiosity
    seconds: Mapping[str, float] = field(default_factory=dict)


def light_patches(scene: Scene, surfaces: Surfaces, seed: int, progress: Progress = silent) -> PatchLight:
    """Direct light and radiosity.

    Raises InputError where the albedo is too high to converge.
    """
    clock = Clock()
    s = scene.settings.radiosity
    direct = direct_on_patches(
        scene, surfaces.geometry, surfaces.patches, s.shadow_rays, seed, progress, surfaces.device_rows
    )
    clock.lap("direct_light")
    radiosity = _solved(scene, surfaces, direct)
    clock.lap("radiosity")
    return PatchLight(direct, radiosity, clock.seconds)


def gather_at_points(
    scene: Scene, surfaces: Surfaces, light: PatchLight, positions: F64, normals: F64, seed: int, rays: int | None = None
) -> F64:  # fmt: skip
    """Irradiance (N, 3), W·m⁻², gathered by rays straight from the patches at points (N, 3) with unit normals (N, 3):
    what probes of unlimited number and order would give. rays: for each point, `radiosity.rays` if None."""
    rays = scene.settings.radiosity.rays if rays is None else rays
    g = surfaces.geometry
    rows = point_form_factors(g, surfaces.patches, positions, normals, rays, seed + 5, silent)
    total = gather(upload(rows), light.radiosity.light)[:, 0].astype(np.float64)
    for item in punctual_lights(scene, "input"):
        total += punctual_irradiance(g, item, positions, normals)
    return total
