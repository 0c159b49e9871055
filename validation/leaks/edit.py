"""The smallest bitmap edit that stops a leak, tried out: bake, look where it still leaks, refine there alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...reference.datatypes import F64, I64, Bool
from ...reference.errors import InputError
from ...reference.lattice import NEIGHBOURS, Grid, Octree, cells, index_of, keys, unique_cells
from ...reference.progress import Progress
from .attribution import Leaks, blamed
from .descent import TRIED, finer_cells
from .field import LightField, Places, cells_at, joined, part, places
from .offenders import offenders
from .search import Edit, Search, layers_of
from .smallest import smallest
from .tips import edge_places
from .walls import in_the_open, is_sheet

MOST_ROUNDS = 6
MOST_TURNS = 5  # of growing, each looked at in DRAWS draws of places
DRAWS = 8
MANY = 10_000  # more bakes than a search has: numbers of draws from here on are not those of its bakes
MOST_DEEPER = 4  # levels below placement.min_voxel: walls that taper off would want ever finer voxels
MOST_CELLS = 200_000
PER_AXIS = 6  # places in each voxel at or beside a leak that are looked at after each bake
MOST_CHECKED = 100_000
ENOUGH = 0.02  # of the leaking places may stay where the scene does not say what must be dark: light round corners never ends
STRATA = np.stack(np.meshgrid(*[np.arange(PER_AXIS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
WAVES = 64  # of the search along a wall, a voxel each


def find_edit(search: Search, progress: Progress) -> Edit:
    """Search for the smallest edit: cells by the descent, verified by baking, grown where light still comes through; then without
    those of them that it can do without (`smallest`).

    Each bake is also looked at in places that no earlier one was, all over the voxels that leaked, in slivers beside faces and in tips
    of edges; the last one at many, at which nothing may be lost by making it smaller either. What is left is counted at as many others.
    """
    edit = _nothing(search)
    few = 0 if search.dark is not None else int(ENOUGH * edit.before.leaks.sum())
    voxels = _leaking_voxels(search.field, edit.before, edit.places)
    dense = edit.places
    for turn in range(MOST_TURNS):
        grown = _grow(search, edit, voxels, few, progress)
        if grown.layers is edit.layers:  # nothing more that helps
            break
        dense = joined([dense, _draws(search, grown.field, voxels, turn)])
        edit = _with_places(search, grown, _leaking(search, grown.field, dense))
        if int(edit.after.leaks.sum()) <= few:
            break

    def fresh(search: Search, tried: Edit, number: int) -> Places:
        return _leaking(search, tried.field, _looked_at(search, tried.field, voxels, number))

    edit = smallest(search, edit, dense, fresh, progress)
    others = _draws(search, edit.field, voxels, MOST_TURNS)
    edit = _with_places(search, edit, _leaking(search, edit.field, others))
    return dataclasses.replace(edit, checked=others.count)


def _draws(search: Search, field: LightField, voxels: dict[int, I64], turn: int) -> Places:
    """DRAWS draws of places, others for every `turn` and none that a search looks at."""
    return joined([_looked_at(search, field, voxels, MANY + DRAWS * turn + k) for k in range(DRAWS)])


def _with_places(search: Search, edit: Edit, more: Places) -> Edit:
    """The edit with more places that it is judged by."""
    at = joined([edit.places, more])
    return dataclasses.replace(
        edit, places=at, before=search.leaks(search.field, at), after=search.leaks(edit.field, at)
    )


def _nothing(search: Search) -> Edit:
    """No edit yet, and the places that it is to be looked at."""
    at = joined([search.at, in_the_edges(search, search.field, 0)])
    at = joined([at, along_the_walls(search, search.field, at)])
    leaks = search.leaks(search.field, at)
    sheets = int(_through_sheets(search, leaks, at).sum())
    return Edit((), at, leaks, leaks, search.field, 0, sheets, "", 0, False)


def _grow(search: Search, edit: Edit, voxels: dict[int, I64], few: int, progress: Progress) -> Edit:
    """An edit with the cells that stop what still leaks with it; the same layers where none helps. voxels: cells (N, 3) by level at
    and around the places that leaked without any edit. few: places that may go on leaking."""
    grid = search.field.octree.grid
    chosen = {edit.field.octree.grid.level_for(layer.size): layer.cells for layer in edit.layers}
    field, at, now, refused = edit.field, edit.places, edit.after, ""
    deepest, rounds = grid.wanted_level + MOST_DEEPER, 0
    while rounds < MOST_ROUNDS and int(now.leaks.sum()) > few:
        found = _cells_for(search, field, now, at, _through_sheets(search, now, at), deepest)
        grown = _grown(chosen, found)
        if _count(grown) == _count(chosen) or _count(grown) > MOST_CELLS:
            break
        rounds += 1
        progress("leaks: trying an edit", rounds, MOST_ROUNDS)
        try:
            field = search.rebake(layers_of(grid, grown))
        except InputError as error:  # too deep or too many probes: as much of it as the octree bears
            refused, deepest = str(error), max(grown) - 1
            continue
        chosen = grown
        number = edit.rounds + rounds
        at = joined([at, _leaking(search, field, _looked_at(search, field, voxels, number))])
        now = search.leaks(field, at)
    sheets = int(_through_sheets(search, now, at).sum())
    before, layers = search.leaks(search.field, at), edit.layers
    if _count(chosen) > edit.cells:
        layers = layers_of(grid, chosen)
    most = max(edit.grown, _count(chosen))
    minimal = edit.minimal and layers is edit.layers
    return Edit(layers, at, before, now, field, edit.rounds + rounds, sheets, refused, most, minimal, edit.checked)


def _leaking_voxels(field: LightField, leaks: Leaks, at: Places) -> dict[int, I64]:
    """Cells (N, 3) by level of the voxels that hold leaking places, and of their neighbours."""
    bad = np.flatnonzero(leaks.leaks)
    level = leaks.holds[bad]
    found = {}
    for deep in np.unique(level):
        cell = unique_cells(cells_at(field.octree, int(deep), at.positions[bad[level == deep]]))
        found[int(deep)] = _beside(field.octree, int(deep), cell)
    return found


def _beside(octree: Octree, level: int, cell: I64) -> I64:
    """Voxels (M, 3) of `level` at and around cells (N, 3)."""
    around = unique_cells((cell[:, None, :] + NEIGHBOURS).reshape(-1, 3))
    return around[index_of(keys(octree.voxels[level]), keys(around)) >= 0]


def _looked_at(search: Search, field: LightField, voxels: dict[int, I64], number: int) -> Places:
    """Places for a field all over `voxels`, cells (N, 3) by level of the search's own, half of them in slivers beside faces, and in the
    tips of edges: others for every `number`."""
    grid, random = search.field.octree.grid, np.random.default_rng([number, 29])
    tried = [np.zeros((0, 3))]
    for level, cell in voxels.items():
        share = (STRATA + random.random((len(cell), *STRATA.shape))) / PER_AXIS
        tried.append((grid.origin + (cell[:, None, :] + share) * grid.size(level)).reshape(-1, 3))
    fresh = np.concatenate(tried)
    both = (
        places(fresh[1::2], None, "between"),
        places(_at_faces(fresh[::2], field.octree.grid, random), None, "slivers"),
    )
    some = [_to_be_looked_at(search, field, one, MOST_CHECKED // 2) for one in both]
    return joined([*some, in_the_edges(search, field, number)])


def _leaking(search: Search, field: LightField, at: Places) -> Places:
    """Those that leak with a field."""
    return part(at, np.flatnonzero(search.leaks(field, at).leaks))


def _to_be_looked_at(search: Search, field: LightField, at: Places, most: int) -> Places:
    """Those that an edit is for, in the open: `most` at most."""
    wanted = np.flatnonzero(search.wanted(at.positions))
    at = part(at, wanted[:: 1 + len(wanted) // most])
    return part(at, np.flatnonzero(in_the_open(field.geometry, at.positions)))


def _at_faces(positions: F64, grid: Grid, random: np.random.Generator) -> F64:
    """Places (N, 3) m moved along one axis to beside a face of the finest voxels, 2^-12 to 1/2 of one from it: where the four corners
    of a face are invalid, a sliver along it has too little weight for its own voxel to answer."""
    count = len(positions)
    axis, side = random.integers(0, 3, count), random.choice((-1.0, 1.0), count)
    moved, rows = positions.copy(), np.arange(count)
    steps = (positions[rows, axis] - grid.origin[axis]) / grid.finest
    moved[rows, axis] = grid.origin[axis] + (np.rint(steps) + side * 0.5 ** random.uniform(1, 12, count)) * grid.finest
    return moved


def _cells_for(
    search: Search, field: LightField, leaks: Leaks, at: Places, sheets: Bool, deepest: int
) -> dict[int, I64]:
    """Cells by level, down to `deepest`, that stop what leaks now."""
    grid, found = field.octree.grid, dict[int, list[I64]]()
    for group in offenders(field, leaks, at, sheets, deepest):
        for level, finer in finer_cells(field.geometry, grid, group, search.wanted).items():
            found.setdefault(level, []).append(finer)
    return {level: np.concatenate(parts) for level, parts in found.items()}


def _grown(chosen: dict[int, I64], found: dict[int, I64]) -> dict[int, I64]:
    """Cells by level of both, none twice."""
    both = dict(chosen)
    for level, more in found.items():
        both[level] = unique_cells(np.concatenate([chosen.get(level, more[:0]), more]))
    return both


def _count(by_level: dict[int, I64]) -> int:
    return sum(map(len, by_level.values()))


def along_the_walls(search: Search, field: LightField, at: Places) -> Places:
    """More places, in the voxels around those that leak, and around these where they leak too: receivers are few, and a moving
    object may stand anywhere."""
    found: list[Places] = []
    asked: dict[int, I64] = {}
    here = at
    for _ in range(WAVES):
        leaks = search.leaks(field, here)
        fresh = _neighbours(field, leaks, here, asked)
        fresh = fresh[search.wanted(fresh)]
        if len(fresh) == 0:
            break
        fresh = fresh[in_the_open(field.geometry, fresh)]
        here = places(fresh, None, "between")
        found.append(here)
    return joined(found)


def in_the_edges(search: Search, field: LightField, number: int) -> Places:
    """Places in the tips of edges that are askew to the lattice, where voxels may have no valid probe (`tips`), as deep as the finest
    voxels ask for: others for every `number`."""
    tips = edge_places(field.geometry, min(field.octree.grid.wanted, field.octree.grid.finest), number)
    tips = tips[search.wanted(tips)]
    return places(tips[in_the_open(field.geometry, tips)], None, "edges")


def _neighbours(field: LightField, leaks: Leaks, at: Places, asked: dict[int, I64]) -> F64:
    """Places (N, 3) m in voxels at and around those that leak and that were not asked yet; `asked` (keys by level) grows."""
    octree, grid = field.octree, field.octree.grid
    bad = np.flatnonzero(leaks.leaks)
    level = np.minimum(leaks.answers[bad], leaks.holds[bad])
    made = [np.zeros((0, 3))]
    for deep in np.unique(level):
        cell = unique_cells(cells_at(octree, deep, at.positions[bad[level == deep]]))
        around = keys(_beside(octree, int(deep), cell))
        old = asked.get(int(deep), np.zeros(0, dtype=np.int64))
        fresh = np.setdiff1d(around, old)
        asked[int(deep)] = np.union1d(old, fresh)
        made.append((grid.origin + (cells(fresh)[:, None, :] + TRIED) * grid.size(int(deep))).reshape(-1, 3))
    return np.concatenate(made)


def _through_sheets(search: Search, leaks: Leaks, at: Places) -> Bool:
    """Places (N,) all of whose blamed light comes through sheets: no voxel is small enough for them."""
    mine = blamed(leaks)
    sheet = is_sheet(search.field.geometry, leaks.pairs.triangle)
    sample, n = leaks.pairs.weights.sample, at.count
    return np.asarray((np.bincount(sample, mine & sheet, n) > 0) & (np.bincount(sample, mine & ~sheet, n) == 0))
