"""Leaks predicted, found and stopped: two rooms, walls of 0.25 to 2 voxels, turned about two axes, several lattices each.

A case is a thickness and a rotation. It is leak-free on every lattice exactly if (`leaks.tips`)

- t ≥ h (|nx| + |ny| + |nz|) for all walls, and
- no edge of the room is askew to the lattice: in the tips of such edges no probe of a place's own voxel need be valid, and a
  larger voxel answers, which reaches through.

It is predicted right if it leaks on one of its lattices where that does not hold, on none where it does, and if on each lattice
the places that leak are exactly those that half-spaces, the lattice and the copies of placement say: thousands of places, along the
twelve edges of the room too. The lattices are the one on which a voxel reaches furthest through a wall, one at random, and one on which
an edge pokes into a voxel by a fiftieth of it.

An edit stops a leak if the mean light at fresh places, all over the room and half of them near its walls, is at most a thousandth
of what lies beyond; it does so exactly if none is left at any of them, but in tips where no single voxel down to a sixteenth of the
usual size would keep it out either (`leaks.single`). How much light the worst edit leaves is a row of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...reference.config_base import Vec3
from ...reference.progress import Progress, silent
from ...reference.sh import COSINE_A0, Y0
from ...reference.variant import ensure_variant
from ..leaks.attribution import LEAKS_IN_DARK
from ..leaks.edit import find_edit
from ..leaks.field import joined, places
from ..leaks.single import single_edits
from .leak_scene import TwoRooms, all_over, dark_places, edge_corners, leaky_shift, tip_shift, two_rooms
from .rows import Group, Row, Wanted, row_of

THICKNESSES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)  # voxels
TURNS: tuple[Vec3, ...] = ((0, 0, 0), (0, 30, 0), (0, 45, 0), (30, 0, 0), (45, 0, 0), (30, 45, 0))
PLACES, FRESH = 1500, 4000
LEAK = 1e-3
NAMES = (
    "leak_predicted_right_share", "leak_places_right_share", "leak_edit_stops_share", "leak_edit_exact_share", "leak_edit_left",
    "leak_edit_cells", "leak_edit_minimal_share", "leak_dead_cases_share",
)  # fmt: skip
ON_EDGES = 100  # places along each of the room's edges


@dataclass(frozen=True)
class Tried:
    """One lattice of a case. own, dead: places that leak through voxels of the usual size, and through larger ones; wrong: of `places`,
    those that leak though predicted not to, or the other way round."""

    own: int
    dead: int
    wrong: int
    places: int


@dataclass(frozen=True)
class Stopped:
    """An edit tried out at fresh places. mean: light left over the light beyond the walls; lit: places with any; missed: of these,
    places that a single voxel would have kept dark. grown: cells before pruning."""

    cells: int
    grown: int
    minimal: bool
    mean: float
    lit: int
    missed: int


def lattices(rooms: TwoRooms, seed: int) -> list[np.ndarray]:
    """Shifts (3,) of the lattice, voxels: the one on which a voxel reaches furthest through a wall, a random one, and one on which an
    edge pokes into a voxel just a little, where edges are askew."""
    shifts = [leaky_shift(rooms), np.random.default_rng([seed, 31]).random(3)]
    return [*shifts, tip_shift(rooms, seed)] if rooms.askew else shifts


def tried(rooms: TwoRooms, shift: np.ndarray) -> Tried:
    """Look for leaks on one lattice, and hold them against what is predicted."""
    field = rooms.field(shift)
    at = joined([dark_places(rooms, field, 1, PLACES), places(edge_corners(rooms, 3, ON_EDGES), None, "edges")])
    leaks = rooms.search(field, at, shift).leaks(field, at)
    dead = leaks.leaks & (leaks.answers < leaks.holds)
    predicted = rooms.predicted(field, at).beyond * COSINE_A0 * Y0 > LEAKS_IN_DARK
    wrong = int((predicted != leaks.leaks).sum())
    return Tried(int((leaks.leaks & ~dead).sum()), int(dead.sum()), wrong, at.count)


def stopped(rooms: TwoRooms, shift: np.ndarray) -> Stopped:
    """Search for the edit that stops the leaks on one lattice, and look at other places than the search did."""
    field = rooms.field(shift)
    search = rooms.search(field, dark_places(rooms, field, 1, PLACES), shift)
    edit = find_edit(search, silent)
    fresh = places(all_over(rooms, 77, FRESH), None, "fresh")
    after = search.leaks(edit.field, fresh)
    left = np.abs(after.strength) / (COSINE_A0 * Y0)  # beyond the walls L00 is 1
    lit = np.flatnonzero(after.leaks)
    tried = single_edits(search, fresh, search.leaks(field, fresh), lit) if len(lit) else []
    missed = sum(one.layer is not None for one in tried)
    return Stopped(edit.cells, edit.grown, edit.minimal, float(left.mean()), len(lit), missed)


def right(rooms: TwoRooms, found: list[Tried]) -> bool:
    """Whether a case leaks on some lattice exactly where one is predicted to exist, and on each at the places predicted."""
    leaks = any(t.own or t.dead for t in found)
    reached = any(t.own for t in found) != rooms.keeps_light_in  # voxels of the usual size, by thickness alone
    return reached and leaks != rooms.leak_free_everywhere and not any(t.wrong for t in found)


def leaks(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """All rows, from all cases; edits, which take longest, only where one of their rows is wanted."""
    ensure_variant()
    with_edits = any(name.startswith("leak_edit") for name in wanted)
    verdicts: list[bool] = []
    looked: list[Tried] = []
    dead: list[bool] = []
    edits: list[Stopped] = []
    cases = [(thickness, turn) for turn in TURNS for thickness in THICKNESSES]
    for number, (thickness, turn) in enumerate(cases):
        rooms = two_rooms(thickness, turn)
        shifts = lattices(rooms, number)
        found = [tried(rooms, shift) for shift in shifts]
        verdicts.append(right(rooms, found))
        looked += found
        if rooms.keeps_light_in:
            dead.append(any(t.dead for t in found))
        # One edit a case: the first lattice that leaks, which is the worst one where voxels reach through a wall.
        leaky = [shift for shift, t in zip(shifts, found, strict=True) if t.own or t.dead]
        if with_edits:
            edits += [stopped(rooms, shift) for shift in leaky[:1]]
        progress("leaks", number + 1, len(cases))
    yield from _rows(verdicts, looked, dead, edits)


def _rows(verdicts: list[bool], looked: list[Tried], dead: list[bool], edits: list[Stopped]) -> Iterator[Row]:
    note = f"{len(verdicts)} cases, {len(looked)} lattices, tips of edges among them"
    yield _share("leak_predicted_right_share", verdicts, 1.0, note)
    total, wrong = sum(t.places for t in looked), sum(t.wrong for t in looked)
    yield Row(
        "leak_places_right_share", 1.0 - wrong / total, "share", 1.0, "higher", 0.0, total, f"{wrong} places wrong"
    )
    note = "of cases with walls thick enough: light through voxels that stand in, as predicted"
    yield _share("leak_dead_cases_share", dead, None, note, "lower")
    if edits:
        yield from _edit_rows(edits)


def _edit_rows(edits: list[Stopped]) -> Iterator[Row]:
    yield _share(
        "leak_edit_stops_share", [e.mean <= LEAK for e in edits], 1.0, f"{len(edits)} edits, one for each leaking case"
    )
    none, lit = sum(e.lit == 0 for e in edits), sum(e.lit for e in edits)
    note = f"exactly 0 but where no voxel down to h/16 helps; {none} leave none at all, the others {lit} of {len(edits) * FRESH} places"
    yield _share("leak_edit_exact_share", [e.missed == 0 for e in edits], None, note)
    left = max(e.mean for e in edits)
    yield Row(
        "leak_edit_left", left, "share", LEAK, "lower", 0.0, len(edits), "worst edit: mean light left at fresh places"
    )
    note = f"median; {np.median([e.grown for e in edits]):.0f} before pruning; smaller edits are better ones"
    yield row_of("leak_edit_cells", [e.cells for e in edits], "cells", "lower", note=note)
    yield _share("leak_edit_minimal_share", [e.minimal for e in edits], None, "none of the cells can be done without")


def _share(name: str, values: list[bool], target: float | None, note: str, better: str = "higher") -> Row:
    """A share of cases, with n of them; its spread is that of a binomial."""
    share = float(np.mean(values))
    spread = float(np.sqrt(share * (1.0 - share) / len(values)))
    return Row(name, share, "share", target, "lower" if better == "lower" else "higher", spread, len(values), note)


GROUPS = (Group(NAMES, leaks),)
