"""Light for dead edges (talk, "Copy from adjacent probe"; failure-catalogue D5, D6).

Where both probes of a voxel's edge are invalid, samples on that edge have weight 0 and must ask the level above: light
jumps there. One of the two probes then takes the light of a valid probe beside it, before virtual probes are made, so they
see it too. The choice belongs to the probe: every tile that holds it reads the same.

Only edges that a surface crosses and on which a probe would be valid somewhere are mended: the others lie within something
or outside of the world, where nothing is sampled.

No light may pass a wall. The invalid probe stands *in* the wall as a rule, so the way to it enters something; that alone
forbids nothing. A copy is refused where
- the way to the probe leaves something, or passes a sheet without an inside;
- a voxel around the probe has a valid corner that the source does not see: the copy would be mixed into its light;
- open space within a voxel around the probe is hidden from the source, and from all the open space around that the source
  does see. Space just round a corner is thereby allowed, space behind a wall is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..datatypes import I32, I64, Bool
from ..lattice import NEIGHBOURS, Octree, cells, distinct, index_of, keys
from ..visibility import Geometry
from .segments import crossings, seen
from .validity import back_share

# Lattice neighbours, nearest first, then in the order of their keys: (26, 3).
BESIDE = NEIGHBOURS[np.argsort(np.abs(NEIGHBOURS).sum(axis=1), kind="stable")][1:]
# Where open space is looked for around a probe, in voxels: 3×3×3 places in each of the eight voxels, (216, 3).
AROUND = np.array([-5, -3, -1, 1, 3, 5]) / 6.0
PLACES = np.stack(np.meshgrid(AROUND, AROUND, AROUND, indexing="ij"), axis=-1).reshape(-1, 3)
PAIRS_PER_BATCH = 1 << 11
# Where on an edge open space is looked for.
ALONG = (np.arange(8) + 0.5) / 8.0


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of existing voxels: ends (N, 2) i64, numbers of probes; level (N,) i64 whose voxels they belong to."""

    ends: I64
    level: I64

    def part(self, chosen: Bool | I64) -> Edges:
        """Some of the edges."""
        return Edges(self.ends[chosen], self.level[chosen])


def dead_edges(tree: Octree, valid: Bool) -> Edges:
    """All edges of existing voxels whose two probes are invalid; finest level first, then by axis and place."""
    known = keys(tree.corners)
    ends, levels = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for level in range(tree.grid.level, -1, -1):
        scale = 1 << (tree.grid.level - level)
        for axis in range(3):
            along = np.eye(3, dtype=np.int64)[axis]
            square = np.delete(np.arange(3), axis)
            first = np.repeat(tree.voxels[level][:, None, :], 4, axis=1)
            first[:, :, square] += np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
            start = cells(distinct(keys(first.reshape(-1, 3))))
            pair = np.stack([index_of(known, keys((start + step * along) * scale)) for step in (0, 1)], axis=1)
            # The coarse voxels of a uniform grid may reach beyond it: no probe stands there.
            pair = pair[(pair >= 0).all(axis=1) & ~valid[pair].any(axis=1)]
            ends.append(pair)
            levels.append(np.full(len(pair), level, dtype=np.int64))
    return Edges(np.concatenate(ends), np.concatenate(levels))


def exposed(g: Geometry, tree: Octree, edges: Edges, tolerance: float, seed: int) -> Edges:
    """The edges that a surface crosses and on which a probe would be valid somewhere: on the others nothing is ever sampled."""
    at = tree.positions
    first, last = at[edges.ends[:, 0]], at[edges.ends[:, 1]]
    crossed = np.flatnonzero(~seen(g, first, last))
    places = first[crossed, None] + ALONG[:, None] * (last - first)[crossed, None]
    share = back_share(g, places.reshape(-1, 3), seed).reshape(len(crossed), len(ALONG))
    return edges.part(crossed[(share <= tolerance).any(axis=1)])


def light_from(g: Geometry, tree: Octree, valid: Bool, tolerance: float, seed: int) -> I32:
    """Whose light each probe uses, (R,) i32: its own number where it is valid, a valid neighbour's where it is copied, else -1.

    valid: (R,). tolerance: share of back faces at which a place still counts as open.
    """
    source = np.where(valid, np.arange(len(valid)), -1).astype(np.int32)
    edges = exposed(g, tree, dead_edges(tree, valid), tolerance, seed)
    for level in range(tree.grid.level, -1, -1):
        mine = edges.ends[edges.level == level]
        mine = mine[(source[mine] < 0).all(axis=1)]
        if len(mine):
            _choose(source, mine, _sources(g, tree, valid, np.unique(mine), level))
    return source


def _choose(source: I32, edges: I64, offers: dict[int, int]) -> None:
    """Fill one end of each edge, unless the other edges have filled one already; the end that more dead edges share first,
    then the lower number."""
    number, degree = np.unique(edges, return_counts=True)
    shared = dict(zip(number.tolist(), degree.tolist(), strict=True))
    for pair in edges.tolist():
        if source[pair[0]] >= 0 or source[pair[1]] >= 0:
            continue
        able = [p for p in pair if p in offers]
        if able:
            best = min(able, key=lambda p: (-shared[p], p))
            source[best] = offers[best]


def _sources(g: Geometry, tree: Octree, valid: Bool, probes: I64, level: int) -> dict[int, int]:
    """Invalid probe -> the first of its valid neighbours at `level` whose light it may take."""
    step = 1 << (tree.grid.level - level)
    known, at = keys(tree.corners), tree.positions
    beside = index_of(known, keys((tree.corners[probes][:, None, :] + step * BESIDE[None]).reshape(-1, 3)))
    beside = np.where((beside >= 0) & valid[beside], beside, -1).reshape(len(probes), len(BESIDE))
    row, rank = np.nonzero(beside >= 0)
    pair = np.stack([probes[row], beside[row, rank]], axis=1)
    pair = pair[~crossings(g, at[pair[:, 1]], at[pair[:, 0]]).through]
    found: dict[int, int] = {}
    while len(pair):  # the nearest to each probe first: most are settled by it
        first = np.diff(pair[:, 0], prepend=-1) != 0
        offer, pair = pair[first], pair[~first]
        good = offer[allowed(g, tree, valid, offer)]
        found.update(good.tolist())
        pair = pair[~np.isin(pair[:, 0], good[:, 0])]
    return found


def allowed(g: Geometry, tree: Octree, valid: Bool, pairs: I64) -> Bool:
    """Whether probe pairs[:, 0] may take the light of pairs[:, 1]; (N,) bool. The way itself is judged by the caller."""
    good = np.ones(len(pairs), dtype=np.bool_)
    for begin in range(0, len(pairs), PAIRS_PER_BATCH):
        part = np.arange(begin, min(begin + PAIRS_PER_BATCH, len(pairs)))
        for level, rows in _levels_of(tree, pairs[part, 0]):
            rows = part[rows]
            rows = rows[good[rows]]
            good[rows] = _corners_seen(g, tree, valid, pairs[rows], level)
            rows = rows[good[rows]]
            good[rows] = _space_seen(g, tree, pairs[rows], level)
    return good


def _levels_of(tree: Octree, probes: I64) -> Iterator[tuple[int, I64]]:
    """Levels, coarse to fine, with the places in `probes` of those that are a corner of an existing voxel there."""
    for level in range(tree.grid.level + 1):
        scale = 1 << (tree.grid.level - level)
        corner = tree.corners[probes]
        on = np.flatnonzero((corner % scale == 0).all(axis=1) & (tree.corner_level[probes] <= level))
        if not len(on):
            continue
        around = (corner[on][:, None, :] // scale + NEIGHBOURS[(NEIGHBOURS <= 0).all(axis=1)][None]).reshape(-1, 3)
        there = index_of(keys(tree.voxels[level]), keys(around)).reshape(len(on), 8) >= 0
        yield level, on[there.any(axis=1)]


def _corners_seen(g: Geometry, tree: Octree, valid: Bool, pairs: I64, level: int) -> Bool:
    """Whether the source sees all valid corners of the eight voxels around the probe, (N,)."""
    step, at = 1 << (tree.grid.level - level), tree.positions
    corner = (tree.corners[pairs[:, 0]][:, None, :] + step * BESIDE[None]).reshape(-1, 3)
    number = index_of(keys(tree.corners), keys(corner)).reshape(len(pairs), len(BESIDE))
    row, column = np.nonzero((number >= 0) & valid[number] & (number != pairs[:, 1:]))
    clear = seen(g, at[pairs[row, 1]], at[number[row, column]])
    every = np.ones(len(pairs), dtype=np.bool_)
    every[row[~clear]] = False
    return every


def _space_seen(g: Geometry, tree: Octree, pairs: I64, level: int) -> Bool:
    """Whether all open space around the probe is seen from the source, or from open space around that the source sees, (N,)."""
    n, at = len(pairs), tree.positions
    place = at[pairs[:, 0]][:, None, :] + tree.grid.size(level) * PLACES[None]
    from_source = np.repeat(at[pairs[:, 1]], len(PLACES), axis=0)
    met = crossings(g, from_source, place.reshape(-1, 3))
    clear = met.clear.reshape(n, len(PLACES))
    hidden = (~met.clear & ~met.inside).reshape(n, len(PLACES))
    for seer in range(
        len(PLACES)
    ):  # a place that the source sees looks at all that is still hidden, pair by pair at once
        row, target = np.nonzero(hidden & clear[:, seer, None])
        if len(row):
            found = seen(g, place[row, seer], place[row, target])
            hidden[row[found], target[found]] = False
    return np.asarray(~hidden.any(axis=1), dtype=np.bool_)
