"""Probes under stress: C1 … C8 of the failure catalogue."""

from __future__ import annotations

import math

from .bands import around
from .case import Band, Case, Curve, Wanted, at_least, at_most, within
from .cases_reconstruction import C1, C2, C3
from .kernel_curve import kernel_curve
from .late import late

LEFT_OUT = 'scope limit: role = "moving" stays out of the bake, so the open sky shines instead: 1/(1 - cover s) - 1 [A]'

C4 = Case(
    id="C4",
    title="Probes inside open meshes, under floors, among leaves",
    scene="a rock in the ground, open below or above; under the ground; among two-sided leaves",
    parameter="missing share of the rock's surface",
    unit="",
    values=(0.0, 0.1, 0.2, 0.3, 0.4),
    metric="area under the ROC curve (_auc), and rates at the tolerance 0.1, against the whole rock's winding number",
    curves=(
        Curve("embedded_auc", at_least(0.99), "all tolerances 0 … 1: an underside in the ground is not seen (C4)"),
        Curve("embedded_missed", at_most(0.01), "places in the rock that count as valid"),
        Curve("embedded_alarms", at_most(0.01), "free places that do not; the hole comes out of the ground at 0.35"),
        Curve("open_auc", at_least(0.99), "seen from within, what is left of the surface still tells: catalogue C4"),
        Curve(
            "open_missed",
            at_most(0.01),
            "places under the hole see the open sky: with 0.3 and more gone some see too few backs",
            stated=lambda v: Band(0.0, 0.3 if v >= 0.3 else 0.01),
        ),
        Curve(
            "open_alarms",
            at_most(0.01),
            "free places that look into the hole see backs; they stand close above it",
            stated=lambda v: Band(0.0, 0.06 if v > 0.0 else 0.0),
        ),
        Curve(
            "below_missed", at_most(0.01), "a floor with no underside is told by its back, to the edge of the ground"
        ),
        Curve("cards_alarms", at_most(0.0), "two-sided leaves have no inside"),
    ),
    measure=late("measure_placement", "validity"),
    breaks="open_missed",
    limit=0.02,
)

C5 = Case(
    id="C5",
    title="Harmonic mean distance: bias, spread, special values",
    scene="1 m over a plane, between plates, in a corridor; on a surface; in empty space; in a ball",
    parameter="rays",
    unit="",
    values=(16.0, 32.0, 64.0, 128.0, 256.0, 1024.0),
    metric="bias and standard deviation of 1/HM, relative; special: values that are wrong",
    curves=(
        *(
            Curve(f"bias_{n}", within(-4e-3, 4e-3), f"closed form {v}: C5")
            for n, v in (("plane", "4 h"), ("plates", "2 h"), ("corridor", "√2 a"))
        ),
        Curve(
            "spread",
            lambda n: Band(0.0, 0.005 if n >= 64 else 0.04),
            "rotated Fibonacci directions: 0.4 % at 64 rays (C5)",
        ),
        Curve(
            "independent",
            None,
            "independent directions: √(1/6 - 1/16) · 4 / √N, 16 % at 64 rays [A]",
            stated=lambda n: around(4.0 * math.sqrt((1.0 / 6.0 - 1.0 / 16.0) / n), 0.1),
        ),
        Curve("special", at_most(0.0), "d = 0 → 0, all miss → ∞, a ball's middle → its radius, never NaN (C5)"),
    ),
    measure=late("measure_placement", "distances"),
    log=True,
    whole=True,
    breaks="spread",
    limit=0.005,
)

C6 = Case(
    id="C6",
    title="The harmonic mean is blind to thin far things",
    scene="a pole between walls 100 m away, voxels of 1.6 m",
    parameter="width of the pole",
    unit="m",
    values=(0.02, 0.1, 0.2, 0.8, 1.6, 3.2, 6.4),
    metric="share of the pole's finest voxels that exist; reads: harmonic mean at 2 m over w/(8 d²) + 1/R",
    curves=(
        Curve(
            "default",
            at_least(1.0),
            "by the harmonic mean alone nothing under the voxel size is found: at 2 m it reads 62 m (C6)",
            stated=lambda w: Band(0.0, 0.0 if w <= 0.8 else 1.0),
        ),
        Curve("touching", at_least(1.0), "placement.touching: a voxel with a surface in it is close to it"),
        Curve("reads", within(0.95, 1.05), "so little does a thin pole add to 1/R [A]", where=lambda w: w <= 0.2),
    ),
    measure=late("measure_placement", "thin_things"),
    log=True,
    breaks="default",
    limit=0.5,
)


def _through(turn: str) -> Wanted:
    def stated(thickness: float) -> Band:
        from .measure_walls import needed

        line = needed(turn)
        return Band(1e-4 if thickness < line - 0.05 else 0.0, 0.0 if thickness >= line else 1.01)

    return stated


_TURNS = (("straight", "1"), ("turned_30", "1.366"), ("turned_45", "1.414"))
C7 = Case(
    id="C7",
    title="Thin walls",
    scene="two rooms in one block, on the lattice that is worst for their walls",
    parameter="thickness of the walls",
    unit="voxels",
    values=(0.5, 0.75, 0.9, 1.1, 1.3, 1.5, 1.75),
    metric="most light in the dark room over the light beyond its walls; printed_…: relative error of the voxel said to be needed; "
    "edges_…: share of places along edges lit otherwise than foreseen",
    curves=(
        *(
            Curve(
                name,
                at_most(0.0),
                f"voxels of the usual size keep light out iff t ≥ h (|nx| + |ny| + |nz|) = {line} voxels, proven and exact (C7)",
                stated=_through(name),
            )
            for name, line in _TURNS
        ),
        *(
            Curve(f"printed_{name}", at_most(1e-4), "the h that each wall needs is said: t / (|nx| + |ny| + |nz|)")
            for name, _ in _TURNS
        ),
        *(
            Curve(
                f"edges_{name}",
                at_most(0.0),
                "where an edge pokes into a voxel between its corners a larger one answers: lit exactly where half-spaces say",
            )
            for name, _ in _TURNS[1:]
        ),
        kernel_curve(),
    ),
    measure=late("measure_walls", "thin_wall"),
    breaks="turned_30",
    limit=1e-6,
    notes=(
        "Just under the line the piece of room that a voxel reaches shrinks with the cube of what is missing: none of 1,500 places "
        "and all voxels' corners may lie in it within the last 0.05 voxels.",
        "Thickness alone does not keep light in where an edge of a room is askew to the lattice: there some of the room has no "
        "probe of a voxel of the usual size, whatever that is.",
    ),
)


def _left_out(cover: float) -> Band:
    from .measure_outdoors import excess

    return around(excess(cover), 0.15, 0.02)


def _cards(cover: float) -> Band:
    from .measure_outdoors import lost_l1

    return Band(-0.02, 1.5 * lost_l1(cover)[0] + 0.06)


def _whole(cover: float) -> Band:
    from .measure_outdoors import lost_l1

    left = 1.0 + lost_l1(cover)[1]
    return Band(0.65 * left - 1.0, 1.35 * left - 1.0)


C8 = Case(
    id="C8",
    title="Outdoors: moving leaves, masked leaves, covers of 10 … 90 %",
    scene="a layer of black cards of 1 m, 3 m above the ground under an even sky",
    parameter="cover",
    unit="%",
    values=(10.0, 50.0, 90.0),
    metric="mean irradiance of places that face up over the truth's, minus 1",
    curves=(
        Curve("truth", within(-0.06, 0.06), "each ray passes the layer once: 1 - cover s of the open sky's light [A]"),
        Curve(
            "over_floor",
            within(-0.05, 0.05),
            "cards in the bake: no other error than exact SH of order 1 has at the very places",
        ),
        Curve(
            "static",
            within(-0.05, 0.05),
            "scope limit of L1: light that comes in flat under the rim lights upward faces too much [A]",
            stated=_cards,
        ),
        Curve("moving", within(-0.05, 0.05), LEFT_OUT, stated=_left_out),
        Curve(
            "masked",
            within(-0.05, 0.05),
            "scope limit: a mask is whole to the bake, only L1's share of the rim is left [A]",
            stated=_whole,
        ),
    ),
    measure=late("measure_outdoors", "under_leaves"),
    breaks="static",
    limit=0.05,
    notes=("Findings of a run name masks and moving meshes, and patch_relrmse shows what they cost.",),
)

CASES: tuple[Case, ...] = (C1, C2, C3, C4, C5, C6, C7, C8)
