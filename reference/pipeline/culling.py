"""The end of the probe half: real probes that the others can stand in for become virtual, and their rows are freed.

No truth is needed: light gathered by rays straight from the patches is the reference, at points of this module's own choosing,
under lightings that it draws itself. Seeds differ from all that results are measured with.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import sparse

from ..clock import Clock
from ..datatypes import F64, I64, Bool, Scene
from ..errors import InputError
from ..lattice import Octree
from ..placement.clusters import cluster_columns
from ..placement.culling import Candidates, choose, interleaved
from ..placement.judge import Judge, Stage, stacked
from ..placement.lightings import draw_lightings
from ..placement.norms import NORMS, Norm
from ..placement.parents import find_parents
from ..progress import Progress, silent
from ..sh import COEFFICIENTS, irradiance_weights, order_of
from ..sky import SKY_BINS
from ..transport.form_factors import FormFactors, point_form_factors
from ..transport.gather import upload
from ..truth.points import Points, choose_points
from ..volume.indirection import build_indirection
from ..volume.layout import build_layout
from ..volume.linear import read, texel_matrix
from .probes import Culled, Probes, lifted, trace_probes, virtual_texture
from .surfaces import Surfaces

POINTS = 16000  # of the cameras, half as many on surfaces and in volumes: where probes are read
JUDGED = 5000  # so many of them gather light by rays of their own for each of two judges
RAYS = 128  # of such a point, twice: more points tell more of single patches than more rays of each
PER_FAMILY = 16
UNREAD = 0.03  # of the mean of those that are read: what a probe counts for that no point happened to read
SEED = 7000


def bake_probes(scene: Scene, surfaces: Surfaces, octree: Octree, seed: int, progress: Progress = silent) -> Probes:
    """Form factors and validity of the real probes, and the virtual texture's layout; culled where the scene asks for it.

    Raises InputError if every probe is invalid: the volume would be black.
    """
    return cull_probes(scene, surfaces, trace_probes(scene, surfaces, octree, seed, progress), seed, progress)


def cull_probes(
    scene: Scene, surfaces: Surfaces, probes: Probes, seed: int, progress: Progress = silent, norm: Norm = NORMS["relative"]
) -> Probes:  # fmt: skip
    """The same probes less those that may become virtual at placement.cull_error; all of them where that is not set, or where no
    point is lit by probes."""
    target = scene.settings.placement.cull_error
    points = None if target is None else training_points(scene, surfaces, seed + SEED)
    if target is None or points is None:
        return probes
    clock = Clock()
    progress("culling", 0, 1)
    s = setting(scene, surfaces, probes, points, seed)
    choice = choose(candidates(s, norm), s.judge, lambda: s.check, target)
    found = without(probes, choice.culled)
    clock.lap("culling")
    culled = Culled(
        probes=int(choice.culled.sum()),
        able=int(s.able.sum()),
        by_level=np.bincount(probes.octree.corner_level[choice.culled], minlength=probes.octree.grid.level + 1),
        norm=norm.name,
        threshold=choice.threshold,
        odds_over=choice.verdict.over,
        raise_lightings=choice.verdict.worst,
        raise_expected=choice.verdict.own,
        bytes=probes.rows.bytes - found.rows.bytes,
    )
    progress("culling", 1, 1)
    return dataclasses.replace(found, culled=culled, seconds={**probes.seconds, **clock.seconds})


@dataclass(frozen=True, eq=False)
class Setting:
    """All that a choice rests on. able (R,) bool: probes with eight valid parents that nobody copies; parents (R, R): what would
    replace them; reading (R,): what the points read of each, in the mean; cluster (C,) of the columns; judge: of replacements, who
    chooses; make_check: makes `check`."""

    surfaces: Surfaces
    probes: Probes
    able: Bool
    parents: sparse.csr_array
    reading: F64
    cluster: I64
    judge: Judge
    make_check: Callable[[], Judge]

    @cached_property
    def check(self) -> Judge:
        """Another judge, at other points, who has no part in the choice; traced when first asked for."""
        return self.make_check()


def setting(scene: Scene, surfaces: Surfaces, probes: Probes, points: Points, seed: int) -> Setting:
    """Parents of probes, what `points` read, and a judge at some of them."""
    own = np.where(probes.valid, probes.light_from, -1).astype(np.int32)
    tree, layout = probes.octree, probes.layout
    parents = find_parents(tree, layout.parents, texel_matrix(layout, own), probes.valid)
    able = parents.able.copy()
    able[probes.light_from[(probes.light_from >= 0) & ~probes.valid]] = False  # others use their light
    texture = virtual_texture(probes, np.zeros((0, 27, 13), dtype=np.float32))
    reading = read(texture, texel_matrix(layout, probes.light_from), lifted(scene, texture, points)).weights
    patches = surfaces.patches
    cluster = cluster_columns(patches.centroid, patches.normal, SKY_BINS)
    # What no point reads seems to do no harm: so those that choose are not those that judge.
    mixed = np.random.default_rng([seed, 59]).permutation(len(points.positions))
    most = min(JUDGED, len(mixed) // 3)
    judging, checking, choosing = (np.sort(part) for part in np.split(mixed, (most, 2 * most)))
    of_probe = np.asarray(reading[choosing].sum(axis=0)).ravel() / max(len(choosing), 1)
    of_probe += UNREAD * of_probe.sum() / max(int((of_probe > 0.0).sum()), 1)
    factors = stacked(probes.rows.values, probes.rows.indptr, probes.rows.columns, len(cluster))

    def judge(at: I64, own_seed: int) -> Judge:
        return Judge(_stage(surfaces, points.part(at), reading[at].tocsr(), factors, cluster, own_seed))

    first = judge(judging, seed + SEED)
    return Setting(
        surfaces, probes, able, parents.weights, of_probe, cluster, first, partial(judge, checking, seed + 2 * SEED)
    )


def _stage(
    surfaces: Surfaces, points: Points, reading: sparse.csr_array, factors: sparse.csr_array, cluster: I64, seed: int
) -> Stage:
    """Two halves of the points' own rays, and lightings of the columns that they see."""
    halves = [
        point_form_factors(
            surfaces.geometry, surfaces.patches, points.positions, points.normals, RAYS, s, silent
        ).matrix()
        for s in (seed + 1, seed + 2)
    ]
    seen = np.asarray(halves[0].sum(axis=0) + halves[1].sum(axis=0)).ravel()
    seen[-1] = 0.0  # what ends inside something carries no light
    lightings = draw_lightings(seen, PER_FAMILY, seed)[:, : 3 * PER_FAMILY]  # single patches are all judged, one by one
    return Stage(
        reading,
        irradiance_weights(points.normals, order_of(factors.shape[0] // reading.shape[1])),
        factors,
        (halves[0], halves[1]),
        lightings,
        surfaces.guess,
        cluster,
    )


def candidates(s: Setting, norm: Norm) -> Candidates:
    """Rows as the norm wants them: single columns, weighted by the errors that are there already, or clusters.

    Of SH of order 2 only the linear part says in which order probes are tried; the judge, who says how far, reads all of it.
    """
    rows, tree = s.probes.rows, s.probes.octree
    values, se = rows.values[:, :COEFFICIENTS], rows.se[:, :COEFFICIENTS]
    variance = None
    if norm.columns == "clusters":
        cluster, weights = s.cluster, np.bincount(s.cluster, s.surfaces.guess) / np.bincount(s.cluster)
    else:
        cluster = np.arange(len(s.cluster))
        odds = np.where(np.isfinite(s.judge.square), np.sqrt(s.judge.seen), 0.0)
        weights = odds / max(odds.sum(), np.finfo(np.float64).tiny) / s.judge.square
    count, columns = int(cluster.max()) + 1, cluster[rows.columns]
    entries = interleaved(values, rows.indptr, columns, count)
    if norm.columns == "clusters":
        variance = interleaved(se**2, rows.indptr, columns, count)
    return Candidates(tree.corner_level, s.able, s.parents, norm, entries, variance, weights, s.reading)


def training_points(scene: Scene, surfaces: Surfaces, seed: int) -> Points | None:
    """Points like those that results are measured at: of cameras, surfaces and volumes, mixed; None where there are none."""
    try:
        sets = choose_points(scene, surfaces.geometry, POINTS, seed)
    except InputError:  # a camera that cannot be used: whoever looks through it will say so
        without = scene.settings.model_copy(update={"cameras": {}})
        sets = choose_points(dataclasses.replace(scene, settings=without), surfaces.geometry, POINTS, seed)
    if not sets:
        return None
    return Points(*(np.concatenate([getattr(p, f) for p in sets.values()]) for f in ("positions", "normals", "mesh")))


def without(probes: Probes, culled: Bool) -> Probes:
    """The probes less the culled ones: their rows are freed, voxels stay, and the layout makes their texels virtual."""
    stay = ~culled
    number = np.where(stay, np.cumsum(stay) - 1, -1).astype(np.int32)
    source = probes.light_from[stay]
    tree = dataclasses.replace(
        probes.octree, corners=probes.octree.corners[stay], corner_level=probes.octree.corner_level[stay]
    )
    rows = _kept_rows(probes.rows, np.flatnonzero(stay))
    layout = build_layout(tree)
    return dataclasses.replace(
        probes,
        octree=tree,
        rows=rows,
        device_rows=upload(rows),
        valid=probes.valid[stay],
        light_from=np.where(source >= 0, number[source], -1).astype(np.int32),
        layout=layout,
        indirection=build_indirection(layout),
    )


def _kept_rows(rows: FormFactors, stay: I64) -> FormFactors:
    """Rows `stay` (n,), in this order, in memory of their own."""
    lengths = np.diff(rows.indptr)[stay]
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    at = np.repeat(rows.indptr[stay] - indptr[:-1], lengths) + np.arange(indptr[-1])
    return dataclasses.replace(
        rows,
        indptr=indptr,
        columns=rows.columns[at],
        values=rows.values[at],
        se=rows.se[at],
        back_share=rows.back_share[stay],
        rays=rows.rays[stay],
    )
