"""Direct light on patches, light by light, so that moving one light touches only what depends on it.

What a light of colour 1 puts on each patch (its response) is kept; a light that only changes colour costs no ray, and one
that moves costs its own shadow rays and no others.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..config import Punctual
from ..datatypes import F64, Bool, Scene, Sky
from ..directions import rotate, rotations, sobol
from ..progress import Progress
from ..sky import SKY_BINS, split_peaks
from ..visibility import Geometry
from .adaptive import Pilot, trace_pilot
from .direct import colour_of, lamp_response, peak_irradiance, punctual_lights, punctual_response
from .gather import DeviceRows, gather
from .patches import Patches, surface_samples
from .receivers import patch_receivers

NEAR = 0.1  # share of a patch's hemisphere
POINTS_PER_BATCH = 1 << 20
COLOURS = {"intensity", "irradiance", "tag", "type"}
AtPoints = Callable[[F64, F64, npt.NDArray[np.floating]], F64]


class DirectLight:
    """Mean irradiance (P, 3), W·m⁻², of every patch from point, spot and directional lights, area lights tagged `engine` and
    the peaks of an image sky. Call it with a scene; `shadow_rays` counts what was traced so far.

    samples: points per patch. rows: patch form factors. With them, patches `near_lamp` take its light through them: there area
    sampling is heavy-tailed (failure-catalogue A5), and cosine rays are good.
    """

    def __init__(self, g: Geometry, p: Patches, samples: int, seed: int, rows: DeviceRows | None = None) -> None:
        self._g, self._p, self._rows, self._samples, self._seed = g, p, rows, samples, seed
        self._table, self._offsets = sobol(samples, 6, seed + 1), rotations(p.count, 6, seed + 1)
        self._kept: dict[Hashable, F64] = {}
        self._total, self._scaled = np.empty((p.count, 3)), np.empty((p.count, 3))
        self.shadow_rays = 0

    def __call__(self, scene: Scene, progress: Progress) -> F64:
        """Direct light of the scene's lights, in an array that the next call overwrites. Responses of lights that are gone
        are dropped."""
        total, scaled = self._total, self._scaled
        total[:] = 0.0
        used: dict[Hashable, F64] = {}
        sources = list(self._sources(scene))
        for number, (key, colour, at_points) in enumerate(sources):
            response = self._kept.get(key)
            if response is None:
                response = self._mean(at_points)
                if isinstance(key, int):
                    response = self._near(key, response)
            used[key] = response
            total += np.multiply(response, colour, out=scaled)
            progress("direct light", number + 1, len(sources))
        self._kept = used
        return total

    def _sources(self, scene: Scene) -> list[tuple[Hashable, F64, AtPoints]]:
        """What the response depends on, the colour it is multiplied with, and the response at points."""
        found: list[tuple[Hashable, F64, AtPoints]] = []
        for light in punctual_lights(scene, "engine") + punctual_lights(scene, "input"):  # both are reflected
            key = (light.type, light.model_dump_json(exclude=COLOURS))
            found.append((key, colour_of(light), self._punctual(light)))
        for number, mesh in enumerate(scene.meshes):
            if mesh.engine_lit and mesh.static and mesh.emission.any():
                found.append((number, mesh.emission, self._lamp(number)))
        peaks = None if scene.sky is None else split_peaks(scene.sky)[1]
        if peaks is not None:
            picture: Hashable = ("sky", peaks.rotation_deg, peaks.image.tobytes())
            found.append((picture, np.ones(3), self._peaks(peaks)))
        return found

    def _punctual(self, light: Punctual) -> AtPoints:
        return lambda points, normals, _: punctual_response(self._g, light, points, normals)[:, None]

    def _lamp(self, mesh: int) -> AtPoints:
        return lambda points, normals, xi: lamp_response(self._g, mesh, points, normals, xi)[:, None]

    def _peaks(self, peaks: Sky) -> AtPoints:
        return lambda points, normals, xi: peak_irradiance(self._g, peaks, points, normals, xi[:, :2])

    def _mean(self, at_points: AtPoints) -> F64:
        """Mean over points of each patch, (P, 1) or (P, 3)."""
        p, n, parts = self._p, self._samples, []
        step = max(1, POINTS_PER_BATCH // n)
        for begin in range(0, p.count, step):
            part = np.arange(begin, min(begin + step, p.count))
            xi = rotate(self._table[None], self._offsets[part][:, None, :])
            points, normals = (a.reshape(-1, 3) for a in surface_samples(self._g, p, part, xi[..., :3]))
            light = at_points(points, normals, xi[..., 3:].reshape(-1, 3))
            parts.append(light.reshape(len(part), n, -1).mean(axis=1))
        self.shadow_rays += p.count * n
        return np.concatenate(parts)

    def _near(self, lamp: int, response: F64) -> F64:
        """The lamp's response, through form factors for patches that it is near to."""
        if self._rows is None:
            return response
        light = np.zeros((self._p.count + SKY_BINS + 1, 3))
        light[: self._p.count][self._p.emitter == lamp] = 1.0
        share = gather(self._rows, light)[:, 0, :1].astype(np.float64)
        return np.where(near_lamp(self._p, self._pilot, lamp)[:, None], np.pi * share, response)

    @cached_property
    def _pilot(self) -> Pilot:
        """The pilot of the rows, when they are of the same seed."""
        return trace_pilot(self._g, self._p, patch_receivers(self._g, self._p), self._seed)


def near_lamp(p: Patches, pilot: Pilot, lamp: int) -> Bool:
    """Patches (P,) whose hemisphere holds more than NEAR of mesh `lamp`, as rays say that the light itself is not gathered by: rows
    that chose themselves would do so where they happen to read too much."""
    on_lamp = np.concatenate([p.emitter == lamp, np.zeros(SKY_BINS + 1, dtype=np.bool_)])
    return np.asarray(on_lamp[pilot.columns].mean(axis=1) > NEAR)


def direct_on_patches(
    scene: Scene, g: Geometry, p: Patches, samples: int, seed: int, progress: Progress, rows: DeviceRows | None = None
) -> F64:
    """Direct light (P, 3), W·m⁻², for one set of lights; see `DirectLight`."""
    return DirectLight(g, p, samples, seed, rows)(scene, progress)
