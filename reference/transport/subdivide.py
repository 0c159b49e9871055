"""Patches cut further where the light within them varies: towards contacts and shadow lines, and nowhere else.

For each level every patch is cut in four on trial. The pieces gather direct light and, by pilot rays, the light of the
uncut patches. Where the pieces differ by more than the tolerance they gather once more, by CONFIRM times the rays, and
the cut is kept if what they differ by exceeds the tolerance without the noise of these (Cohen, Greenberg, Immel and
Brock 1986, "An efficient radiosity approach for realistic image synthesis": adaptive subdivision by radiosity gradient).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..datatypes import F64, I64, Bool, Scene
from ..visibility import Geometry
from .adaptive import gathered, trace_pilot
from .patches import Patches, build_patches
from .receivers import patch_receivers, some_of

LEVELS = 3
CONFIRM = 16


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
        pieces = _Pieces(g, patches, trial, _parents(patches, trial, level), guess(patches), direct(trial))
        cut = mine & _uneven(pieces, tolerance, seed + level * (CONFIRM + 1))
        if not cut.any():
            break
        split.append(patches.key[cut])
        patches = build_patches(scene, g, size, split)
    return patches


class _Pieces(NamedTuple):
    """What the front patches of `trial` may gather: light (columns,) of the patches `p`, direct (P_trial,) of their own; and
    parent (P_trial front,): the patch of `p` that each is a piece of, or -1."""

    g: Geometry
    p: Patches
    trial: Patches
    parent: I64
    light: F64
    direct: F64


def _uneven(t: _Pieces, tolerance: float, seed: int) -> Bool:
    """Patches (P_front,) within which the light varies by more than `tolerance` × its mean."""
    rows = np.flatnonzero(t.parent >= 0)
    incident, noise = _gathered(t, rows, 1, seed)
    area = t.trial.area[rows]
    limit = (tolerance * float(area @ incident / area.sum())) ** 2
    doubtful = _variance(t, rows, incident, 0.0 * noise) > limit
    rows = rows[doubtful[t.parent[rows]]]
    if len(rows) == 0:
        return doubtful
    # Twice the noise is taken off: a patch is cut for what is seen, not for what may be.
    incident, noise = _gathered(t, rows, CONFIRM, seed + 1)
    return _variance(t, rows, incident, 2.0 * noise) > limit


def _gathered(t: _Pieces, rows: I64, times: int, seed: int) -> tuple[F64, F64]:
    """Light on pieces `rows` and the variance of it from `times` pilots, (R,) each."""
    receivers = some_of(patch_receivers(t.g, t.trial), rows)
    runs = [gathered(trace_pilot(t.g, t.p, receivers, seed + k), t.light) for k in range(times)]
    mean, variance = (np.mean([run[k] for run in runs], axis=0) for k in (0, 1))
    return t.direct[rows] + mean, variance / times


def _variance(t: _Pieces, rows: I64, incident: F64, noise: F64) -> F64:
    """Variance (P_front,) of the light within each patch, from pieces `rows` (R,), less their `noise` (R,)."""
    parent, area, count = t.parent[rows], t.trial.area[rows], t.p.front
    whole = np.maximum(np.bincount(parent, area, count), np.finfo(np.float64).tiny)
    middle = np.bincount(parent, area * incident, count) / whole
    within = np.bincount(parent, area * (incident - middle[parent]) ** 2, count) / whole
    pieces = np.maximum(np.bincount(parent, minlength=count), 1)
    return np.asarray(within - np.bincount(parent, area * noise, count) / whole * (1.0 - 1.0 / pieces))


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
