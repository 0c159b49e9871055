"""Probes that could be culled and all that would replace them, traced anew: what really happens, by rays that the bake never saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ...reference.datatypes import F64, I64
from ...reference.pipeline.culling import Setting
from ...reference.progress import silent
from ...reference.transport.form_factors import FormFactors, probe_form_factors

PROBES, RAYS = 300, 8192
SEED = 900


@dataclass(frozen=True, eq=False)
class Retraced:
    """chosen (n,): numbers of the probes; at (n,): where they are among the m that were traced; mix (n, m): of those, what would
    replace them. halves: two independent sets of rows (m, ·). seen (C,): light that the traced probes get from each column."""

    chosen: I64
    at: I64
    mix: sparse.csr_array
    halves: tuple[FormFactors, FormFactors]
    seen: F64

    def gathered(self, half: int, lightings: F64) -> F64:
        """Radiance SH (m, 4, l) of the traced probes under lightings (C, l)."""
        return np.stack([self.halves[half].matrix(k) @ lightings for k in range(4)], axis=1)

    def changed(self, gathered: F64) -> F64:
        """What culling takes from the light of `chosen`, (n, 4, l), of `gathered` (m, 4, l)."""
        mine = gathered[self.at]
        return mine - (self.mix @ gathered.reshape(len(gathered), -1)).reshape(mine.shape)

    def difference(self, half: int, coefficient: int) -> sparse.csr_array:
        """ΔF (n, C) of one coefficient: a probe's row less what would replace it."""
        rows = self.halves[half].matrix(coefficient).astype(np.float64)
        return (rows[self.at] - self.mix @ rows).tocsr()


def some_able(s: Setting, seed: int, most: int = PROBES) -> I64:
    """Numbers of at most `most` probes that could be culled."""
    able = np.flatnonzero(s.able)
    return np.sort(np.random.default_rng([seed, 67]).choice(able, min(most, len(able)), replace=False))


def retrace(s: Setting, seed: int, rays: int = RAYS, most: int = PROBES) -> Retraced:
    """Trace at most `most` probes that could be culled, and their parents, `rays` each, twice."""
    chosen = some_able(s, seed, most)
    mix = s.parents[chosen]
    needed = np.unique(np.concatenate([chosen, mix.indices]))
    positions = s.probes.octree.positions[needed]
    a, b = (
        probe_form_factors(s.surfaces.geometry, s.surfaces.patches, positions, rays, seed + SEED + h, silent)
        for h in (0, 1)
    )
    seen = np.maximum(np.asarray(a.matrix(0).sum(axis=0) + b.matrix(0).sum(axis=0), dtype=np.float64).ravel(), 0.0)
    seen[-1] = 0.0  # what ends inside something carries no light
    return Retraced(chosen, np.searchsorted(needed, chosen), mix[:, needed].tocsr(), (a, b), seen)
