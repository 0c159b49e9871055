"""Patches cut further where the light within them varies: towards contacts and shadow lines, and nowhere else.

For each level every patch is cut in four on trial. The pieces gather direct light and, by pilot rays, the light of the
uncut patches. Where the spread of the pieces, less the noise of their rays, exceeds the tolerance, the cut is kept
(Cohen, Greenberg, Immel and Brock 1986, "An efficient radiosity approach for realistic image synthesis": adaptive
subdivision by radiosity gradient).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..datatypes import F64, I64, Scene
from ..visibility import Geometry
from .adaptive import gathered, trace_pilot
from .elements import element_of, points_in_elements
from .patches import Patches, build_patches
from .receivers import patch_receivers

LEVELS = 3


def subdivided_patches(
    scene: Scene,
    g: Geometry,
    size: float,
    tolerance: float,
    seed: int,
    guess: Callable[[Patches], F64],
    direct: Callable[[Patches], F64],
) -> Patches:
    """Patches of edge `size` m, cut up to LEVELS times where the light varies by more than `tolerance` × its mean.

    guess: light (columns,) that patches and sky send; direct: direct irradiance (P,) on patches; both mean colours.
    """
    split: list[I64] = []
    patches = build_patches(scene, g, size)
    for level in range(LEVELS):
        mine = patches.key[:, 0] == level
        trial = build_patches(scene, g, size, [*split, patches.key[mine]])
        spread, mean = _spread(g, patches, trial, guess(patches), direct(trial), seed + level)
        cut = mine & (spread > tolerance * mean)
        if not cut.any():
            break
        split.append(patches.key[cut])
        patches = build_patches(scene, g, size, split)
    return patches


def _spread(g: Geometry, p: Patches, trial: Patches, light: F64, direct: F64, seed: int) -> tuple[F64, float]:
    """Standard deviation (P_front,) of the light within each patch of `p`, seen by its pieces in `trial`; mean light."""
    mean, variance = gathered(trace_pilot(g, p, patch_receivers(g, trial), seed), light)
    incident, noise = (direct + mean)[: trial.front], variance[: trial.front]
    parent, area = _parents(p, trial), trial.area[: trial.front]
    whole = np.bincount(parent, area, p.front)
    middle = np.bincount(parent, area * incident, p.front) / whole
    within = np.bincount(parent, area * (incident - middle[parent]) ** 2, p.front) / whole
    pieces = np.bincount(parent, minlength=p.front)
    by_noise = np.bincount(parent, area * noise, p.front) / whole * (1.0 - 1.0 / pieces)
    # Twice the noise is taken off: a patch is cut for what is seen, not for what may be.
    return np.sqrt(np.maximum(within - 2.0 * by_noise, 0.0)), float(area @ incident / area.sum())


def _parents(p: Patches, trial: Patches) -> I64:
    """Front patch (trial.front,) of `p` in which each front patch of `trial` lies."""
    element = trial.order[trial.start[:-1]]
    triangle = trial.element_triangle[element]
    uv = points_in_elements(trial.cuts, trial.first_element, triangle, element, np.full((len(element), 2), 1.0 / 3.0))
    return p.element_patch[element_of(p.cuts, p.first_element, triangle, uv[:, 0], uv[:, 1])].astype(np.int64)
