"""Culling by form factors: what goes, what it does to light that was never seen, and whether its prediction is worth anything.

culled_share_SCENE         valid probes that the product itself culls at cull_error = 0.02, over all valid ones: mean over the scene's
                           own lattice and LATTICES random ones, on which it hangs; 0 where on the own one the fresh raise is over
                           0.02 in any of five sets of lightings
culled_raise_SCENE         largest raise of the error at fresh points under any of 40 fresh lightings, in the worst of five sets of 40
culled_patches_over_SCENE  share of single patches, each as likely as the other, that alone would raise it by more than 0.02
cull_s_house               seconds of the culling of house
culled_rank_correlation    Spearman, predicted against realised by other rays; median over scenes × families of lightings
culled_coverage, culled_overshoot   P(r ≤ p) and the 99th percentile of r/p, p as a share of the probe's own row; the same median
culled_bound_holds         share of probes × lightings where the change, by fresh rays, is within the ‖ΔF‖₁ B_max of the bake's own rows
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...reference import pipeline
from ...reference.datatypes import Scene
from ...reference.lattice import Octree
from ...reference.pipeline.culling import setting, training_points
from ...reference.placement.norms import NORMS
from ...reference.progress import Progress
from ...reference.variant import ensure_variant
from ..chart import with_placement
from ..culling.bounds import Bound, bound
from ..culling.fresh import PER_FAMILY, SETS, SINGLE, Fresh, fresh_raises
from ..culling.honesty import Honest, honesty
from ..culling.retraced import retrace
from ..efficiency.placements import adaptive, random_shifts
from .places import bundled
from .rows import Group, Row, Wanted, row_of

TARGETS = {"cornell": 0.10, "house": 0.20, "valley": 0.25}
CULL_ERROR = 0.02
USED = "relative"  # the norm that the product culls by
SEED, REPEATS = 0, 3
LATTICES = 5
OF_SCENES = tuple(
    f"{row}_{name}" for name in TARGETS for row in ("culled_share", "culled_raise", "culled_patches_over")
)
OF_NORMS = ("culled_rank_correlation", "culled_coverage", "culled_overshoot", "culled_bound_holds")
NAMES = (*OF_SCENES, "cull_s_house", *OF_NORMS)


@dataclass(frozen=True, eq=False)
class Case:
    """A scene before and after culling."""

    scene: Scene
    surfaces: pipeline.Surfaces
    before: pipeline.Probes
    after: pipeline.Probes

    @property
    def share(self) -> float:
        """Culled probes over valid ones."""
        assert self.after.culled is not None
        return self.after.culled.probes / int(self.before.valid.sum())


def culled_case(name: str, seed: int = SEED) -> Case:
    """A bundled scene with its own settings, but for cull_error."""
    ensure_variant()
    scene = with_placement(bundled(name), cull_error=CULL_ERROR)
    surfaces = pipeline.bake_surfaces(scene, seed)
    return _culled(scene, surfaces, pipeline.place(scene, surfaces, seed), seed)


def elsewhere(case: Case) -> list[float]:
    """Shares with the lattice at LATTICES random places."""
    shifts = random_shifts(case.scene, case.surfaces, LATTICES, SEED)
    return [_culled(case.scene, case.surfaces, adaptive(case.scene, case.surfaces, s), SEED).share for s in shifts]


def _culled(scene: Scene, surfaces: pipeline.Surfaces, tree: Octree, seed: int) -> Case:
    before = pipeline.trace_probes(scene, surfaces, tree, seed)
    return Case(scene, surfaces, before, pipeline.cull_probes(scene, surfaces, before, seed))


def scene_rows(name: str, case: Case, fresh: Fresh, others: list[float]) -> Iterator[Row]:
    """Share, raise, and single patches of one scene. others: shares on other lattices, none where nobody asked."""
    culled, worst = case.after.culled, fresh.worst
    assert culled is not None
    kept = worst <= CULL_ERROR
    families = ", ".join(f"{family} {value:.2%}" for family, value in fresh.by_family().items())
    note = (
        f"own lattice: {culled.probes} of {int(case.before.valid.sum())} valid probes, {culled.able} have eight valid parents; "
        f"{culled.bytes >> 10} KiB freed of {case.before.rows.bytes >> 10}; {int(kept.sum())} of {SETS} sets of "
        f"{4 * PER_FAMILY} lightings stay within {CULL_ERROR}; other lattices: {', '.join(f'{share:.1%}' for share in others)}"
    )
    shares = np.array([case.share, *others]) if kept.all() else np.zeros(1)
    se = float(shares.std(ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else 0.0
    yield Row(f"culled_share_{name}", float(shares.mean()), "share", TARGETS[name], "higher", se, len(shares), note)
    said = f"{fresh.points} points; largest of all {SETS} sets: {families}"
    few = f"{min(SINGLE, fresh.points)} points: part of it is their noise, which alone takes some patches over"
    sets = ", ".join(f"{value:.2%} ± {se:.2%}" for value, se in zip(worst, fresh.worst_se, strict=True))
    spread = float(np.subtract(*np.percentile(worst, (75.0, 25.0)))) / 2.0
    yield Row(
        f"culled_raise_{name}",
        float(worst.max()),
        "share",
        CULL_ERROR,
        "lower",
        spread,
        SETS,
        f"{said}; by set: {sets}",
    )
    yield row_of(f"culled_patches_over_{name}", fresh.patches_over, "share", "lower", note=few)


def seconds(case: Case) -> Iterator[Row]:
    """How long the culling of a case takes, warm."""
    taken = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        pipeline.cull_probes(case.scene, case.surfaces, case.before, SEED)
        taken.append(time.perf_counter() - begin)
    yield row_of("cull_s_house", taken, "s", "lower", 3.0, f"{len(case.before.valid)} probes")


def norm_rows(found: list[Honest], bounds: list[Bound]) -> Iterator[Row]:
    """How well norms predict, over all scenes."""
    mine = [h for h in found if h.norm == USED]
    ranks = {name: [h.rank for h in found if h.norm == name] for name in NORMS}
    every = "; ".join(f"{name} {np.median(r):.2f} ({min(r):.2f} to {max(r):.2f})" for name, r in ranks.items())
    families = "; ".join(
        f"{family} {np.median([h.rank for h in mine if h.family == family]):.2f}" for family in dict.fromkeys(h.family for h in mine)
    )  # fmt: skip
    note = f"median over scenes and families, worst and best of them: {every}; {USED} by family: {families}"
    yield row_of("culled_rank_correlation", [h.rank for h in mine], "rank", "higher", 0.5, note)
    yield row_of("culled_coverage", [h.coverage for h in mine], "share", "higher", note=_each(mine, "coverage"))
    yield row_of("culled_overshoot", [h.overshoot for h in mine], "ratio", "lower", note=_each(mine, "overshoot"))
    lightings = min(b.lightings for b in bounds)
    closest, noise = max(b.closest for b in bounds), max(b.noise for b in bounds)
    said = (
        f"{lightings} lightings a scene or more; by fresh rays the nearest comes to {closest:.2f} of the bake's bound; their noise, "
        f"which is not subtracted, is {noise:.3f} of it"
    )
    yield row_of("culled_bound_holds", min(b.held for b in bounds), "share", "higher", 1.0, said)


def _each(found: list[Honest], what: str) -> str:
    families = dict.fromkeys(h.family for h in found)
    return "; ".join(f"{f} {np.median([getattr(h, what) for h in found if h.family == f]):.3g}" for f in families)


def culling(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """The rows asked for; scenes none of them needs are not baked."""
    norms = wanted & set(OF_NORMS)
    found: list[Honest] = []
    bounds: list[Bound] = []
    for number, name in enumerate(TARGETS):
        progress("culling", number, len(TARGETS))
        of_scene = wanted & {row for row in OF_SCENES if row.endswith(name)}
        timed = name == "house" and "cull_s_house" in wanted
        if not (norms or of_scene or timed):
            continue
        case = culled_case(name)
        if of_scene:
            fresh = fresh_raises(case.scene, case.surfaces, case.before, case.after, CULL_ERROR, SEED)
            yield from scene_rows(name, case, fresh, elsewhere(case) if f"culled_share_{name}" in wanted else [])
        if timed:
            yield from seconds(case)
        if norms:
            points = training_points(case.scene, case.surfaces, SEED)
            assert points is not None
            judged = setting(case.scene, case.surfaces, case.before, points, SEED)
            fresh_rows = retrace(judged, SEED)
            found += honesty(judged, fresh_rows, SEED)
            bounds.append(bound(judged, fresh_rows, SEED))
    progress("culling", len(TARGETS), len(TARGETS))
    if norms:
        yield from norm_rows(found, bounds)


GROUPS = (Group(NAMES, culling),)
