"""FLIP, SSIM and relMSE of every camera's picture, each beside what the truth's own noise scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .ground_truth import GroundTruth
from .metrics.images import PIXELS_PER_DEGREE, Exposures, Scores, exposures, score
from .record import metric
from .report.pictures import CameraPictures, SceneView

FIGURES = ("flip", "ssim", "relmse")


@dataclass(frozen=True)
class ImageFindings:
    """metrics `flip_camera_NAME` …, the rows of results.json's `images`, and why a picture has no figures."""

    metrics: dict[str, Any]
    images: list[dict[str, Any]]
    notes: list[str]


def image_findings(truth: GroundTruth, views: Sequence[SceneView]) -> ImageFindings:
    """Scores of ours against the truth's mean. noise: the score of one of the truth's two halves against the same mean: it differs by
    half of what the halves differ by, which is how the mean's own noise is distributed."""
    found = ImageFindings({}, [], [])
    for view in views:
        p = view.pictures
        if not p.hit.any() or float(p.truth[p.hit].mean()) <= 0.0:
            found.notes.append(f"no image metrics for camera {p.camera}: it sees no light")
            continue
        e = exposures(p.truth * p.albedo if (p.truth * p.albedo).any() else p.truth, p.hit)
        ours = score(p.truth, p.ours, p.albedo, p.hit, e)
        noise = _noise(truth, p, e)
        count = int(p.hit.sum())
        for name in FIGURES:
            entry = _entry(name, ours, noise, count)
            if entry is not None:
                found.metrics[f"{name}_camera_{p.camera}"] = entry
        found.images.append(
            {
                "camera": p.camera,
                "exposure_start": e.start,
                "exposure_stop": e.stop,
                "exposures": e.count,
                "pixels_per_degree": PIXELS_PER_DEGREE,
                "paths_per_pixel": truth.pictures[p.camera].spp,
            }
        )
    return found


def _noise(truth: GroundTruth, p: CameraPictures, e: Exposures) -> Scores:
    half = np.zeros_like(p.truth)
    half[p.hit] = truth.pictures[p.camera].halves[0]
    return score(p.truth, half, p.albedo, p.hit, e)


def _entry(name: str, ours: Scores, noise: Scores, count: int) -> dict[str, Any] | None:
    """A metric; below the noise where it is no worse than what exact light would score. It has no standard error: one picture."""
    value, floor = float(getattr(ours, name)), float(getattr(noise, name))
    below = value >= floor if name == "ssim" else value <= floor
    return metric(value, None, count, noise=floor, **({"below_noise": True} if below else {}))
