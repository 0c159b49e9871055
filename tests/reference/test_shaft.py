"""Proofs of visibility: never wrong where rays can tell, and found for most pairs that are clear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.transport.closed_forms.bounding_tree import build_tree
from lightgauge.reference.transport.closed_forms.contour_batch import pair_form_factors
from lightgauge.reference.transport.closed_forms.planar_cells import cell_areas, cells_of, quarters
from lightgauge.reference.transport.closed_forms.polygon_clip import unit_normals
from lightgauge.reference.transport.closed_forms.segment_walk import blocked
from lightgauge.reference.transport.closed_forms.shaft import build_blockers, classify, unoccluded
from lightgauge.reference.transport.closed_forms.shaft_walk import BLOCKED, CLEAR, MIXED

FLOOR = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
CEILING = FLOOR[::-1] + np.array([0.0, 0.0, 1.0])
PAIR, FOURS = np.array([[0, 1]]), np.array([4, 4])


def mesh_of(quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of quadrilaterals (N, 4, 3)."""
    first = 4 * np.arange(len(quads))[:, None]
    return quads.reshape(-1, 3), np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(
        np.int32
    )


def judged(quads: np.ndarray) -> int:
    """Class of floor and ceiling with these quadrilaterals about."""
    vertices, faces = mesh_of(np.concatenate([[FLOOR, CEILING], quads]))
    return int(classify(build_blockers(cells_of(vertices, faces)), np.stack([FLOOR, CEILING]), FOURS, PAIR)[0])


def hit(origins: np.ndarray, directions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(R,) whether any triangle (T, 3, 3) lies strictly between the ends (Möller and Trumbore 1997), in float64."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(directions[:, None], e2)
    det = (p * e1).sum(-1)
    inverse = 1.0 / np.where(np.abs(det) < 1e-14, np.inf, det)
    t = origins[:, None] - a
    u, q = (t * p).sum(-1) * inverse, np.cross(t, e1)
    v, s = (directions[:, None] * q).sum(-1) * inverse, (e2 * q).sum(-1) * inverse
    return np.asarray(((u >= 0) & (v >= 0) & (u + v <= 1) & (s > 1e-7) & (s < 1 - 1e-7)).any(1))


@pytest.mark.parametrize("seed", range(30))
def test_rays_never_contradict_a_proof(seed: int) -> None:
    """Random triangles and patches, in every third scene axis-aligned patches that touch; patches in the scene or not."""
    rng = np.random.default_rng(seed)
    count, patches = int(rng.integers(1, 12)), 10
    loose = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * rng.uniform(0.05, 0.8)
    polygons = np.zeros((patches, 4, 3))
    for k in range(patches):
        if seed % 3 == 0:
            axis = int(rng.integers(3))
            polygons[k] = np.round(rng.uniform(-1, 1, 3), 1)
            polygons[k][:, (axis + 1) % 3] += np.array([-1, 1, 1, -1]) * 0.2
            polygons[k][:, (axis + 2) % 3] += np.array([-1, -1, 1, 1]) * 0.2
        else:
            axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            angle = np.sort(rng.uniform(0, 2 * np.pi, 4))
            ring = np.outer(np.cos(angle), axes[0]) + np.outer(np.sin(angle), axes[1])
            polygons[k] = rng.uniform(-1, 1, 3) + rng.uniform(0.05, 0.5) * ring
    vertices, faces = loose.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    if seed % 2:
        more, ends = mesh_of(polygons)
        vertices, faces = np.concatenate([vertices, more]), np.concatenate([faces, ends + 3 * count])
    pairs = np.stack(np.triu_indices(patches, 1), axis=1)
    sizes = np.full(patches, 4)
    found = classify(build_blockers(cells_of(vertices, faces)), polygons, sizes, pairs)
    assert np.array_equal(unoccluded(vertices, faces, polygons, sizes, pairs), found == CLEAR)
    normals, triangles = unit_normals(polygons), vertices[faces]
    for (i, j), said in zip(pairs, found, strict=True):
        ends = [rng.dirichlet(np.full(4, 0.5), 500) @ polygons[k] for k in (i, j)]
        way = ends[1] - ends[0]
        facing = (way @ normals[i] > 1e-6) & (way @ normals[j] < -1e-6)
        stopped = hit(ends[0][facing], way[facing], triangles)
        assert said != CLEAR or not stopped.any()
        assert said != BLOCKED or stopped.all()


@pytest.mark.parametrize(
    ("quad", "truth"),
    [
        (FLOOR + np.array([0.0, 0.0, 0.5]), BLOCKED),
        (3.0 * FLOOR + np.array([-1.0, -1.0, 0.5]), BLOCKED),
        (0.5 * FLOOR + np.array([0.0, 0.0, 0.5]), MIXED),
        (FLOOR + np.array([0.0, 0.0, 1e-6]), BLOCKED),
        (0.1 * FLOOR + np.array([0.4, 0.4, 1e-6]), MIXED),
        (FLOOR + np.array([1.0, 0.0, 0.5]), CLEAR),
        (FLOOR + np.array([1.0, 0.0, 0.0]), CLEAR),
        (0.5 * FLOOR, CLEAR),
        (FLOOR - np.array([0.0, 0.0, 0.1]), CLEAR),
        (np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]), CLEAR),
        (np.array([[0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [0.5, 1.0, 1.0], [0.5, 0.0, 1.0]]), MIXED),
    ],
    ids=["fills", "wider", "quarter", "carpet", "tile on the floor", "beside", "floor goes on", "in the floor", "below",
         "wall", "partition"],
)  # fmt: skip
@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_one_surface(quad: np.ndarray, truth: int, shift: float) -> None:
    """The same 1e5 sizes away from the origin, except carpets thinner than coordinates are exact there."""
    vertices, faces = mesh_of(np.stack([FLOOR, CEILING, quad]) + shift)
    blockers = build_blockers(cells_of(vertices, faces))
    assert classify(blockers, np.stack([FLOOR, CEILING]) + shift, FOURS, PAIR)[0] == truth


def test_edges_of_the_section_separate_too() -> None:
    """A triangle whose tip comes near the shaft of two small crossed patches, but not into it, from every side."""
    small = np.stack([FLOOR * 0.1, (FLOOR[::-1] @ np.diag([1.0, -1.0, 1.0]))[::-1] * 0.3 + [0.0, 0.0, 1.0]])
    small[1] = small[1][::-1] if unit_normals(small)[1, 2] > 0 else small[1]
    middle = 0.5 * (small[0].mean(axis=0) + small[1].mean(axis=0))
    for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        reach = max(0.5 * (a + b) @ out for a in small[0] for b in small[1])
        tip = middle + out * (reach - middle @ out + 0.02)
        side = np.array([-out[1], out[0], 0.3])
        for inward, expected in ((0.0, CLEAR), (0.1, MIXED)):
            triangle = np.array([tip - inward * out, tip + out + side, tip + out - side])
            vertices, faces = np.concatenate([small.reshape(-1, 3), triangle]), np.array([[8, 9, 10]], np.int32)
            assert classify(build_blockers(cells_of(vertices, faces)), small, FOURS, PAIR)[0] == expected


def test_cube_in_a_cube(shared_truth: Path) -> None:
    """Of the pairs that published form factors show to be clear, all are proved; none that is not."""
    truth = np.load(shared_truth / "boxinbox_204_truth.npz")
    quads, areas, full = truth["quads"], truth["areas"], truth["F"]
    pairs = np.stack(np.triu_indices(len(quads), 1), axis=1)
    sizes = np.full(len(quads), 4)
    open_flow = pair_form_factors(quads, sizes, pairs)
    flow = full[pairs[:, 0], pairs[:, 1]] * areas[pairs[:, 0]]
    proved = unoccluded(*mesh_of(quads), quads, sizes, pairs)
    assert np.abs(open_flow - flow)[proved].max() < 1e-7 * areas.max()
    clear = (open_flow > 0.0) & (np.abs(open_flow - flow) < 1e-6 * open_flow)
    assert clear.sum() > 9000 and proved[clear].mean() > 0.999


@pytest.mark.parametrize("seed", range(5))
def test_segments(seed: int) -> None:
    """The device's shadow rays say of random segments what each triangle by itself says."""
    rng = np.random.default_rng(seed)
    count = int(10 ** rng.uniform(0.5, 3.0))
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * count ** (-0.4)
    blockers = build_blockers(cells_of(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)))
    import mitsuba as mi  # after build_blockers has chosen the variant

    ends = rng.uniform(-1, 1, (2, 2000, 3))
    ends[1, :50] = ends[0, :50] * [1.0, 1.0, -1.0]  # along an axis
    vectors = [mi.Vector3d(np.ascontiguousarray((e - blockers.centre).T)) for e in ends]
    active = mi.Bool(np.arange(2000) % 7 != 0)
    found = np.array(blocked(blockers.scene, *vectors, mi.Float64(blockers.tolerance), active))
    truth = hit(ends[0], ends[1] - ends[0], corners) & (np.arange(2000) % 7 != 0)
    assert np.array_equal(found, truth) and 0 < truth.sum() < len(truth)


def test_pairs_alone_read_the_same(shared_truth: Path) -> None:
    quads = np.load(shared_truth / "boxinbox_204_truth.npz")["quads"]
    pairs = np.stack(np.triu_indices(len(quads), 1), axis=1)[::997]
    blockers, sizes = build_blockers(cells_of(*mesh_of(quads))), np.full(len(quads), 4)
    together = classify(blockers, quads, sizes, pairs)
    alone = [classify(blockers, quads, sizes, pair[None])[0] for pair in pairs]
    assert np.array_equal(together, alone) and len(set(alone)) == 2
    assert len(classify(blockers, quads, sizes, pairs[:0])) == 0


@pytest.mark.parametrize("count", [1, 2, 3, 17, 200])
def test_tree_reaches_every_box(count: int) -> None:
    """Walk it for random boxes: what is found is what a look at every box finds; a subtree's box holds its boxes."""
    rng = np.random.default_rng(count)
    lower = rng.random((count, 3))
    upper = lower + 0.1 * rng.random((count, 3))
    tree = build_tree(lower, upper)
    assert len(tree.skip) == 2 * count - 1
    assert np.array_equal(np.sort(tree.primitive[tree.primitive >= 0]), np.arange(count))
    for _ in range(20):
        a = rng.random(3) * 0.9
        b = a + 0.3 * rng.random(3)
        node, found = 0, []
        while node < len(tree.skip):
            missed = bool(np.any(tree.lower[node] > b) or np.any(tree.upper[node] < a))
            if not missed and tree.primitive[node] >= 0:
                found.append(int(tree.primitive[node]))
            node = int(tree.skip[node]) if missed else node + 1
        assert sorted(found) == list(np.flatnonzero(np.all(lower <= b, axis=1) & np.all(upper >= a, axis=1)))


def test_empty_tree_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one box"):
        build_tree(np.zeros((0, 3)), np.zeros((0, 3)))


def test_cells_cover_a_mesh_once() -> None:
    """Quadrilaterals where two triangles make a convex one, whatever the vertices' numbers; quarters keep the area."""
    strip = np.stack([FLOOR + np.array([float(k), 0.0, 0.0]) for k in range(4)])
    cells = cells_of(*mesh_of(strip))
    assert len(cells) == 4 and cell_areas(cells).sum() == pytest.approx(4.0)
    assert np.allclose(unit_normals(cells), [0.0, 0.0, 1.0])
    fold = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1e-6]], float)
    bent = cells_of(fold, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    assert len(bent) == 2 and np.all(bent[:, 2] == bent[:, 3]), "not planar: two triangles"
    both = np.concatenate([cells, bent])
    parts = quarters(both)
    assert np.allclose(cell_areas(parts.reshape(-1, 4, 3)).reshape(-1, 4).sum(axis=1), cell_areas(both))
    assert np.all(parts[-1, :, 2] == parts[-1, :, 3]), "triangles stay triangles"
