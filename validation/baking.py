"""`lightgauge bake`: everything that does not depend on the lighting, into one file."""

from __future__ import annotations

import resource
from pathlib import Path
from typing import Any

import numpy as np

from ..reference import pipeline
from ..reference.datatypes import Scene
from ..reference.errors import InputError
from ..reference.transport.solver_types import device_system
from ..reference.transport.spectral import bounce_count, estimate_spectrum, refuse_slow
from ..reference.visibility import build_geometry
from .bake_store import CUBEMAP, LUMELS, PATCHES, PROBES, Bake, save
from .progress_bar import ProgressBar


def bake_scene(scene: Scene, out: Path, seed: int, quiet: bool) -> dict[str, Any]:
    """Bake `scene` into the file `out`; returns what `bake --json` prints. Nothing is written before all is done."""
    with ProgressBar(scene.name, quiet) as progress:
        pipeline.check_placement(scene, build_geometry(scene))
        surfaces = pipeline.bake_surfaces(scene, seed, progress)
        probes = pipeline.bake_probes(scene, surfaces, pipeline.place(scene, surfaces, seed), seed, progress)
        others = pipeline.bake_receivers(scene, surfaces, seed, progress)
        spectral = _spectral_radius(scene, surfaces)
    rows = {PATCHES: surfaces.rows, PROBES: probes.rows, LUMELS: others.lumel_rows}
    rows |= {CUBEMAP + name: r for name, r in others.cubemap_rows.items()}
    laws, patch_rays, probe_rays = surfaces.laws, surfaces.allocation, probes.allocation
    facts = {
        "method": surfaces.method,
        "patch_size_m": surfaces.patch_size,
        "spectral_radius": spectral,
        "bounces": bounce_count(spectral, scene.settings.radiosity.tolerance),
        "reciprocity_raw": laws.raw_reciprocity,
        "closure_averaged": laws.symmetric_closure,
        "reciprocity": laws.reciprocity,
        "closure": laws.closure,
        "patch_rays": patch_rays.spent,
        "patch_rays_if_uniform": patch_rays.uniform,
        "patch_noise": patch_rays.reached,
        "probe_rays": probe_rays.spent,
        "probe_rays_if_uniform": probe_rays.uniform,
        "probe_noise": probe_rays.reached,
        "rms_row_se": {name: _rms(r.row_se) for name, r in rows.items()},
    }
    kept = Bake(
        scene, seed, surfaces.patches, rows, probes.octree.positions, probes.valid, probes.light_from, others.lumels, facts
    )  # fmt: skip
    save(out, kept)
    return {
        "file": str(out),
        "bytes": out.stat().st_size,
        "scene": scene.name,
        "receivers": {name: r.rows for name, r in rows.items()},
        "valid_probes": int(probes.valid.sum()),
        "facts": facts,
        "seconds": {**surfaces.seconds, **probes.seconds},
        "peak_rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "notes": [*scene.notes, *pipeline.bitmap(scene, probes.octree.grid).notes],
    }


def _spectral_radius(scene: Scene, surfaces: pipeline.Surfaces) -> float:
    """Bound from above. Raises InputError where light would take too many bounces to settle."""
    p = surfaces.patches
    system = device_system(surfaces.device_rows, p.albedo, np.zeros_like(p.albedo), p.area)
    spectrum = estimate_spectrum(system)
    try:
        refuse_slow(system, spectrum)
    except ValueError as error:
        raise InputError(f"scene '{scene.name}': {error}") from error
    return spectrum.upper


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0
