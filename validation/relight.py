"""`lightgauge relight`: new lights through a bake, on the OpenCL device.

The first frame builds what depends on the bake. Later frames trace the shadow rays of lights that moved, move light
through the rows, and allocate nothing on the device.
"""

from __future__ import annotations

import dataclasses
import io
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..fastpath.device import OpenDevice, open_device
from ..fastpath.rows import Relight, Rows
from ..reference import pipeline
from ..reference.config import AreaLight
from ..reference.datatypes import F32, F64, Mesh, Scene, Sky
from ..reference.errors import InputError
from ..reference.progress import silent
from ..reference.scene.buried_lights import refuse_buried
from ..reference.scene.lights_file import Lighting, load_lights
from ..reference.sh import COEFFICIENTS_2, order_of
from ..reference.sky import SKY_BINS, bin_radiance, split_peaks
from ..reference.transport.direct import punctual_irradiance, punctual_lights
from ..reference.transport.gather import upload
from ..reference.transport.patch_light import DirectLight
from ..reference.transport.patches import exitance_of
from ..reference.visibility import build_geometry
from .bake_store import LUMELS, PATCHES, PROBES, Bake, load
from .record import write_bytes_atomic

REPEATS = 5
SECOND, LAST = f"{PROBES}, 2-2 … 21", f"{PROBES}, 22"  # coefficients of probes with SH of order 2


class Relighter:
    """A bake on a device. Call it with a scene that has other lights: values by receiver, (R, K, 3) f32, patches (P, 3)."""

    def __init__(self, bake: Bake, device: OpenDevice) -> None:
        self._bake, p = bake, bake.patches
        self._geometry = build_geometry(bake.scene)
        samples = bake.scene.settings.radiosity.shadow_rays
        self.direct = DirectLight(self._geometry, p, samples, bake.seed, upload(bake.rows[PATCHES]))
        columns = p.count + SKY_BINS + 1
        on_device = {
            part: Rows(device, r.indptr, r.columns, values, columns)
            for name, r in bake.rows.items()
            for part, values in _parts(name, r.values).items()
        }
        self._patch_rows, self._device = on_device.pop(PATCHES), device
        self._receivers = on_device
        self._exitance = np.full((p.count, 3), np.nan, dtype=np.float32)
        self._direct = np.empty((p.count, 3), dtype=np.float32)
        self._sky: Sky | None = None
        self._bins = self._sky_bins(None)
        self._frame: Relight | None = None

    def __call__(self, scene: Scene) -> Mapping[str, F32]:
        """The steady light. Probes hold radiance SH, lumels irradiance, cubemap texels radiance, patches radiosity without
        the exitance of engine lights."""
        p = self._bake.patches
        exitance = exitance_of(scene.meshes, p.emitter, p.shine)[0].astype(np.float32)
        if self._frame is None or not np.array_equal(exitance, self._exitance):
            albedo = p.albedo.astype(np.float32)
            self._frame = Relight(self._device, self._patch_rows, self._receivers, albedo, exitance)
            self._exitance = exitance
        self._direct[:] = self.direct(scene, silent)
        if scene.sky is not self._sky:
            self._sky, self._bins = scene.sky, self._sky_bins(scene.sky)
        self._frame.reset()
        found = dict(self._frame.frame(self._direct, *self._bins, int(self._bake.facts["bounces"])))
        rest = [found.pop(name) for name in (SECOND, LAST) if name in found]
        if rest:
            found[PROBES] = np.concatenate([found[PROBES], *rest], axis=1)
        return self._with_punctual_input(scene, found)

    @staticmethod
    def _sky_bins(sky: Sky | None) -> tuple[F32, F32]:
        """π × radiance of the sky's bins (SKY_BINS, 3), as patches reflect it and as receivers see it."""
        smooth = None if sky is None else split_peaks(sky)[0]
        seen = None if sky is None or sky.engine_lit else sky
        reflected, visible = (np.pi * bin_radiance(s) for s in (smooth, seen))
        return reflected.astype(np.float32), visible.astype(np.float32)

    def _with_punctual_input(self, scene: Scene, found: Mapping[str, F32]) -> Mapping[str, F32]:
        """Punctual lights tagged `input` reach probes and lumels unreflected too."""
        lights = punctual_lights(scene, "input")
        if not lights:
            return found
        b, g = self._bake, self._geometry
        order = order_of(found[PROBES].shape[1])
        probes = found[PROBES] + pipeline.punctual_input(scene, g, b.probe_positions, order)
        lumels = found[LUMELS].copy()
        for light in lights:
            lumels[:, 0] += punctual_irradiance(g, light, b.lumels.centres, b.lumels.normals).astype(np.float32)
        return {**found, PROBES: probes, LUMELS: lumels}


def _parts(name: str, values: F32) -> dict[str, F32]:
    """Rows' values (nnz, K) as the device takes them, by name: K = 1 or 4 at a time, so the nine of order 2 in three parts."""
    if values.shape[1] != COEFFICIENTS_2:
        return {name: values}
    ends = {name: slice(0, 4), SECOND: slice(4, 8), LAST: slice(8, 9)}
    return {part: np.ascontiguousarray(values[:, s]) for part, s in ends.items()}


def relit_scene(bake: Bake, lighting: Lighting, source: str) -> Scene:
    """The bake's scene under other lights. Raises InputError for a lamp that was dark in the bake, or a buried light."""
    base = {v.mesh for v in bake.scene.settings.lights.values() if isinstance(v, AreaLight)}
    lamps = {v.mesh: (name, v) for name, v in lighting.lights.items() if isinstance(v, AreaLight)}
    shining = {bake.scene.meshes[n].name for n in np.unique(bake.patches.emitter) if n >= 0}
    meshes = []
    for mesh in bake.scene.meshes:
        if mesh.name in lamps:
            name, light = lamps[mesh.name]
            if mesh.name not in shining:
                raise InputError(
                    f"{source}: lights.{name}.mesh: {mesh.name!r} was baked without light of its own, so its patches are "
                    "shared with others; give it an area light in the scene and bake again"
                )
            meshes.append(_shining(mesh, np.asarray(light.radiance, dtype=np.float64), light.tag == "engine"))
        else:
            meshes.append(_shining(mesh, np.zeros(3), False) if mesh.name in base else mesh)
    refuse_buried(lighting.lights, meshes, bake.scene.materials, source)
    settings = bake.scene.settings.model_copy(update={"lights": dict(lighting.lights)})
    return dataclasses.replace(bake.scene, settings=settings, meshes=tuple(meshes), sky=lighting.sky)


def _shining(mesh: Mesh, emission: F64, engine: bool) -> Mesh:
    return dataclasses.replace(mesh, emission=emission, engine_lit=engine)


def relight_file(path: Path, lights: Path | None, out: Path) -> dict[str, Any]:
    """Relight the bake `path` with the file `lights` (None: the scene's own), write the values into `out` (.npz); returns
    what `relight --json` prints."""
    began = time.perf_counter()
    bake = load(path)
    scene, notes = bake.scene, []
    if lights is not None:
        base = bake.scene
        names = [m.name for m in base.meshes]
        rotation = base.settings.scene.rotation
        lighting = load_lights(lights, base.name, base.settings.lights, names, base.sky, rotation)
        scene, notes = relit_scene(bake, lighting, str(lights)), list(lighting.notes)
    relighter = Relighter(bake, open_device())
    values = {name: a.copy() for name, a in relighter(scene).items()}
    first = time.perf_counter() - began
    same = _timed(relighter, [scene])
    moved = _timed(relighter, [bake.scene, scene]) if lights is not None else None
    try:
        write_bytes_atomic(out, _archive(bake, values))
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written ({error.strerror or error}); choose another place: --out FILE"
        ) from error
    return {
        "bake": str(path),
        "lights": None if lights is None else str(lights),
        "scene": bake.scene.name,
        "values": str(out),
        "receivers": {name: _summary(a) for name, a in values.items() if len(a)},
        "bounces": bake.facts["bounces"],
        "shadow_rays": relighter.direct.shadow_rays,
        "first_s": first,
        "frame_ms": same,
        "moved_frame_ms": moved,
        "notes": [*bake.scene.notes, *notes],
    }


def _timed(relighter: Relighter, scenes: Sequence[Scene]) -> float:
    """Median milliseconds of a frame that changes from one scene's lights to the next one's, round and round."""
    times = []
    for scene in list(scenes) * REPEATS:
        start = time.perf_counter()
        relighter(scene)
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def _summary(values: F32) -> dict[str, Any]:
    """Counts, and for K = 1 mean, least and most of each colour; for SH of the first coefficient."""
    first = values.reshape(len(values), -1, 3)[:, 0].astype(np.float64)
    return {
        "count": len(values),
        "mean": first.mean(axis=0).tolist(),
        "min": first.min(axis=0).tolist(),
        "max": first.max(axis=0).tolist(),
    }


def _archive(bake: Bake, values: Mapping[str, F32]) -> bytes:
    """The values and where they belong, as a NumPy archive (no pickle)."""
    arrays: dict[str, npt.NDArray[Any]] = {
        "patch_radiosity": values[PATCHES],
        "patch_centroid": bake.patches.centroid,
        "patch_normal": bake.patches.normal,
        "patch_area": bake.patches.area,
        "probe_radiance_sh": values[PROBES],
        "probe_position": bake.probe_positions,
        "probe_valid": bake.probe_valid,
        "probe_light_from": bake.light_from,
        "lumel_irradiance": values[LUMELS][:, 0],
        "lumel_corners": bake.lumels.corners,
        "lumel_normal": bake.lumels.normals,
        "lumel_mesh": bake.lumels.mesh,
    }
    for name, cubemap in bake.scene.settings.cubemaps.items():
        size = cubemap.size
        arrays[f"cubemap_radiance.{name}"] = values[f"cubemap {name}"][:, 0].reshape(6, size, size, 3)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
