"""Octree, virtual probes and validity under stress: D1 … D7 of the failure catalogue."""

from __future__ import annotations

from dataclasses import replace

from .case import Band, Case, Curve, at_least, at_most, within
from .kernel_curve import kernel_curve
from .late import late

SINGLE = 1e-5  # seam in float32: catalogue, "Seam"
HALF = 2e-3  # in half floats: the same
VISIBLE = 0.01


def _all_sides(n: float) -> bool:
    return n == 26.0


D1 = Case(
    id="D1",
    title="Which neighbours get virtual voxels",
    scene="256 voxels, one for each set of children, all probes valid",
    parameter="sides with virtual voxels",
    unit="",
    values=(0.0, 6.0, 18.0, 26.0),
    metric="largest seam (_sup) and share of border points with a jump over 1 % (_area), at faces, edges and corners",
    curves=(
        Curve(
            "ours_sup",
            at_most(SINGLE),
            "on all 26 sides both formulas agree exactly, but for float32 (D1)",
            where=_all_sides,
        ),
        Curve("ours_area", at_most(0.0), "exactly 0 (D1)", where=_all_sides),
        Curve(
            "fewer_sup",
            None,
            "none and 6 faces tear (D1); 18 do not here: whole tiles are filled",
            stated=lambda n: Band(VISIBLE) if n < 18 else Band(0.0, SINGLE),
            where=lambda n: not _all_sides(n),
        ),
        Curve(
            "fewer_area",
            None,
            "2.9 % without any, 6.8 % with 6 faces (D1)",
            stated=lambda n: Band(0.02, 0.3) if n < 18 else Band(0.0, 0.0),
            where=lambda n: not _all_sides(n),
        ),
        replace(kernel_curve(), where=_all_sides),
    ),
    measure=late("measure_tree", "neighbours"),
    whole=True,
    notes=(
        "The catalogue's 3.3 % with 18 sides belong to single voxels. Tiles of 2×2×2 voxels that meet in a point share one probe, "
        "which stands on the parent's lattice, so the 8 corner neighbours add nothing.",
        "Areas are larger than the catalogue's, because three quarters of the points lie on borders between levels.",
    ),
)

D2 = Case(
    id="D2",
    title="Level jumps, chains of virtual probes",
    scene="a branch of single voxels beside a voxel that many levels coarser",
    parameter="levels of the branch",
    unit="",
    values=(2.0, 3.0, 4.0, 6.0, 8.0, 10.0),
    metric="sup: largest seam; orphans: virtual texels without an earlier tile one level up; chain: links; refused: a tree with a gap",
    curves=(
        Curve("sup", at_most(SINGLE), "virtual voxels bring each level to its neighbours: no grading is needed (D2)"),
        Curve(
            "orphans",
            at_most(0.0),
            "each virtual probe's parent voxel is one level up, with 8 defined corners, coarse to fine (D2)",
        ),
        Curve(
            "chain",
            None,
            "so deep do virtual probes hang on virtual ones: nothing shorter would be a provocation",
            stated=lambda n: Band(n - 1.0, n),
        ),
        Curve("refused", at_least(1.0), "a tile without a parent, so also any cycle, is refused (D2)"),
        kernel_curve(),
    ),
    measure=late("measure_tree", "chains"),
    whole=True,
)

D3 = Case(
    id="D3",
    title="Light divided by its weight before it is stored",
    scene="a random octree of 6 levels",
    parameter="share of invalid probes",
    unit="",
    values=(0.0, 0.05, 0.15, 0.35, 0.6, 0.85),
    metric="largest seam (sup_), share of border points with a jump over 1 % (area_)",
    curves=(
        Curve("sup_ours", at_most(SINGLE), "premultiplied light and fractional weights: only rounding is left (D3)"),
        Curve("area_ours", at_most(0.0), "as sup_ours"),
        Curve(
            "sup_divided",
            None,
            "divided first: 41 % and more (D3)",
            stated=lambda p: Band(0.1 if p >= 0.05 else 0.0, 20.0 if p > 0.0 else SINGLE),
        ),
        Curve(
            "area_divided",
            None,
            "as sup_divided",
            stated=lambda p: Band(0.01 if p > 0.0 else 0.0, 1.0 if p > 0.0 else 0.0),
        ),
        kernel_curve(),
    ),
    measure=late("measure_tree", "premultiplied"),
)


def _lost(depth: float) -> Band:
    return Band(0.01 if depth >= 3.0 else 0.0, 0.25 if depth >= 3.0 else 0.0)


D4 = Case(
    id="D4",
    title="Weights of 8 bits",
    scene="virtual voxels that hang on each other, each with one corner that has any weight; and with one valid probe of eight",
    parameter="depth of the chain",
    unit="",
    values=(1.0, 2.0, 3.0, 4.0, 5.0),
    metric="seam_: 99th percentile; lost_: share of places that find no light at the level where exact weights find it",
    curves=(
        *(
            Curve(
                f"seam_{s}",
                at_most(HALF),
                "light is stored times the weight as it is rounded: 2e-3 in half floats (Seam)",
            )
            for s in ("half", "half16", "half8")
        ),
        Curve(
            "seam_bare8",
            None,
            "light times the exact weight: 0.39 % at 1/2, 23 % at depth 3 (D4)",
            stated=lambda d: Band(0.004 if d > 1.0 else 0.0, 0.3),
        ),
        Curve("lost_half", at_most(0.0), "a half float holds 8^-d exactly"),
        Curve("lost_half16", at_most(0.0), "65,535 steps reach under the smallest weight that is used, 1/1024"),
        Curve(
            "lost_half8",
            at_most(0.0),
            "8^-3 is 255/512 of a step, which rounds to nothing: 2 % of points lost (D4)",
            stated=_lost,
        ),
        kernel_curve(),
    ),
    measure=late("measure_tree", "weights"),
    whole=True,
    breaks="lost_half8",
    limit=0.005,
    notes=("Half-float weights are the product's default; half8 is the talk's layout.",),
)

D5 = Case(
    id="D5",
    title="All eight probes invalid",
    scene="a uniform grid of 32³ voxels with light 1",
    parameter="share of invalid probes",
    unit="",
    values=(0.0, 0.5, 0.7, 0.8, 0.9, 0.97, 1.0),
    metric="nan, off: answers not finite, largest error; fell, dark: shares of places not answered by the finest level, by none; "
    "each the worst of the plain sampler and the kernel",
    curves=(
        Curve("nan", at_most(0.0), "never 0/0"),
        Curve("off", at_most(1e-5), "what answers gives the light that its valid probes have"),
        Curve(
            "fell",
            None,
            "p^8 of the voxels have no valid corner (and places near an invalid one hardly any weight) and ask the level above [A]",
            stated=lambda p: Band(0.8 * p**8 - 2e-3, min(1.4 * p**8 + 4e-3, 1.0)),
        ),
        Curve(
            "dark",
            None,
            "only where the whole way up is invalid",
            stated=lambda p: Band(1.0, 1.0) if p == 1.0 else Band(0.0, 0.01 if p < 0.85 else 0.8),
        ),
    ),
    measure=late("measure_tree", "all_invalid"),
    breaks="fell",
    limit=0.1,
)

D6 = Case(
    id="D6",
    title="Copies into edges whose probes are invalid",
    scene="a sealed room beside a lit one, a block behind their wall; a sealed crack; a slot between blocks; a random tree",
    parameter="thickness of the wall, width of the slot",
    unit="m",
    values=(0.05, 0.1, 0.3),
    metric="leak_, crack_: light that copies bring into what is sealed; mended: share of the slot's dead edges lit; seam_: largest",
    curves=(
        Curve(
            "leak_ours",
            at_most(0.0),
            "barred where the way meets a surface, or the source does not see what the copy would light (D6)",
        ),
        Curve("crack_ours", at_most(0.0), "a lender must see the open space that its light would reach (D6)"),
        Curve(
            "crack_unbarred",
            None,
            "the way to a probe in the wall passes nothing, the light does",
            stated=at_least(0.1),
        ),
        Curve("leak_unbarred", None, "any neighbour may lend: light passes the wall", stated=at_least(0.1)),
        Curve(
            "mended",
            at_least(1.0),
            "the mouth of a slot narrower than a voxel is lit (D5, D6); space is looked for every 0.06 m of an edge: 0.05 is missed",
            stated=lambda w: Band(0.0, 1.0 if w <= 0.05 else 0.0),
        ),
        Curve("seam_ours", at_most(SINGLE), "copied before virtual probes are made, the same in every tile (D6)"),
        Curve(
            "seam_late",
            None,
            "virtual probes that were made before know nothing of the copies",
            stated=at_least(VISIBLE),
        ),
        Curve(
            "seam_apart",
            None,
            "tiles that choose for themselves disagree on the probes that they share",
            stated=at_least(VISIBLE),
        ),
    ),
    measure=late("measure_copies", "copies"),
    log=True,
    breaks="mended",
    limit=0.5,
)

D7 = Case(
    id="D7",
    title="Culling against parents that are culled themselves",
    scene="nested voxels, each new probe a small step brighter than what its parents interpolate",
    parameter="levels of probes that may be culled",
    unit="",
    values=(1.0, 2.0, 3.0, 4.0, 6.0, 8.0),
    metric="largest error at a culled probe, over what was allowed for each",
    curves=(
        Curve("ours", at_most(1.0), "compared with reconstructed parents, coarse levels first (D7)"),
        Curve(
            "plain",
            None,
            "compared with the parents that once were: the sum over levels (D7)",
            stated=lambda d: Band(0.85 * d, d),
        ),
        Curve("twin", at_most(1e-3), "what was judged is what the texture reads there"),
        Curve(
            "culled", within(0.25, 1.0), "refusing all would be no culling: what is left out is judged, not given up"
        ),
    ),
    measure=late("measure_chains", "chains"),
    whole=True,
    breaks="plain",
    limit=1.5,
)

CASES: tuple[Case, ...] = (D1, D2, D3, D4, D5, D6, D7)
