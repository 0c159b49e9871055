"""One signed picture per link and camera: where in the view each stage goes wrong.

A pixel of link k is (Y(E_k) - Y(E_(k-1))) / (Y(R) + 0.01 mean Y(R)), as the error pictures are (report/pictures.py). The truth's
picture is noisy: what it divides is averaged over a window, and links that have paths at one end are averaged over it too, those
that have a pixel's own few rays at one end over 3 × 3 pixels. But for these windows the pictures of all links add up to the picture
of the error.

A picture of more than MOST_PIXELS is read at every second, third … pixel along both axes, each shown for those around it: a page
shows no more, and the cost of all links then hangs on the settings of the scene alone, not on how large its camera's film is.
Windows are of so many pixels that were read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter

from ...reference.datatypes import F32, F64, I64, Bool
from ...reference.progress import Progress
from ...reference.truth.mitsuba_scene import build_truth_scene
from ...reference.truth.path_traced import path_depth, picture
from ...reference.truth.points import CameraView, Points
from ..ground_truth import named
from ..report.pictures import LUMINANCE
from ..report.sections import AVERAGES, NOISY
from .chain import gathered_stages, in_parts
from .kept import Parts
from .links import LINKS, NAMES
from .reference import geometry_of, punctual
from .world import World, as_baked

RAYS = 256  # of a pixel, twice: 2 % of its light, under 1 % in a window of 3 × 3
MOST_PIXELS = 1 << 16  # of a camera
AT_ONCE = 16384
TRACED = ("materials", "patches")  # links with paths at an end
BY_RAYS = ("sh_order", "offset", "interpolation")  # links with few rays at an end
SMALL = 1  # radius of the window that those are averaged over


def link_pictures(w: World, progress: Progress, parts: Parts | None = None) -> dict[str, dict[str, F32]]:
    """By camera and name of the link (H, W) f32, of half a float's precision: signed, relative, 0 where no surface is seen. parts:
    keeps each camera's."""
    parts, found = parts or Parts(), dict[str, F32]()
    for name, view in w.truth.views.items():
        told = named(progress, name)
        found |= parts.arrays(f"pictures.{name}", partial(_packed_camera, w, name, view, told))
    return unpacked(found)


def _packed_camera(w: World, name: str, view: CameraView, progress: Progress) -> dict[str, F32]:
    return packed({name: _of_camera(w, name, view, progress)})


@dataclass(frozen=True, eq=False)
class Thinned:
    """Every `step`-th pixel of a camera, from the middle of the first `step` on. hit (h, w): whether it sees a surface; number (N,):
    which of the view's points those that do are; points: these N."""

    step: int
    hit: Bool
    number: I64
    points: Points

    def enlarged(self, image: F32, hit: Bool) -> F32:
        """A picture (h, w) of the pixels read as one of all pixels: (H, W), 0 where `hit` (H, W) is not."""
        rows, columns = (
            np.minimum(np.arange(n) // self.step, m - 1) for n, m in zip(hit.shape, image.shape, strict=True)
        )
        return np.where(hit, image[np.ix_(rows, columns)], np.float32(0.0))


def thinned(view: CameraView, most: int = MOST_PIXELS) -> Thinned:
    """At most about `most` of a camera's pixels, and one that sees a surface at least."""
    hit = view.hit.reshape(view.camera.height, view.camera.width)
    number = np.cumsum(view.hit).reshape(hit.shape) - 1
    step = max(1, math.ceil(math.sqrt(hit.size / most)))
    while True:
        first = tuple(slice(min(step, n) // 2, None, step) for n in hit.shape)
        if hit[first].any() or step == 1:
            kept = number[first][hit[first]].astype(np.int64)
            return Thinned(step, hit[first], kept, view.points.part(kept))
        step -= 1


def _of_camera(w: World, name: str, view: CameraView, progress: Progress) -> dict[str, F32]:
    few = thinned(view)
    n, done = len(few.number), 0

    def work(part: Points) -> list[F64]:
        nonlocal done
        stages = [s.mean(axis=0, keepdims=True) @ LUMINANCE for s in gathered_stages(w, part, RAYS, averaged=True)]
        done += len(part.positions)
        progress("pictures of the waterfall", done, n)
        return stages

    truth = w.truth.pictures[name]
    mean = truth.mean[few.number]
    first = [mean[None] @ LUMINANCE, _diffuse(w, few.points, mean, truth.spp, progress)[None] @ LUMINANCE]
    stages = [*first, *in_parts(few.points, AT_ONCE, work)]
    radius = AVERAGES[sum(truth.noise > limit for limit in NOISY)]
    hit = view.hit.reshape(view.camera.height, view.camera.width)
    return {link: few.enlarged(image, hit) for link, image in differences(stages, few.hit, radius).items()}


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


def _diffuse(w: World, points: Points, truth: F64, spp: int, progress: Progress) -> F64:
    """Stage 1 (N, 3) at the pixels read; the truth itself where the bake sees everything."""
    baked = as_baked(w.scene)
    if baked is None:
        return truth
    depth = path_depth(baked, baked.settings.truth.tolerance)
    found = picture(build_truth_scene(baked), points, spp, depth, w.seed + 11, progress)
    return found.mean + punctual(baked, geometry_of(baked), points)


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
