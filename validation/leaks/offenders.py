"""The voxels that leak at the moment, ready for the descent: which probes light comes from, and how fine a voxel may become."""

from __future__ import annotations

import numpy as np

from ...reference.datatypes import F64, I64, Bool
from ...reference.lattice import cells, keys
from .attribution import Leaks, blamed, walls_crossed
from .descent import Offenders
from .field import LightField, Places, cells_at

MOST_LIT = 3  # probes of an offender that are asked for
HAIR = 1e-3  # octaves: what rounding may do to a size on the lattice


def offenders(field: LightField, leaks: Leaks, at: Places, sheets: Bool, deepest: int) -> list[Offenders]:
    """The voxels through which light leaks, each with the probes that give most of it, by level and by whether they are dead."""
    w = leaks.pairs.weights
    chosen = np.flatnonzero(blamed(leaks) & ~sheets[w.sample])
    answers, holds = leaks.answers[w.sample[chosen]], leaks.holds[w.sample[chosen]]
    dead = answers < holds
    level = holds  # of the dead the voxel itself is cut, of the others the real one that virtual ones are made from
    needed = _needed_level(field, leaks, at, chosen)
    groups = []
    for is_dead in (False, True):
        for deep in np.unique(level[dead == is_dead]):
            mine = chosen[(dead == is_dead) & (level == deep)]
            cell = cells_at(field.octree, int(deep), at.positions[w.sample[mine]])
            voxel, number = np.unique(keys(cell), return_inverse=True)
            lit = _strongest(number, w.probe[mine], np.abs(leaks.pairs.light[mine]), len(voxel))
            finest = np.full(len(voxel), int(deep))
            np.maximum.at(finest, number, needed[(dead == is_dead) & (level == deep)])
            finest = np.minimum(np.maximum(finest, int(deep) + is_dead), deepest)
            leaking = at.positions[np.unique(w.sample[mine])]
            groups.append(Offenders(int(deep), cells(voxel), field.octree.positions[lit], leaking, finest, is_dead))
    return groups


def _needed_level(field: LightField, leaks: Leaks, at: Places, chosen: I64) -> I64:
    """Level (K,) that the walls at `chosen` pairs (K,) need; one below the voxel's own where there is no slab to go by."""
    grid = field.octree.grid
    need = walls_crossed(field.geometry, leaks.pairs, at, chosen).need
    with np.errstate(divide="ignore"):
        level = np.ceil(grid.level - np.log2(need / grid.finest) - HAIR)
    own = leaks.holds[leaks.pairs.weights.sample[chosen]]
    return np.where(np.isfinite(level), level, own + 1).astype(np.int64)


def _strongest(voxel: I64, probe: I64, light: F64, count: int) -> I64:
    """(count, MOST_LIT) probes that give most light within each voxel; the strongest again where there are fewer."""
    probes = int(probe.max()) + 1
    pair, back = np.unique(voxel * probes + probe, return_inverse=True)
    total = np.bincount(back, light, len(pair))
    order = np.lexsort((pair, -total, pair // probes))
    first = np.searchsorted(pair[order] // probes, np.arange(count))
    have = np.bincount(pair // probes, minlength=count)
    at = first[:, None] + np.where(np.arange(MOST_LIT) < have[:, None], np.arange(MOST_LIT), 0)
    return np.asarray(pair[order][at] % probes)
