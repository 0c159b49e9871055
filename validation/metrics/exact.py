"""Light against closed forms, where a scene has one: no noise of a reference stands between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...reference.datatypes import F32, F64, Scene
from ...reference.texture_types import Samples
from ...reference.truth.analytic import closed_sphere_irradiance
from ...reference.truth.points import PointSet
from ..ground_truth import GroundTruth
from .error import Measured, jackknife, signed_bias


def exact_biases(scene: Scene, truth: GroundTruth, sampled: Mapping[PointSet, Samples]) -> dict[str, Measured]:
    """Inside a sphere, where the irradiance is the same everywhere: exact_bias, of ours, and truth_exact_bias, of the path-traced
    reference, (mean(E) - E_exact) / E_exact, at what the cameras see. Nothing of the patches' own tables enters.
    """
    if "camera" not in truth.points:
        return {}
    exact = _exact(scene, truth)
    found: dict[str, F32 | F64] = {
        "exact_bias": sampled["camera"].irradiance,
        "truth_exact_bias": truth.estimates["camera"].mean,
    }
    return {name: _bias(light.astype(np.float64), exact) for name, light in found.items()}


def _exact(scene: Scene, truth: GroundTruth) -> F64:
    g = truth.geometry
    albedo = np.stack([scene.materials[m.material].albedo for m in scene.meshes])[g.mesh]
    exitance = np.pi * np.stack([m.emission for m in scene.meshes])[g.mesh]
    return closed_sphere_irradiance(g.areas, albedo, exitance)


def _bias(light: F64, exact: F64) -> Measured:
    same = np.broadcast_to(exact, (1, *light.shape))
    return Measured(signed_bias(light, same), jackknife(signed_bias, light, same), len(light))
