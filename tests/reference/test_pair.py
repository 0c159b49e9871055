"""Form factors between meshes: which method answers, what the standard error means, and what must be exactly 0."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from chance import standard_errors
from lightgauge.reference.transport.closed_forms import pair
from lightgauge.reference.transport.closed_forms.contour import polygon_form_factor
from lightgauge.reference.transport.closed_forms.pair import LEAST_RAYS, PairFormFactor, mesh_form_factor
from lightgauge.reference.transport.closed_forms.pair_exchange import exchange
from lightgauge.reference.transport.closed_forms.pair_rays import REPLICATES, hit_share, visible_exchange
from lightgauge.reference.transport.closed_forms.planar_cells import cells_of
from lightgauge.reference.transport.closed_forms.shaft import build_blockers

RAYS = 1 << 16


@dataclass(frozen=True, eq=False)
class Shape:
    vertices: np.ndarray
    faces: np.ndarray


def quads(*corners: Any) -> Shape:
    flat = np.concatenate([np.asarray(c, float) for c in corners])
    first = 4 * np.arange(len(corners))[:, None]
    return Shape(flat, np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int32))


def level(x0: float, x1: float, y0: float, y1: float, z: float, up: bool = True) -> np.ndarray:
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return corners if up else corners[::-1]


FLOOR, CEILING = level(0, 1, 0, 1, 0), level(0, 1, 0, 1, 1, up=False)
HALF = level(0.5, 1, 0, 1, 0.5)
OPEN = polygon_form_factor(FLOOR, CEILING)


def box(lower: float, upper: float, inward: bool) -> Shape:
    faces = []
    for axis in range(3):
        for value, side in ((lower, 0), (upper, 1)):
            ring = [(lower, lower), (upper, lower), (upper, upper), (lower, upper)]
            corners = np.zeros((4, 3))
            corners[:, axis] = value
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = np.array(ring).T
            faces.append(corners[::-1] if (side == 1) == inward else corners)
    return quads(*faces)


def test_nothing_between() -> None:
    found = mesh_form_factor(quads(FLOOR), quads(CEILING))
    assert found == PairFormFactor(pytest.approx(OPEN, abs=1e-14), 0.0, 0, "contour", 1.0, 1.0)


@pytest.mark.parametrize(
    "between",
    [level(-1, 2, -1, 2, 0.5), level(-1, 2, -1, 2, 0.5, up=False), level(0, 1, 0, 1, 0.3)],
    ids=["wide", "its back", "just wide enough"],
)
def test_a_plate_that_hides_all(between: np.ndarray) -> None:
    found = mesh_form_factor(quads(FLOOR), quads(CEILING), [quads(between)])
    assert (found.value, found.se, found.rays) == (0.0, 0.0, 0)


def test_half_hidden_from_either_side() -> None:
    """The plate hides exactly half by symmetry; F12 A1 = F21 A2; the plate's winding does not matter."""
    emitter, receiver = quads(FLOOR), quads(CEILING)
    results = [
        mesh_form_factor(emitter, receiver, [quads(HALF)], RAYS, 1),
        mesh_form_factor(emitter, receiver, [quads(HALF[::-1])], RAYS, 2),
        mesh_form_factor(receiver, emitter, [quads(HALF)], RAYS, 3),
    ]
    for found in results:
        assert found.method == "contour+rays" and 0 < found.rays <= RAYS
        assert 0.0 < found.se < 1e-4
        assert abs(found.value - OPEN / 2) <= 4.0 * found.se


@pytest.mark.parametrize("gap", [1e-8, 1e-6, 1e-3])
def test_a_carpet_just_above_the_floor(gap: float) -> None:
    """It sends up what it takes, moved by its height: what is left is the floor's exchange less the carpet's own."""
    carpet = level(0.137, 0.611, 0.233, 0.829, gap)
    taken = 0.474 * 0.596 * polygon_form_factor(carpet, CEILING)
    found = mesh_form_factor(quads(FLOOR), quads(CEILING), [quads(carpet)], 1 << 20, 6)
    assert abs(found.value - (OPEN - taken)) <= 4.0 * found.se < 2e-5


def test_fine_occluders() -> None:
    """A screen of 2 · 40² triangles with one square missing: none of them alone hides much, together they hide all else."""
    lines = np.linspace(-1.0, 2.0, 41)
    squares = [
        level(x0, x1, y0, y1, 0.5)
        for i, (x0, x1) in enumerate(pairwise(lines))
        for j, (y0, y1) in enumerate(pairwise(lines))
        if (i, j) != (20, 20)
    ]
    wide, hole = level(-5, 6, -5, 6, 1, up=False), level(lines[20], lines[21], lines[20], lines[21], 0.5, up=False)
    screen = quads(*squares)
    through = mesh_form_factor(quads(FLOOR), quads(hole), (), RAYS).value
    walls = [level(-5, 6, -5, -1, 0.5), level(-5, 6, 2, 6, 0.5), level(-5, -1, -1, 2, 0.5), level(2, 6, -1, 2, 0.5)]
    caught = mesh_form_factor(quads(FLOOR), quads(wide), [screen, quads(*walls)], 1 << 18, 8)
    assert abs(caught.value - through) <= 4.0 * caught.se + 0.002 * through, "all but a few grazing rays arrive"
    full = mesh_form_factor(quads(FLOOR), quads(CEILING), [quads(*squares, hole)], RAYS)
    assert full.value == 0.0, "no ray slips through a seam"


def test_meshes_hide_from_themselves() -> None:
    """All six faces of the inner cube and of the room: the inner sees only the room; the room sees itself past it."""
    inner, room = box(1.0, 2.0, inward=False), box(0.0, 3.0, inward=True)
    out = mesh_form_factor(inner, room, (), RAYS)
    assert out.value == pytest.approx(1.0, abs=1e-12) and out.method == "contour" and out.se == 0.0
    back = mesh_form_factor(room, inner, (), RAYS)
    assert back.value == pytest.approx(6.0 / 54.0, abs=1e-12) and back.se == 0.0
    itself = mesh_form_factor(room, room, [inner], RAYS, 5)
    assert abs(itself.value - (1.0 - 6.0 / 54.0)) <= 4.0 * itself.se
    assert itself.se < 1e-3 and itself.reverse == itself.value
    assert mesh_form_factor(inner, inner).value == 0.0


def test_a_hollow_mesh_sees_itself() -> None:
    """An open box of five squares: what does not reach the open side arrives at the box, 1 − 1/5."""
    full = box(0.0, 1.0, inward=True)
    five = Shape(full.vertices, full.faces[np.array([k for k in range(12) if k % 6 != 5])])
    found = mesh_form_factor(five, five)
    assert found.value == pytest.approx(0.8, abs=1e-12) and found.method == "contour"


def test_cosine_rays_where_pairs_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the smaller mesh; the larger one's form factor follows by reciprocity."""
    monkeypatch.setattr(pair, "MOST_PAIRS", 0)
    floor, ceiling = quads(FLOOR), quads(level(-1, 2, -1, 2, 0.7, up=False))
    truth = polygon_form_factor(FLOOR, level(-1, 2, -1, 2, 0.7, up=False))
    there, back = (mesh_form_factor(*ends, (), RAYS, 4) for ends in ((floor, ceiling), (ceiling, floor)))
    assert there.method == back.method == "rays" and there.rays == RAYS
    assert abs(there.value - truth) <= 4.0 * there.se and there.se < 1e-3
    assert back.value == pytest.approx(there.value / 9.0, rel=1e-12) and back.se == pytest.approx(there.se / 9.0)
    hidden = mesh_form_factor(floor, ceiling, [quads(level(-9, 9, -9, 9, 0.5))], RAYS)
    assert hidden.value == 0.0 and 0.0 < hidden.se < 1e-4, "not seen by any ray is not proved"
    room = box(0.0, 1.0, inward=True)
    assert mesh_form_factor(room, room, (), RAYS).value == 1.0


def test_runs_repeat_and_seeds_differ() -> None:
    ends = quads(FLOOR), quads(CEILING), [quads(HALF)]
    first, again, other = (mesh_form_factor(*ends, RAYS, seed) for seed in (7, 7, 8))
    assert first == again and first.value != other.value


def test_errors_fall_with_rays() -> None:
    """Sixteen times the rays: at most half the standard error (independent rays would give a quarter)."""
    fin = Shape(np.array([[0.2, 0.1, 0.3], [0.6, 0.9, 0.2], [0.3, 0.5, 0.7]]), np.array([[0, 1, 2]], np.int32))
    wall = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    errors = [mesh_form_factor(quads(FLOOR), quads(wall), [fin], rays, 1).se for rays in (1 << 14, 1 << 18)]
    assert errors[1] < 0.5 * errors[0]


def covered(values: np.ndarray, truth: float) -> float:
    """Share of the intervals value ± 1.96 se that hold `truth`; values (N, 2)."""
    return float((np.abs(values[:, 0] - truth) <= 1.96 * values[:, 1]).mean())


@pytest.mark.parametrize("near", [False, True], ids=["apart", "common edge"])
def test_intervals_of_shadow_rays_cover(near: bool) -> None:
    """95 % intervals over a thousand seeds hold the truth in 92 to 98 % of them.

    Of 200 right ones so many would do so for 19 choices of seeds in 20 (binomial), of a thousand for all but one in 50,000.
    """
    truth, ends = OPEN / 2, [quads(FLOOR), quads(CEILING), quads(HALF)]
    if near:  # a fin in the corner of floor and wall parts the common edge: either side of it sees only itself
        wall = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        fin = np.array([[0.0, 0.4, 0.0], [9.0, 0.4, 0.0], [9.0, 0.4, 9.0], [0.0, 0.4, 9.0]])
        sides = (np.array([1.0, share, 1.0]) for share in (0.4, 0.6))
        truth = sum(side[1] * polygon_form_factor(FLOOR * side, wall * side) for side in sides)
        ends = [quads(FLOOR), quads(wall), quads(fin)]
    cells = [cells_of(m.vertices, m.faces) for m in ends]
    blockers = build_blockers(np.concatenate(cells))
    parts = exchange(cells[0], cells[1], blockers, LEAST_RAYS)
    found = [visible_exchange(blockers, parts, 4 * LEAST_RAYS, seed) for seed in range(1000)]
    values = np.array([(parts.known + f.value, f.se) for f in found])
    assert 0.92 <= covered(values, truth) <= 0.98
    assert abs(values[:, 0].mean() - truth) <= standard_errors(1000) * values[:, 0].std(ddof=1) / math.sqrt(1000)


def test_intervals_of_cosine_rays_cover() -> None:
    """As above."""
    geometry = pair.geometry_of([quads(FLOOR), quads(CEILING), quads(HALF)])
    values = np.array([(f.value, f.se) for f in (hit_share(geometry, 0, 1, 4 * LEAST_RAYS, s) for s in range(1000))])
    assert 0.92 <= covered(values, OPEN / 2) <= 0.98
    assert abs(values[:, 0].mean() - OPEN / 2) <= standard_errors(1000) * values[:, 0].std(ddof=1) / math.sqrt(1000)


def test_bad_values_are_refused() -> None:
    floor = quads(FLOOR)
    for rays in (0, LEAST_RAYS - 1, pair.MOST_RAYS + 1):
        with pytest.raises(ValueError, match="rays must lie in"):
            mesh_form_factor(floor, floor, (), rays)
    with pytest.raises(ValueError, match="needs an area"):
        mesh_form_factor(floor, Shape(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)))


def test_replicates_share_the_rays() -> None:
    assert LEAST_RAYS // REPLICATES >= 32 and pair.DEFAULT_RAYS == 1048576
