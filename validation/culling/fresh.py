"""How much culling raises the error at points and under lightings that it has never seen.

The error is against light gathered by the points' own rays straight from the patches, so that only probes are judged. Samples are
taken of the two virtual textures, before and after, each with its own layout, through its matrix form (`volume.linear`).

A single lit patch is the business of the few points around it, so the raise under it is known no better than they are many: with 4,000
points and 2 × 1,024 rays of each, one patch in `cornell` read +9.0 %, with 16,000 others -2.2 %. So many points with few rays each
are taken instead, for the same number of rays, and every raise has its standard error, from blocks of points left out one at a time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ...reference import pipeline
from ...reference.datatypes import F64, Bool, Scene
from ...reference.placement.judge import raised
from ...reference.placement.lightings import FAMILIES, draw_lightings, noticed
from ...reference.progress import silent
from ...reference.sh import irradiance_weights
from ...reference.transport.form_factors import FormFactors, point_form_factors
from ...reference.truth.points import Points, choose_points
from ...reference.volume.linear import Reading, read, texel_matrix
from ..statistics.jackknife import mixed_blocks, se_of_rest

PER_FAMILY = 10
SETS = 5
POINTS, RAYS = 16000, 128  # of the cameras, half as many on surfaces and in volumes; rays of each, twice
SINGLE = 4000  # of these, at most, at which all single patches are lit, one by one
SEED = 500


@dataclass(frozen=True, eq=False)
class Fresh:
    """raises, se (SETS, 4, PER_FAMILY): relative growth of the root mean square error under each lighting of each family, and its
    standard error. patches_over: share of single patches under which it is over `target`, at SINGLE points, so with more chance in it.
    points: how many."""

    raises: F64
    se: F64
    patches_over: float
    points: int

    @property
    def worst(self) -> F64:
        """Largest raise of each set of lightings, (SETS,)."""
        return self.raises.max(axis=(1, 2))

    @property
    def worst_se(self) -> F64:
        """Standard error of each set's largest raise, (SETS,)."""
        at = self.raises.reshape(SETS, -1).argmax(axis=1)
        return np.take_along_axis(self.se.reshape(SETS, -1), at[:, None], axis=1)[:, 0]

    def by_family(self) -> Mapping[str, float]:
        """Largest raise of all sets, by family."""
        return dict(zip(FAMILIES, self.raises.max(axis=(0, 2)).tolist(), strict=True))


def fresh_raises(
    scene: Scene, surfaces: pipeline.Surfaces, before: pipeline.Probes, after: pipeline.Probes, target: float, seed: int,
    count: int = POINTS, rays: int = RAYS,
) -> Fresh:  # fmt: skip
    """Compare the same probes before and after culling at `count` points of the cameras and as many others."""
    sets = choose_points(scene, surfaces.geometry, count, seed + SEED)
    points = Points(*(np.concatenate([getattr(p, f) for p in sets.values()]) for f in ("positions", "normals", "mesh")))
    g, patches = surfaces.geometry, surfaces.patches
    halves = [
        point_form_factors(g, patches, points.positions, points.normals, rays, seed + SEED + half, silent).matrix()
        for half in (1, 2)
    ]
    seen = np.asarray(halves[0].sum(axis=0) + halves[1].sum(axis=0)).ravel()
    seen[-1] = 0.0
    drawn = np.concatenate([draw_lightings(seen, PER_FAMILY, seed + SEED + s) for s in range(SETS)], axis=1)
    normals = irradiance_weights(points.normals)
    both = [(_reading(scene, p, points), p.rows) for p in (before, after)]
    squares = [_squares(r, rows, normals, halves, drawn) for r, rows in both]

    def grown(keep: slice | Bool) -> F64:
        old, new = (s[keep].mean(axis=0) for s in squares)
        return raised(new / old - 1.0).reshape(SETS, len(FAMILIES), PER_FAMILY)

    raises = grown(slice(None))
    se = se_of_rest([grown(np.arange(len(squares[0])) != block) for block in range(len(squares[0]))])
    some = np.sort(np.random.default_rng([seed, 73]).permutation(len(normals))[:SINGLE])
    fewer = [half[some] for half in halves]
    single = [
        _single_squares(dataclasses.replace(r, weights=r.weights[some]), rows, normals[some], fewer) for r, rows in both
    ]
    shown = noticed(seen) & (single[0] > 0.0)
    over = raised(single[1][shown] / single[0][shown] - 1.0) > target
    return Fresh(raises, se, float(over.mean()), len(points.positions))


def _reading(scene: Scene, probes: pipeline.Probes, points: Points) -> Reading:
    texture = pipeline.virtual_texture(probes, np.zeros((0, 27, 13), dtype=np.float32))
    return read(texture, texel_matrix(probes.layout, probes.light_from), pipeline.lifted(scene, texture, points))


def _squares(reading: Reading, rows: FormFactors, normals: F64, halves: list[sparse.csr_array], lightings: F64) -> F64:
    """Mean squared errors (blocks of points, m) under lightings (C, m); the noise of the two halves of the reference cancels."""
    coefficients = np.stack([rows.matrix(k) @ lightings for k in range(4)], axis=1)
    ours = reading.irradiance(normals, coefficients)
    products = (ours - halves[0] @ lightings) * (ours - halves[1] @ lightings)
    block = mixed_blocks(len(products))
    return np.stack([products[block == b].mean(axis=0) for b in range(int(block.max()) + 1)])


def _single_squares(reading: Reading, rows: FormFactors, normals: F64, halves: list[sparse.csr_array]) -> F64:
    """The same (C,) with one column after the other lit."""
    parts = [sparse.diags_array(normals[:, k]) @ (reading.weights @ rows.matrix(k)) for k in range(4)]
    ours = (parts[0] + parts[1] + parts[2] + parts[3]).tocsr()
    differences = [(ours - half).tocsr() for half in halves]
    return np.asarray((differences[0].multiply(differences[1])).mean(axis=0)).ravel()
