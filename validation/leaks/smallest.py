"""The edit that was found, made smaller and measured again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ...reference.lattice import cells, keys
from ...reference.progress import Progress
from .field import Places, joined, part, places
from .prune import Cells, Pruned, around, joined_cells, prune, stands, with_holders
from .search import Edit, Search, layers_of
from .served import served
from .walls import in_the_open

MOST_TRIES = 6
TRUSTED = 3  # tries in which places found to leak are only looked at from then on
PER_AXIS = 4  # places in each cell that are looked at: a cell with none in it would not be missed
MOST_PLACES = 400_000
# Places where an edit may leak and that were not looked at yet, others for every number.
Fresh = Callable[[Search, Edit, int], Places]


def smallest(search: Search, edit: Edit, dense: Places, fresh: Fresh, progress: Progress) -> Edit:
    """The edit without the cells that it does not need (`prune`), baked and measured; the edit itself where that would leak more.
    dense: places, besides its own, that it may not lose.

    Fresh places that turn out to leak are among those that the next try may not lose. What leaks though it was looked at does so for
    what one bake of the whole edit does not show (copies of light); then, and after TRUSTED tries in any case, the cells at and beside
    it are put back: the edit is not called minimal, unless each of them is needed.
    """
    grid = edit.field.octree.grid
    named = {grid.level_for(layer.size): layer.cells for layer in edit.layers}
    whole = with_holders(named, search.field.octree.voxels) if named else {}
    if not whole:
        return edit
    inside, rounds, fixed = joined([dense, _inside(search, edit, whole)]), edit.rounds, Cells()
    at = edit.places
    for number in range(MOST_TRIES):
        found = _pruned(search, edit, whole, joined([at, inside]), fixed)
        if not found.cells or _keys(found.cells) == _keys(named):
            return dataclasses.replace(edit, minimal=found.minimal and bool(found.cells), rounds=rounds)
        rounds += 1
        progress("leaks: trying a smaller edit", number + 1, MOST_TRIES)
        layers = layers_of(grid, found.cells)
        tried = dataclasses.replace(edit, layers=layers, field=search.rebake(layers), rounds=rounds)
        more = joined([at, fresh(search, tried, rounds)])
        now = search.leaks(tried.field, more)
        wrong = now.leaks & ~search.leaks(edit.field, more).leaks
        if not wrong.any():
            before = search.leaks(search.field, more)
            return dataclasses.replace(tried, places=more, before=before, after=now, minimal=found.minimal)
        unexplained = np.flatnonzero(wrong if number >= TRUSTED else wrong[: at.count])
        fixed = joined_cells(fixed, around(edit.field, part(more, unexplained), whole))
        at = joined([at, part(more, at.count + np.flatnonzero(wrong[at.count :]))])
    return dataclasses.replace(edit, rounds=rounds, minimal=False)


def _pruned(search: Search, edit: Edit, whole: Cells, at: Places, fixed: Cells) -> Pruned:
    """What is left of an edit's cells, so that no place leaks that does not with all of them."""
    table = served(search, edit.field, at, search.leaks(search.field, at).leaks, min(whole))
    left = np.bincount(table.kind, search.leaks(edit.field, at).leaks, len(table.otherwise)) > 0
    return prune(table, whole, ~table.leaks(stands(table, whole) > 0) & ~left, fixed)


def _inside(search: Search, edit: Edit, whole: Cells) -> Places:
    """Places all over the cells of an edit, in the open and to be kept dark."""
    grid, random = edit.field.octree.grid, np.random.default_rng(37)
    strata = np.stack(np.meshgrid(*[np.arange(PER_AXIS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    made = []
    for level, key in whole.items():
        share = (strata + random.random((len(key), *strata.shape))) / PER_AXIS
        made.append((grid.origin + (cells(key)[:, None, :] + share) * grid.size(level)).reshape(-1, 3))
    positions = np.concatenate(made)
    positions = positions[search.wanted(positions)]
    positions = positions[:: 1 + len(positions) // MOST_PLACES]
    return places(positions[in_the_open(edit.field.geometry, positions)], None, "between")


def _keys(by_level: Cells) -> dict[int, list[int]]:
    return {level: sorted(keys(c).tolist()) for level, c in by_level.items() if len(c)}
