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
        spread, mean = _spread(g, patches, trial, level, guess(patches), direct(trial), seed + level)
        cut = mine & (spread > tolerance * mean)
        if not cut.any():
            break
        split.append(patches.key[cut])
        patches = build_patches(scene, g, size, split)
    return patches


def _spread(
    g: Geometry, p: Patches, trial: Patches, level: int, light: F64, direct: F64, seed: int
) -> tuple[F64, float]:
    """Standard deviation (P_front,) of the light within each patch of `p`, seen by its pieces in `trial`; mean light."""
    mean, variance = gathered(trace_pilot(g, p, patch_receivers(g, trial), seed), light)
    incident, noise = (direct + mean)[: trial.front], variance[: trial.front]
    area = trial.area[: trial.front]
    average = float(area @ incident / area.sum())
    parent = _parents(p, trial, level)
    known = parent >= 0
    parent, area, incident, noise = parent[known], area[known], incident[known], noise[known]
    whole = np.maximum(np.bincount(parent, area, p.front), np.finfo(np.float64).tiny)
    middle = np.bincount(parent, area * incident, p.front) / whole
    within = np.bincount(parent, area * (incident - middle[parent]) ** 2, p.front) / whole
    pieces = np.maximum(np.bincount(parent, minlength=p.front), 1)
    by_noise = np.bincount(parent, area * noise, p.front) / whole * (1.0 - 1.0 / pieces)
    # Twice the noise is taken off: a patch is cut for what is seen, not for what may be.
    return np.sqrt(np.maximum(within - 2.0 * by_noise, 0.0)), average


def _parents(p: Patches, trial: Patches, level: int) -> I64:
    """Front patch (trial.front,) of `p` whose place holds that of each front patch of `trial`, in which patches of `level` are
    cut; -1 where elements so small reach into a place that `p` had none in."""
    key = trial.key.copy()
    deeper = key[:, 0] > level
    key[deeper, 0] = level
    key[deeper, 3:] //= 2
    _, number = np.unique(np.concatenate([p.key, key]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    patch = np.full(number.max() + 1, -1)
    patch[number[: p.front]] = np.arange(p.front)
    return patch[number[p.front :]]
