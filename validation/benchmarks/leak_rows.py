"""Leaks predicted, found and stopped: two rooms, walls of 0.25 to 2 voxels, turned about two axes, several lattices each.

A case is a thickness and a rotation. It is predicted right if

- t ≥ h (|nx| + |ny| + |nz|) for all walls, and no place leaks on any lattice as far as voxels of size h answer,
- or it does not hold for all, and a lattice exists on which a place leaks,

and if no place at all leaks that a voxel answers for which the wall is thick enough: where no probe of a place's own voxel is
valid, in the edges of turned rooms, a larger one answers, and light may come through a wall that is thick enough for the
others. How often that happens is a row of its own.

An edit stops a leak if the mean light at fresh places, all over the room and half of them near its walls, is at most a thousandth
of what lies beyond; how often it is exactly 0 at all of them is a row of its own. What is left then are the tips of the edges
of turned rooms: however small the voxels, some there have no corner in the room.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...reference.config_base import Vec3
from ...reference.progress import Progress, silent
from ...reference.sh import COSINE_A0, Y0
from ...reference.variant import ensure_variant
from ..leaks.edit import find_edit
from ..leaks.field import places
from .leak_scene import TwoRooms, all_over, dark_places, leaky_shift, two_rooms
from .rows import Group, Row, Wanted, row_of

THICKNESSES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)  # voxels
TURNS: tuple[Vec3, ...] = ((0, 0, 0), (0, 30, 0), (0, 45, 0), (30, 0, 0), (45, 0, 0), (30, 45, 0))
PLACES, FRESH = 1500, 4000
LEAK = 1e-3
NAMES = (
    "leak_predicted_right_share", "leak_edit_stops_share", "leak_edit_exact_share", "leak_edit_cells", "leak_dead_cases_share",
)  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """One lattice of a case. own, dead: places that leak through voxels of the usual size, and through larger ones. unsound: places
    that leak though the voxel that answers is small enough for every wall."""

    own: int
    dead: int
    unsound: int


@dataclass(frozen=True)
class Stopped:
    """An edit tried out. mean: light left at fresh places over the light beyond the walls; exact: none at any of them."""

    cells: int
    mean: float
    exact: bool


def lattices(rooms: TwoRooms, seed: int) -> list[np.ndarray]:
    """Shifts (3,) of the lattice, voxels: the one on which a voxel reaches furthest through a wall, and a random one."""
    return [leaky_shift(rooms), np.random.default_rng([seed, 31]).random(3)]


def tried(rooms: TwoRooms, shift: np.ndarray) -> Tried:
    """Look for leaks on one lattice."""
    field = rooms.field(shift)
    at = dark_places(rooms, field, 1, PLACES)
    leaks = rooms.search(field, at, shift).leaks(field, at)
    dead = leaks.leaks & (leaks.answers < leaks.holds)
    size = field.octree.grid.finest * 2.0 ** (field.octree.grid.level - np.minimum(leaks.answers, leaks.holds))
    unsound = leaks.leaks & (rooms.thickness >= size * rooms.spreads.max())
    return Tried(int((leaks.leaks & ~dead).sum()), int(dead.sum()), int(unsound.sum()))


def stopped(rooms: TwoRooms, shift: np.ndarray) -> Stopped:
    """Search for the edit that stops the leaks on one lattice, and look at other places than the search did."""
    field = rooms.field(shift)
    search = rooms.search(field, dark_places(rooms, field, 1, PLACES), shift)
    edit = find_edit(search, silent)
    fresh = places(all_over(rooms, 77, FRESH), None, "fresh")
    left = np.abs(search.leaks(edit.field, fresh).strength) / (COSINE_A0 * Y0)  # beyond the walls L00 is 1
    return Stopped(edit.cells, float(left.mean()), not left.any())


def right(rooms: TwoRooms, found: list[Tried]) -> bool:
    """Whether a case leaks exactly where it is predicted to."""
    leaks = any(t.own for t in found)
    return leaks != rooms.keeps_light_in and not any(t.unsound for t in found)


def leaks(wanted: Wanted, progress: Progress) -> Iterator[Row]:
    """All rows, from all cases."""
    ensure_variant()
    del wanted
    verdicts: list[bool] = []
    dead: list[bool] = []
    edits: list[Stopped] = []
    cases = [(thickness, turn) for turn in TURNS for thickness in THICKNESSES]
    for number, (thickness, turn) in enumerate(cases):
        rooms = two_rooms(thickness, turn)
        shifts = lattices(rooms, number)
        found = [tried(rooms, shift) for shift in shifts]
        verdicts.append(right(rooms, found))
        if rooms.keeps_light_in:
            dead.append(any(t.dead for t in found))
        # One edit a case: the first lattice that leaks, which is the worst one where voxels reach through a wall.
        leaky = [shift for shift, t in zip(shifts, found, strict=True) if t.own or t.dead]
        edits += [stopped(rooms, shift) for shift in leaky[:1]]
        progress("leaks", number + 1, len(cases))
    note = f"{len(cases)} cases, two lattices each, one edit each"
    yield _share("leak_predicted_right_share", verdicts, 1.0, note)
    yield _share("leak_edit_stops_share", [e.mean <= LEAK for e in edits], 1.0, note)
    yield _share("leak_edit_exact_share", [e.exact for e in edits], None, "exactly 0 at every fresh place")
    yield row_of(
        "leak_edit_cells", [e.cells for e in edits], "cells", "lower", note="median; smaller edits are better ones"
    )
    yield _share(
        "leak_dead_cases_share",
        dead,
        None,
        "of cases predicted to keep light in: light through voxels that stand in",
        "lower",
    )


def _share(name: str, values: list[bool], target: float | None, note: str, better: str = "higher") -> Row:
    """A share of cases, with n of them; its spread is that of a binomial."""
    share = float(np.mean(values))
    spread = float(np.sqrt(share * (1.0 - share) / len(values)))
    return Row(name, share, "share", target, "lower" if better == "lower" else "higher", spread, len(values), note)


GROUPS = (Group(NAMES, leaks),)
