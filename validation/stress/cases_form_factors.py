"""A1 to A11 of the failure catalogue: form factors. What is measured is in measure_rays, measure_small, measure_factors and
measure_meshes."""

from __future__ import annotations

import math
from collections.abc import Callable

from .case import Band, Case, Curve, at_least, at_most, within
from .late import late

LIFT_M = 2e-6  # of the unit box: where rays begin, in the 2 m scene of A2 in metres
SINGLE = 1.5e-8  # m: spacing of single precision at the sheet of A9, in its scene
A6_RATIOS = {0.1: 38.49, 0.3: 6.103, 1.0: 1.593, 5.0: 1.0265}  # (A / π r²) over Howell C-11


def _hides_under(gap: float) -> Callable[[float], Band]:
    """What a lifted ray sees through a gap: all where it begins beyond, nothing where it does not."""
    return lambda value: Band(0.0, 1.0) if value < gap else Band(0.0, 0.0)


def _ratio_of(gap: float) -> Band:
    """The catalogue's ratio, to half a per cent."""
    wanted = A6_RATIOS[gap]
    return Band(0.995 * wanted, 1.005 * wanted)


CLOSED_EDGES = Case(
    id="A1",
    title="rays slip through closed edges",
    scene="a closed box of 0.2 m, faces cut 1, 4 and 13 times, further and further from the origin",
    parameter="offset of the box",
    unit="m",
    values=(1.0, 1e2, 1e4, 1e5, 1e6, 1e7),
    metric="share of rays from within that leave",
    curves=(
        Curve("ours", at_most(0.0), "robust Embree in a unit box: a closed box lets nothing out (catalogue A1)"),
        Curve(
            "Mitsuba's default",
            None,
            "Embree without robust intersections, where the box stands: edges part as single precision does",
            stated=lambda offset: at_least(1e-3)(offset) if offset >= 1e4 else Band(0.0, 1e-2),
        ),
    ),
    measure=late("measure_rays", "closed_edges"),
    log=True,
    notes=(
        "vertices are double precision here; a file in single precision has moved them by up to half a spacing, 0.5 m at 1e7 m",
    ),
)

THIN_GAP = Case(
    id="A2",
    title="rays begin beyond what is close above a surface",
    scene="an opaque lid close over a floor of 2 m, shut at its rim, under a sky",
    parameter="gap",
    unit="m",
    values=(1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2),
    metric="irradiance under the lid, of that beside it",
    curves=(
        Curve(
            "ours",
            at_most(0.0),
            f"rays begin {LIFT_M:g} of half the scene's extent off their surface: what is nearer does not stop them",
            stated=_hides_under(2.0 * LIFT_M),
        ),
        Curve(
            "Mitsuba's irradiance meter",
            None,
            "its rays begin 8.9e-5 (1 + max |p|) off the surface (design, section 4)",
            stated=lambda gap: Band(0.5, 1.01) if gap <= 5e-5 else Band(0.0, 0.0) if gap >= 5e-4 else Band(0.0, 1.01),
        ),
    ),
    measure=late("measure_rays", "thin_gap"),
    log=True,
    breaks="ours",
    limit=0.01,
)

CLOSURE = Case(
    id="A3",
    title="rows that do not sum to one, amplified by bounces",
    scene="furnaces B = M / (1 - ρ): a box and a ball",
    parameter="albedo",
    unit="",
    values=(0.5, 0.8, 0.9, 0.95, 0.98),
    metric="worst relative error of the radiosity; the last two: ratio to a formula, largest |row sum - 1| over its limit",
    curves=(
        Curve("ours", at_most(1e-4), "closed rows give the furnace's answer to the solver's tolerance, whatever their noise"),
        Curve(
            "averaged, not closed",
            None,
            "both ways of a pair averaged, without closing: the defect of rows is amplified by ρ / (1 - ρ)",
            stated=at_least(1e-3),
        ),
        Curve(
            "one per cent too much, over the formula",
            within(0.99, 1.01),
            "a defect δ becomes δ ρ / (1 - (1 + δ) ρ): 9.9 % of 1 % at ρ = 0.9 (catalogue A3)",
            where=lambda albedo: 1.01 * albedo < 0.998,
        ),
        Curve("closure, of its limit", at_most(1.0), "max |ΣF - 1| <= τ (1 - ρ) / ρ keeps the error under τ, here 0.001"),
    ),
    measure=late("measure_factors", "closure"),
)  # fmt: skip

RECIPROCITY = Case(
    id="A4",
    title="A_i F_ij and A_j F_ji differ",
    scene="a room with a small two-sided plate in it, areas 1 : r",
    parameter="ratio of areas",
    unit="",
    values=(1.0, 1e1, 1e2, 1e3, 1e4),
    metric="Σ |A_i F_ij - A_j F_ji|, over what standard errors let expect; and over Σ A_i F_ij",
    curves=(
        Curve("rays, over their noise", within(0.3, 3.0), "two estimates of one flow differ by their noise (catalogue A4: 3σ)"),
        Curve("reconciled", at_most(1e-6), "both ways of a pair hold one flow, to the rounding of single precision"),
        Curve("rays", None, "what is left without it, of all flow", stated=at_least(1e-4)),
    ),
    measure=late("measure_factors", "reciprocity"),
    log=True,
)  # fmt: skip

COMMON_EDGE = Case(
    id="A5",
    title="patches with a common edge",
    scene="the faces of a cube: 0.200044 to those beside, 0.199825 to the one opposite",
    parameter="rays",
    unit="",
    values=(2.0**8, 2.0**10, 2.0**12, 2.0**14, 2.0**16),
    metric="error of F beside, rms over seeds, of √(F (1 - F) / N); relative error; |row sum - 1|",
    curves=(
        Curve("cosine rays (ours)", at_most(1.1), "a cosine ray weighs 0 or 1: at most the binomial error, stratified ones less"),
        Curve(
            "points by area",
            None,
            "the kernel's square is not integrable at a common edge: the error per sample grows with their number",
            stated=at_least(1.1),
        ),
        Curve("closed form (ours)", at_most(1e-9), "Schröder and Hanrahan's contour integral is exact"),
        Curve("row sums (ours)", at_most(1e-4), "every ray is counted once, and in a cube ends on a face (see the note)"),
    ),
    measure=late("measure_factors", "common_edge"),
    log=True,
    whole=True,
    notes=(
        "one ray in 16 million begins on the edge itself, in the plane of the wall beside, and meets its black back",
    ),
)  # fmt: skip

NEAR_FIELD = Case(
    id="A6",
    title="point-to-patch formulas near by",
    scene="facing unit squares",
    parameter="distance",
    unit="m",
    values=(0.1, 0.3, 1.0, 5.0),
    metric="form factor, of Howell C-11",
    curves=(
        Curve("closed form (ours)", within(1.0 - 1e-9, 1.0 + 1e-9), "contour integral over both squares"),
        Curve("rays (ours)", within(0.97, 1.03), "rays know no distance"),
        Curve("a lamp's direct light (ours)", within(0.97, 1.03), "patches that a lamp is near to gather it through form factors"),
        Curve("A / π r²", None, "wrong by 38, 1.59 and 1.03 at 0.1, 1 and 5 m (catalogue A6)", stated=_ratio_of),
    ),
    measure=late("measure_factors", "near_field"),
    log=True,
)  # fmt: skip

ALIASING = Case(
    id="A7",
    title="regular directions over a regular grid of patches",
    scene="64 receivers, each 1 m over the middle of a cell of a grid of 1 m",
    parameter="rays",
    unit="",
    values=(2.0**8, 2.0**10, 2.0**12),
    metric="rms error of the mean over receivers, of that of one",
    curves=(
        Curve("ours", at_most(0.2), "every receiver has rays of its own: the mean of 64 errs 1/8 as much as one"),
        Curve("one regular pattern", None, "all see the grid alike, so all err alike, as hemicubes do", stated=at_least(0.9)),
    ),
    measure=late("measure_rays", "regular_directions"),
    log=True,
    whole=True,
)  # fmt: skip

SMALL = Case(
    id="A8",
    title="noise of small form factors",
    scene="a square over a point, 4,096 rays",
    parameter="form factor",
    unit="",
    values=(1e-4, 1e-3, 1e-2, 0.1, 0.5, 0.9),
    metric="rms error over receivers, of √(F (1 - F) / N); reported error of real; relative error",
    curves=(
        Curve(
            "ours, of binomial",
            at_most(1.1),
            "stratified rays never err more than independent ones, √((1 - F) / (F N))",
        ),
        Curve("reported standard error, of real", within(0.8, 1.25), "the spread of 8 randomisations is the error"),
        Curve(
            "independent rays",
            None,
            "√((1 - F) / (F N)): 49 % at F = 0.001 with 4,096 rays (catalogue A8)",
            stated=lambda f: Band(0.75 * math.sqrt((1.0 - f) / (4096 * f)), 1.25 * math.sqrt((1.0 - f) / (4096 * f))),
        ),
    ),
    measure=late("measure_small", "small_form_factor"),
    log=True,
)

THIN_SHEET = Case(
    id="A9",
    title="one-sided and doubled sheets",
    scene="a sheet of two quads back to back between a lamp and a black floor, and a single one lit from behind",
    parameter="gap between the two",
    unit="m",
    values=(1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2),
    metric="share of rays that meet the wrong quad; light on the dark side; light lost at the back",
    curves=(
        Curve(
            "flips",
            at_most(0.0),
            "two quads nearer than the spacing of single precision are one place, and either may be met first",
            stated=lambda gap: Band(0.0, 1.0) if gap < 4.0 * SINGLE else Band(0.0, 0.0),
        ),
        Curve("dark side", at_most(0.0), "nothing passes a sheet whose rays begin on the outside of both quads"),
        Curve("lost at the back, tagged", at_most(0.02), "two_sided = true: the back reflects ρ F of the lamp (Howell C-11)"),
        Curve("lost at the back, not tagged", None, "a one-sided back is black: all of it is lost", stated=within(1.0, 1.0)),
    ),
    measure=late("measure_meshes", "thin_sheet"),
    log=True,
    breaks="flips",
    limit=1e-3,
)  # fmt: skip

BAD_MESH = Case(
    id="A10",
    title="bad meshes: duplicate, flipped, sliver, T-junction, non-manifold",
    scene="a closed ball of 1,280 faces, some of them bad",
    parameter="bad faces",
    unit="",
    values=(1.0, 4.0, 16.0, 64.0),
    metric="share of light that ends on no front; kinds of fault of which nothing is said though they lose light",
    curves=(
        Curve("duplicate", at_most(0.0), "removed by the loader"),
        Curve("flipped", at_most(0.0), "turned by the loader: winding is checked as well as watertightness"),
        Curve("sliver", at_most(0.0), "slivers down to 1 : 10^7, removed or kept, leave no gap"),
        Curve("T-junction", at_most(0.0), "robust rays do not pass an edge that another vertex lies on"),
        Curve("fin", lambda n: Band(0.0, 1e-3 * n), "a fin's back is black, in the truth too: it is kept, and said"),
        Curve(
            "flipped, not repaired",
            None,
            "a flipped face is black to the room, and what leaves it leaves the room: twice its share",
            stated=lambda n: Band(n / 1280, 3.0 * n / 1280),
        ),
        Curve("kinds not said", at_most(0.0), "refused loudly, or repaired and said (catalogue A10)"),
    ),
    measure=late("measure_meshes", "bad_mesh"),
    log=True,
    whole=True,
)

UNITS = Case(
    id="A11",
    title="units",
    scene="a room with a crate, scaled",
    parameter="scale",
    unit="",
    values=(1e-4, 1e-2, 1.0, 1e2, 1e4),
    metric="largest |F - F at 1 m|",
    curves=(
        Curve("ours", at_most(1e-4), "form factors have no unit: rays are cast in a unit box (catalogue A11)"),
        Curve(
            "rays in metres",
            None,
            "the same lift and single precision in metres: too far at 0.1 mm, too near at 10 km",
            stated=lambda scale: at_least(1e-2)(scale) if scale in (1e-4, 1e4) else Band(0.0, 1.0),
        ),
    ),
    measure=late("measure_rays", "units"),
    log=True,
)

CASES: tuple[Case, ...] = (
    CLOSED_EDGES, THIN_GAP, CLOSURE, RECIPROCITY, COMMON_EDGE, NEAR_FIELD, ALIASING, SMALL, THIN_SHEET, BAD_MESH, UNITS,
)  # fmt: skip
