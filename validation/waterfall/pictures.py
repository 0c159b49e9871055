"""One signed picture per link and camera: where in the view each stage goes wrong.

A pixel of link k is (Y(E_k) - Y(E_(k-1))) / (Y(R) + 0.01 mean Y(R)), as the error pictures are (report/pictures.py). The truth's
picture is noisy: what it divides is averaged over a window, and links that have paths at one end are averaged over it too, those
that have a pixel's own few rays at one end over 3 × 3 pixels. But for these windows the pictures of all links add up to the picture
of the error.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter

from ...reference.datatypes import F32, F64, Bool
from ...reference.progress import Progress
from ...reference.truth.mitsuba_scene import build_truth_scene
from ...reference.truth.path_traced import path_depth, picture
from ...reference.truth.points import CameraView, Points
from ..report.pictures import LUMINANCE
from ..report.sections import AVERAGES, NOISY
from .chain import gathered_stages, in_parts
from .links import LINKS, NAMES
from .reference import geometry_of, punctual
from .world import World, as_baked

RAYS, FEW_RAYS = 512, 64  # of a pixel, twice
MANY_PIXELS = 200_000
AT_ONCE = 16384
TRACED = ("materials", "patches")  # links with paths at an end
BY_RAYS = ("sh_order", "offset", "interpolation")  # links with few rays at an end
SMALL = 1  # radius of the window that those are averaged over


def link_pictures(w: World, progress: Progress) -> dict[str, dict[str, F32]]:
    """By camera and name of the link (H, W) f32: signed, relative, 0 where no surface is seen."""
    return {name: _of_camera(w, name, view, progress) for name, view in w.truth.views.items()}


def _of_camera(w: World, name: str, view: CameraView, progress: Progress) -> dict[str, F32]:
    n = len(view.points.positions)
    rays = RAYS if n <= MANY_PIXELS else FEW_RAYS
    done = 0

    def work(part: Points) -> list[F64]:
        nonlocal done
        stages = [s.mean(axis=0, keepdims=True) @ LUMINANCE for s in gathered_stages(w, part, rays, averaged=True)]
        done += len(part.positions)
        progress("pictures of the waterfall", done, n)
        return stages

    truth = w.truth.pictures[name]
    first = [truth.mean[None] @ LUMINANCE, _diffuse(w, view, truth.mean, truth.spp, progress)[None] @ LUMINANCE]
    stages = [*first, *in_parts(view.points, AT_ONCE, work)]
    radius = AVERAGES[sum(truth.noise > limit for limit in NOISY)]
    return differences(stages, view.hit.reshape(view.camera.height, view.camera.width), radius)


def differences(stages: list[F64], hit: Bool, radius: int) -> dict[str, F32]:
    """Pictures (H, W) by link from the luminance (1, N) of all stages at the `hit` (H, W) pixels, averaged where noisy over windows of
    2 · radius + 1 pixels an edge."""

    def image(values: F64) -> F64:
        out = np.zeros(hit.shape)
        out[hit] = values
        return out

    share = _window(hit.astype(np.float64), radius)
    truth = stages[0][0]
    floor = 0.01 * max(float(truth.mean()), 0.0) if truth.size else 0.0
    below = _window(image(np.abs(truth)), radius) / np.maximum(share, 1e-9) + floor
    found = {}
    for link, (before, after) in zip(LINKS, pairwise(stages), strict=True):
        difference = image(after[0] - before[0])
        mine = radius if link.name in TRACED else SMALL if link.name in BY_RAYS else 0
        if mine:
            difference = _window(difference, mine) / np.maximum(_window(hit.astype(np.float64), mine), 1e-9)
        found[link.name] = np.where(hit & (below > 0.0), difference / np.where(below > 0.0, below, 1.0), 0.0).astype(
            np.float32
        )
    return found


def _window(values: F64, radius: int) -> F64:
    """Mean over windows; what lies outside of the picture counts as 0."""
    return np.asarray(uniform_filter(values, 2 * radius + 1, mode="constant")) if radius else values


def _diffuse(w: World, view: CameraView, truth: F64, spp: int, progress: Progress) -> F64:
    """Stage 1 (N, 3) at the pixels; the truth itself where the bake sees everything."""
    baked = as_baked(w.scene)
    if baked is None:
        return truth
    depth = path_depth(baked, baked.settings.truth.tolerance)
    found = picture(build_truth_scene(baked), view.points, spp, depth, w.seed + 11, progress)
    return found.mean + punctual(baked, geometry_of(baked), view.points)


def packed(pictures: Mapping[str, Mapping[str, F32]]) -> dict[str, F32]:
    """As arrays for the cache: links of each camera stacked, half floats are enough for a colour."""
    return {
        f"camera.{name}": np.stack([found[k] for k in NAMES]).astype(np.float16) for name, found in pictures.items()
    }


def unpacked(arrays: Mapping[str, F32]) -> dict[str, dict[str, F32]]:
    """Inverse of `packed`."""
    return {
        key.removeprefix("camera."): dict(zip(NAMES, stack.astype(np.float32), strict=True))
        for key, stack in arrays.items()
        if key.startswith("camera.")
    }
