"""Copies into dead edges: where they are made, where they must not be, and what they mend (failure-catalogue D5, D6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from lightgauge.reference.datatypes import Bool, Mesh
from lightgauge.reference.lattice import OCTANTS, Octree, index_of, keys, make_grid
from lightgauge.reference.placement import dead_edges as module
from lightgauge.reference.placement.dead_edges import BESIDE, dead_edges, exposed, light_from
from lightgauge.reference.placement.octree import uniform_octree
from lightgauge.reference.placement.segments import crossings, seen
from lightgauge.reference.placement.validity import back_share
from lightgauge.reference.visibility import Geometry, build_geometry
from lightgauge.reference.volume.sampler import sample
from lightgauge.reference.volume.tiles import probe_texels, with_copies
from small_scenes import box, material, quad, random_tree, scene, texture_of

TOLERANCE = 0.1
Placed = tuple[Geometry, Octree, Bool]


def placed(meshes: Sequence[Mesh], voxel: float, two_sided: bool = False) -> Placed:
    """Geometry, a uniform grid over it and which of its probes are valid. Material 1 is a sheet's."""
    g = build_geometry(scene(meshes, [material(), material(two_sided=two_sided)]))
    tree = uniform_octree(make_grid(g.lower, g.upper, voxel))
    return g, tree, back_share(g, tree.positions, 0) <= TOLERANCE


def room(*more: Mesh) -> list[Mesh]:
    return [box((0, 0, 0), (4, 4, 4)), *more]


def slot() -> list[Mesh]:
    """Two blocks with a slot of 0.2 m between them, voxels of 0.5 m: edges across it have both ends in the blocks."""
    return room(
        box((0.5, 0.6, 0.6), (1.9, 2.2, 3.4), inward=False), box((2.1, 0.6, 0.6), (3.5, 2.2, 3.4), inward=False)
    )


@pytest.fixture(scope="module")
def mended() -> tuple[Placed, np.ndarray]:
    p = placed(slot(), 0.5)
    return p, light_from(*p, TOLERANCE, 0)


def test_dead_edges_are_all_edges_of_voxels_without_a_valid_end() -> None:
    tree = random_tree(4, 0.4, 3)
    valid = np.random.default_rng(3).random(len(tree.corners)) > 0.5
    number = {tuple(c): i for i, c in enumerate(tree.corners.tolist())}
    expected = set()
    for level, voxels in enumerate(tree.voxels):
        scale = 1 << (tree.grid.level - level)
        for voxel in voxels:
            ends = [number[tuple(((voxel + o) * scale).tolist())] for o in OCTANTS]
            pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(OCTANTS[a] - OCTANTS[b]).sum() == 1]
            dead = [p for p in pairs if not valid[ends[p[0]]] and not valid[ends[p[1]]]]
            expected |= {(level, *sorted((ends[a], ends[b]))) for a, b in dead}
    found = dead_edges(tree, valid)
    got = [(int(n), *sorted(e)) for n, e in zip(found.level, found.ends.tolist(), strict=True)]
    assert len(got) == len(set(got)) and set(got) == expected
    assert not len(dead_edges(tree, np.ones_like(valid)).level)


def test_segments_count_what_they_enter_leave_and_pass() -> None:
    g = build_geometry(
        scene(
            [box((1, 1, 1), (2, 2, 2), inward=False), quad([(3, 0, 0), (3, 4, 0), (3, 4, 4), (3, 0, 4)], mat=1)],
            [material(), material(two_sided=True)],
        )
    )
    ends = np.array([[0.5, 1.5, 1.5], [1.5, 1.4, 1.5], [2.5, 1.5, 1.5], [3.5, 1.4, 1.5], [3.5, 3.5, 3.5]])
    found = crossings(g, np.repeat([[0.0, 1.6, 1.6]], 5, axis=0), ends)
    assert found.entered.tolist() == [0, 1, 1, 1, 0]
    assert found.left.tolist() == [0, 0, 1, 1, 0]
    assert found.passed.tolist() == [0, 0, 0, 1, 1]
    assert found.clear.tolist() == [True, False, False, False, False]
    assert found.inside.tolist() == [False, True, False, False, False]
    assert found.through.tolist() == [False, False, True, True, True]


def test_seen_is_clear() -> None:
    g = placed(slot(), 0.5)[0]
    a, b = np.random.default_rng(0).uniform(0.05, 3.95, (2, 3000, 3))
    clear = crossings(g, a, b).clear
    assert 0.2 < clear.mean() < 0.8
    np.testing.assert_array_equal(seen(g, a, b), clear)
    np.testing.assert_array_equal(seen(g, a[:1], b[:1]), clear[:1])


def test_a_slot_narrower_than_a_voxel_is_lit(mended: tuple[Placed, np.ndarray]) -> None:
    """At its mouths probes are adjacent that see into it; deep inside there are none, and nothing is invented."""
    (g, tree, valid), source = mended
    np.testing.assert_array_equal(source[valid], np.flatnonzero(valid))
    copies = np.flatnonzero((source >= 0) & ~valid)
    edges = exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0)
    assert set(copies.tolist()) <= set(edges.ends.ravel().tolist()) and valid[source[copies]].all()
    step = np.abs(tree.corners[copies] - tree.corners[source[copies]]).max(axis=1)
    assert len(copies) > 5 and (step == 1 << (tree.grid.level - tree.corner_level[copies])).all()
    finest = edges.ends[edges.level == tree.grid.level]
    y = tree.positions[finest[:, 0], 1]
    bridged = (source[finest] >= 0).any(axis=1)
    assert bridged[y > 1.7].all() and bridged[y < 1.0].all() and not bridged[(y > 1.0) & (y < 1.7)].all()


def test_no_edge_gets_two_copies_for_nothing(mended: tuple[Placed, np.ndarray]) -> None:
    """Each copy is the only light of at least one dead edge."""
    (g, tree, valid), source = mended
    ends = exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0).ends
    has = source[ends] >= 0
    lone = ends[has.sum(axis=1) == 1][has[has.sum(axis=1) == 1]]
    assert set(np.flatnonzero((source >= 0) & ~valid).tolist()) <= set(lone.tolist())


def test_samples_on_a_mended_edge_no_longer_fall_to_the_level_above(mended: tuple[Placed, np.ndarray]) -> None:
    (g, tree, valid), source = mended
    ends = exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0)
    finest = ends.ends[(ends.level == tree.grid.level) & (source[ends.ends] >= 0).any(axis=1)]
    x = 2.0
    a, b = tree.positions[finest[:, 0]], tree.positions[finest[:, 1]]
    across = (a[:, 0] < x) & (b[:, 0] > x)
    where = np.where([True, False, False], x, a)[across]
    light = np.random.default_rng(0).random((len(valid), 4, 3)).astype(np.float32)
    n = np.tile([0.0, 1.0, 0.0], (len(where), 1))
    own = np.where(valid, np.arange(len(valid)), -1).astype(np.int32)
    before, after = (sample(texture_of(tree, probe_texels(*with_copies(light, s)))[0], where, n) for s in (own, source))
    assert len(where) > 3 and (before.level < tree.grid.level).all() and (after.level == tree.grid.level).all()
    lender = source[finest[across]].max(axis=1)  # the other end has none
    mean = sample(texture_of(tree, probe_texels(*with_copies(light, source)))[0], where, 0 * n).irradiance
    np.testing.assert_allclose(mean, np.sqrt(np.pi) / 2 * light[lender, 0], rtol=1e-4)


def hidden_from_source(placed: Placed, source: np.ndarray) -> int:
    """Valid corners that share a voxel with a copy, at the copy's own level, and that its source does not see."""
    g, tree, valid = placed
    copies = np.flatnonzero((source >= 0) & ~valid)
    count = 0
    for p in copies:
        step = 1 << (tree.grid.level - tree.corner_level[p])
        near = index_of(keys(tree.corners), keys(tree.corners[p] + step * BESIDE))
        near = near[(near >= 0) & valid[near] & (near != source[p])]
        at = tree.positions
        count += int((~seen(g, np.repeat(at[source[p]][None], len(near), axis=0), at[near])).sum())
    return count


@pytest.mark.parametrize("thickness", [0.1, 0.3])
def test_light_is_not_copied_through_a_wall(thickness: float) -> None:
    """A slot that opens to one side of a wall, or to a sealed room behind it: lenders stand on the slot's own side."""
    lit, dark = box((0, 0, 0), (2, 4, 4)), box((2 + thickness, 0, 0), (4, 4, 4))
    blocks = [
        box((2 + thickness + 0.05, 0.6, 0.6), (2.9, 3.4, 3.4), inward=False),
        box((3.1, 0.6, 0.6), (3.95, 3.4, 3.4), inward=False),
    ]
    p = placed([lit, dark, *blocks], 0.35)
    source = light_from(*p, TOLERANCE, 0)
    g, tree, valid = p
    assert len(exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0).level), "something to mend"
    copies = np.flatnonzero((source >= 0) & ~valid)
    assert hidden_from_source(p, source) == 0
    # Whatever lies in the sealed room must read exactly 0 where only the lit room's probes shine, as it does without copies.
    shine = (tree.positions[:, 0] < 2)[:, None, None] * np.ones((1, 4, 3), np.float32)
    rng = np.random.default_rng(1)
    where = rng.uniform((2 + thickness, 0, 0), (4, 4, 4), (4000, 3))
    where = where[back_share(g, where, 2) <= TOLERANCE]
    own = np.where(valid, np.arange(len(valid)), -1).astype(np.int32)
    normals = np.zeros_like(where)
    before, after = (
        sample(texture_of(tree, probe_texels(*with_copies(shine.astype(np.float32), s)))[0], where, normals).irradiance
        for s in (own, source)
    )
    assert ((after > 0) <= (before > 0)).all(), f"{len(copies)} copies"


def test_light_is_not_copied_into_a_cavity_that_holds_no_probe() -> None:
    """A sealed crack of 0.2 m, 0.4 m behind the wall of a lit room: no valid corner there tells that it is another place."""
    p = placed([box((0, 0, 0), (2, 4, 4)), box((2.4, 0.5, 0.5), (2.6, 3.5, 3.5))], 0.5)
    g, tree, valid = p
    crack = np.random.default_rng(0).uniform((2.4, 0.5, 0.5), (2.6, 3.5, 3.5), (500, 3))
    edges = exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0)
    beside = index_of(keys(tree.corners), keys(tree.corners[edges.ends[:, 0]] - [1, 0, 0]))
    assert len(edges.level) > 10 and valid[beside[edges.level == tree.grid.level]].any(), "lenders beside dead edges"
    source = light_from(*p, TOLERANCE, 0)
    texels = probe_texels(*with_copies(np.ones((len(valid), 4, 3), np.float32), source))
    assert (sample(texture_of(tree, texels)[0], crack, np.zeros_like(crack)).level < tree.grid.level).any()
    assert not ((source >= 0) & ~valid).any()


def lidded() -> Placed:
    """The slot with its mouths shut by two-sided sheets, 0.05 m off the blocks: the probes beyond see nothing of it."""
    lids = [quad([(0.2, y, 0.2), (3.8, y, 0.2), (3.8, y, 3.8), (0.2, y, 3.8)], mat=1) for y in (0.55, 2.25)]
    ends = [quad([(0.2, 0.55, z), (3.8, 0.55, z), (3.8, 2.25, z), (0.2, 2.25, z)], mat=1) for z in (0.55, 3.45)]
    return placed([*slot(), *lids, *ends], 0.5, two_sided=True)


def test_a_sheet_without_an_inside_is_not_passed() -> None:
    g, tree, valid = p = lidded()
    source = light_from(*p, TOLERANCE, 0)
    across = (np.abs(tree.positions - [2.0, 1.4, 2.0]) < [0.5, 0.8, 1.4]).all(axis=1)
    assert len(exposed(g, tree, dead_edges(tree, valid), TOLERANCE, 0).level)
    assert not ((source >= 0) & ~valid & across).any()


def test_the_way_to_the_probe_alone_already_forbids(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what lies around the probe not asked about."""
    monkeypatch.setattr(module, "allowed", lambda g, tree, valid, pairs: np.ones(len(pairs), np.bool_))
    g, tree, valid = p = lidded()
    source = light_from(*p, TOLERANCE, 0)
    copies = np.flatnonzero((source >= 0) & ~valid)
    at = tree.positions
    met = crossings(g, at[source[copies]], at[copies])
    assert len(copies) and not (met.left + met.passed).any()


def test_nothing_is_copied_within_solid_walls() -> None:
    g, tree, valid = placed([box((0, 0, 0), (4, 4, 4)), box((-1, -1, -1), (5, 5, 5), inward=False)], 0.4)
    assert len(dead_edges(tree, valid).level) > 1000
    np.testing.assert_array_equal(light_from(g, tree, valid, TOLERANCE, 0), np.where(valid, np.arange(len(valid)), -1))
