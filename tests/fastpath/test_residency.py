"""Which tiles are in the cache: against a search through all of the world, and what must hold whatever the budget."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath import residency
from lightgauge.fastpath.residency import AHEAD, Residency, urgency, wanted_tiles
from lightgauge.reference.datatypes import F64
from lightgauge.reference.texture_types import TileTable
from lightgauge.reference.volume.layout import build_layout
from lightgauge.reference.volume.table import tile_table
from small_scenes import random_tree

REACH = 6.0  # d0 in finest voxels


def world(levels: int = 6, share: float = 0.4, seed: int = 1) -> TileTable:
    tree = random_tree(levels, share, seed)
    return tile_table(build_layout(tree), np.arange(len(tree.corners), dtype=np.int32))


@pytest.fixture(scope="module")
def table() -> TileTable:
    return world()


def places(table: TileTable, n: int, seed: int) -> F64:
    return np.random.default_rng(seed).uniform(0, table.extent, (n, 3))


def test_wanted_is_what_a_search_through_all_tiles_finds(table: TileTable) -> None:
    for held in (*places(table, 2, 1), np.zeros(3), np.array([8.0, 16.0, 32.0])):
        expected = []
        for tile in range(table.tiles):
            edge = 2.0 ** (table.level - table.tile_level[tile] + 1)
            low = table.cell[tile] * edge
            away = math.dist(np.clip(held, low, low + edge), held)
            if away <= 2.0 ** (table.level - table.tile_level[tile]) * REACH + AHEAD * edge:
                expected.append(tile)
        got, rank = wanted_tiles(table, held, REACH)
        np.testing.assert_array_equal(np.sort(got), expected)
        assert (np.diff(table.tile_level[got]) >= 0).all()
        np.testing.assert_array_equal(rank, urgency(table, got, held, REACH))


def test_a_parent_is_never_less_urgent(table: TileTable) -> None:
    below = np.flatnonzero(table.parent >= 0)
    for held in places(table, 20, 2):
        rank = urgency(table, np.arange(table.tiles), held, REACH)
        assert (rank[table.parent[below]] <= rank[below]).all()


def test_finding_costs_what_is_found_not_what_is_there(table: TileTable, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = 0

    def counted(table: TileTable, tiles: Any, held: F64, reach: float) -> F64:
        nonlocal seen
        seen += len(tiles)
        return urgency(table, tiles, held, reach)

    monkeypatch.setattr(residency, "urgency", counted)
    found = len(wanted_tiles(table, np.full(3, 32.0), 2.0)[0])
    assert seen <= 8 * found + 1 and seen < table.tiles / 4


def step(keeper: Residency, held: F64) -> Any:
    plan = keeper.plan(held)
    keeper.leave(plan.out)
    keeper.arrive(plan.into, plan.into_slots)
    return plan


@pytest.mark.parametrize("share", [0.5, 0.9, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("per_move", [None, 7])
def test_what_holds_at_every_budget(table: TileTable, share: float, per_move: int | None) -> None:
    rng = np.random.default_rng(3)
    held = np.full(3, 32.0)
    budget = int(share * len(wanted_tiles(table, held, REACH)[0]))
    keeper, fitted = Residency(table, budget, REACH, per_move), 0
    for _ in range(40):
        before = set(keeper.resident()[0].tolist())
        plan = step(keeper, held)
        tiles, slots = keeper.resident()
        there = set(tiles.tolist())
        wanted, rank = wanted_tiles(table, held, REACH)
        assert len(there) == len(tiles) <= budget and len(set(slots.tolist())) == len(slots)
        assert there == (before - set(plan.out.tolist())) | set(plan.into.tolist())
        assert not set(plan.out.tolist()) & set(plan.into.tolist()) and set(plan.into.tolist()) <= set(wanted.tolist())
        assert all(table.parent[t] in there for t in tiles if table.parent[t] >= 0) and 0 in there
        assert plan.hits == len(before & set(wanted.tolist())) and plan.wanted == len(wanted)
        assert plan.missing == len(set(wanted.tolist()) - there)
        fitted += plan.missing == 0
        assert per_move is None or len(plan.into) <= per_move
        if per_move is None:
            assert plan.missing == max(0, len(wanted) - budget)
            if plan.missing:  # who is absent is about as urgent as who is there, or less
                absent = np.array([t not in there for t in wanted.tolist()])
                assert rank[~absent].max() * residency.KEEP <= rank[absent].min() + 1e-12
        held = np.clip(held + rng.normal(size=3) * 2.0, 0, table.extent)
    if per_move is None and share >= 1.5:
        assert fitted > 20, "mostly all is there; where the world is denser than at the start it may not fit"


def test_what_shows_most_comes_first(table: TileTable) -> None:
    keeper, held = Residency(table, 2000, REACH, per_move=10), np.full(3, 32.0)
    order = []
    for _ in range(5):
        order.append(step(keeper, held).into)
    ranks = [urgency(table, tiles, held, REACH) for tiles in order]
    assert all(a.max() <= b.min() for a, b in itertools.pairwise(ranks))
    assert 0 in order[0]


def test_a_viewer_who_trembles_moves_no_tiles(table: TileTable) -> None:
    """With the budget short, ranks at its edge change with every step; KEEP holds what is there. Several budgets, as the edge of one
    may happen to lie where nothing is."""
    centre = np.full(3, 31.3)
    wanted = len(wanted_tiles(table, centre, REACH)[0])
    went = {1.0: 0, residency.KEEP: 0}
    for keep in went:
        for share in (0.3, 0.4, 0.5, 0.6, 0.7):
            keeper = Residency(table, int(share * wanted), REACH, keep=keep)
            counts = [
                len(step(keeper, centre + 0.2 * np.array([math.cos(t), math.sin(t), math.sin(2 * t)])).out)
                for t in np.arange(60) * 0.7
            ]
            went[keep] += sum(counts[30:])
    assert went[1.0] > 10 and went[residency.KEEP] <= went[1.0] / 10, went


def test_bad_values(table: TileTable) -> None:
    for arguments in ((0, 1.0), (1, 0.0), (1, math.nan), (1, 1.0, 0), (1, 1.0, None, 0.0), (1, 1.0, None, 1.5)):
        with pytest.raises(ValueError, match="expected budget"):
            Residency(table, *arguments)  # type: ignore[arg-type]
