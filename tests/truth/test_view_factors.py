"""Form factors against published closed forms and values, and against more closed forms of the same kinds.

Polygons that nothing hides are held to 1e-9, occluded ones to 1e-4 and to four standard errors, zeros to 0. Standard
errors come from 32 replicates, so an estimate leaves four of them with a chance of 2.3e-4; over the 17 noisy cases
here that is 0.4 % for the file, drawn once, as the seeds are fixed. Tessellations are held to their own exact answer
where there is one, and to the difference from a coarser tessellation, which is above the error of the finer.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.transport.closed_forms.contour import polygon_form_factor
from lightgauge.reference.transport.closed_forms.lambert import point_form_factor
from lightgauge.reference.transport.closed_forms.pair import PairFormFactor, mesh_form_factor

_spec = importlib.util.spec_from_file_location("primitives", Path(__file__).with_name("primitives.py"))
assert _spec is not None and _spec.loader is not None
primitives = importlib.util.module_from_spec(_spec)
sys.modules["primitives"] = primitives
_spec.loader.exec_module(primitives)

Case = dict[str, Any]
RAYS, SEED = 1 << 20, 20
SCENES = os.environ.get("LIGHTGAUGE_SCENES") or Path(__file__).resolve().parents[2] / ".." / "shared" / "scenes"
PUBLISHED = Path(SCENES) / ".." / "truth" / "viewfactors.json"
CASES: list[Case] = json.loads(PUBLISHED.read_text(encoding="utf-8")) if PUBLISHED.is_file() else []


def kinds(case: Case) -> set[str]:
    return {entry["type"] for entry in case["geometry"]}


def occluded(case: Case) -> bool:
    return any(entry["role"] == "occluder" for entry in case["geometry"])


def some(keep: Any) -> Any:
    """Parametrise over the published cases that `keep` picks, by their ids; the fixture `published` has the contents."""
    return pytest.mark.parametrize("name", [c["id"] for c in CASES if keep(c)])


def is_mesh(case: Case) -> bool:
    return kinds(case) == {"mesh"}


def is_curved(case: Case) -> bool:
    return case["dimension"] == "3d" and not is_mesh(case) and "point" not in kinds(case)


def measured(case: Case, fineness: int = 1, seed: int = SEED) -> PairFormFactor:
    geometry = case["geometry"]
    emitter = primitives.shape_of(geometry[0], fineness)
    receiver = emitter if geometry[1]["type"] == "same" else primitives.shape_of(geometry[1], fineness)
    between = [primitives.shape_of(entry, fineness) for entry in geometry[2:]]
    return mesh_form_factor(emitter, receiver, between, RAYS, seed)


def test_every_published_case_is_in_one_of_the_groups(shared_truth: Path) -> None:
    cases = json.loads((shared_truth / "viewfactors.json").read_text(encoding="utf-8"))
    if not CASES:
        pytest.skip("the published answers are not beside this repository")
    groups = (is_mesh, is_curved, lambda c: "point" in kinds(c), lambda c: c["dimension"] == "2d")
    assert all(sum(bool(group(c)) for group in groups) == 1 for c in cases)
    assert len(cases) == len(CASES)


@some(lambda c: is_mesh(c) and c["F12"] == 0.0)
def test_zeros(name: str, published: dict[str, Case]) -> None:
    found = measured(published[name])
    assert (found.value, found.se, found.rays) == (0.0, 0.0, 0)


@some(lambda c: is_mesh(c) and c["F12"] > 0.0 and not occluded(c))
def test_polygons(name: str, published: dict[str, Case]) -> None:
    case = published[name]
    found = measured(case)
    assert found.method == "contour" and found.se == 0.0
    assert abs(found.value - case["F12"]) <= 1e-9 + case["tolerance"]
    if case["F12"] < 1e-4:  # tiny values: relative
        assert found.value == pytest.approx(case["F12"], rel=1e-8)


@some(lambda c: is_mesh(c) and c["F12"] > 0.0 and occluded(c))
def test_occluded_polygons(name: str, published: dict[str, Case]) -> None:
    """Within four standard errors; as those are of 32 replicates, one case in 3,000 is not, and is looked at with another seed."""
    case = published[name]
    found = measured(case)
    if abs(found.value - case["F12"]) > 4.0 * found.se + case["tolerance"]:
        found = measured(case, seed=SEED + 1)
    error = abs(found.value - case["F12"])
    assert error <= 1e-4
    assert error <= 4.0 * found.se + case["tolerance"]
    assert found.se <= 2.5e-5  # so that an error of 1e-4 shows


@some(lambda c: is_curved(c) and not occluded(c))
def test_primitives(name: str, published: dict[str, Case]) -> None:
    """The coarser tessellation has twice the error of the finer and more: their difference bounds it."""
    case = published[name]
    coarse, fine = measured(case, 0), measured(case, 1 if "sphere_cap" not in kinds(case) else 0)
    bound = max(abs(fine.value - coarse.value), 1e-11)
    assert bound < 3e-6
    assert fine.method == "contour" and abs(fine.value - case["F12"]) <= bound + case["tolerance"]


@some(lambda c: is_curved(c) and occluded(c))
def test_sphere_between_discs(name: str, published: dict[str, Case]) -> None:
    """The tessellated answer is known: all rays that the sphere stops would have reached the disc."""
    case = published[name]
    first, second, ball = (primitives.shape_of(entry, 1) for entry in case["geometry"])
    found = mesh_form_factor(first, second, [ball], RAYS, SEED)
    whole, stopped = mesh_form_factor(first, second), mesh_form_factor(first, ball)
    assert whole.se == 0.0 and stopped.se == 0.0
    tessellated = whole.value - stopped.value
    assert abs(tessellated - case["F12"]) < 2e-6
    assert abs(found.value - tessellated) <= 4.0 * found.se
    assert found.se < 4e-5


@some(lambda c: "point" in kinds(c))
def test_points(name: str, published: dict[str, Case]) -> None:
    """Circles lie between their inscribed and their circumscribed polygon, and so do their form factors."""
    case = published[name]
    point, receiver = case["geometry"]
    position, normal = (np.asarray(point[k], float) for k in ("position", "normal"))
    if receiver["type"] == "mesh":
        polygon = np.asarray(receiver["vertices"], float)[receiver["faces"][0]]
        assert point_form_factor(position, normal, polygon) == pytest.approx(case["F12"], abs=1e-12)
        return
    centre, radius = np.asarray(receiver["center"], float), receiver["radius"]
    axis = centre - position if receiver["type"] == "sphere" else -np.asarray(receiver["normal"], float)
    if receiver["type"] == "sphere":  # the circle in which the tangents touch covers what the sphere covers
        distance = float(np.linalg.norm(axis))
        centre = position + axis * (1.0 - (radius / distance) ** 2)
        radius *= math.sqrt(1.0 - (radius / distance) ** 2)
    n = 1 << 15
    outline = primitives.ring(centre, -axis, radius / primitives.equal_area(n), n)
    low, high = (
        point_form_factor(position, normal, centre + scale * (outline - centre))
        for scale in (1.0, 1.0 / math.cos(math.pi / n))
    )
    slack = case["tolerance"] + 1e-12
    assert low - slack <= case["F12"] <= high + slack and high - low < 1e-6


@some(lambda c: c["dimension"] == "2d")
def test_two_dimensions(name: str, published: dict[str, Case]) -> None:
    """Long extrusions: the loss at the ends falls like 1 / length, so two lengths give the limit."""
    case = published[name]

    def limit(fineness: int) -> float:
        def at(length: float) -> float:
            shapes = [
                primitives.tube(e["center"], e["radius"], 128 << fineness, length)
                if e["type"] == "circle2d"
                else primitives.extruded(e["a"], e["b"], length)
                for e in case["geometry"]
            ]
            return mesh_form_factor(*shapes).value

        return 2.0 * at(4e3) - at(2e3)

    coarse, fine = limit(0), limit(1)
    assert abs(fine - coarse) < 1e-5
    assert abs(fine - case["F12"]) <= max(abs(fine - coarse), 1e-9)


def opposite(a: float, b: float, c: float) -> float:
    """C-11: two equal a × b rectangles at distance c, opposite each other."""
    x, y = a / c, b / c
    p, q = math.sqrt(1.0 + x * x), math.sqrt(1.0 + y * y)
    total = 0.5 * math.log(p * p * q * q / (1.0 + x * x + y * y))
    total += x * q * math.atan(x / q) + y * p * math.atan(y / p) - x * math.atan(x) - y * math.atan(y)
    return 2.0 * total / (math.pi * x * y)


def perpendicular(width: float, height: float, length: float) -> float:
    """C-14: from a rectangle `width` × `length` to one `height` × `length` that stands on its edge `length`."""
    w, h = width / length, height / length
    w2, h2, s = w * w, h * h, 1.0 + w * w + h * h
    r = math.sqrt(w2 + h2)
    logs = math.log((1.0 + w2) * (1.0 + h2) / s)
    logs += w2 * math.log(w2 * s / ((1.0 + w2) * (w2 + h2))) + h2 * math.log(h2 * s / ((1.0 + h2) * (w2 + h2)))
    total = w * math.atan(1.0 / w) + h * math.atan(1.0 / h) - r * math.atan(1.0 / r) + 0.25 * logs
    return total / (math.pi * w)


def coaxial(r1: float, r2: float, h: float) -> float:
    """C-41: from a disc of radius r1 to a coaxial one of radius r2 at distance h."""
    s = 1.0 + (1.0 + (r2 / h) ** 2) / (r1 / h) ** 2
    return 0.5 * (s - math.sqrt(s * s - 4.0 * (r2 / r1) ** 2))


def rectangle(corner: Any, u: Any, v: Any) -> np.ndarray:
    c, u, v = (np.asarray(x, float) for x in (corner, u, v))
    return np.array([c, c + u, c + u + v, c + v])


def turned(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random rotation and shift."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q)), rng.normal(size=3)


@pytest.mark.parametrize("seed", range(40))
def test_rectangles_of_any_size(seed: int) -> None:
    """Sizes and gaps over two decades, turned at random; the closed forms themselves cancel by up to four digits."""
    rng = np.random.default_rng([seed, 1])
    rotation, shift = turned(seed)
    a, b, c = 10.0 ** rng.uniform(-1.0, 1.0, 3)
    floor = rectangle([0, 0, 0], [a, 0, 0], [0, b, 0])
    if seed % 2:
        other, truth = rectangle([0, 0, c], [0, b, 0], [a, 0, 0]), opposite(a, b, c)
    else:
        other, truth = rectangle([0, 0, 0], [0, b, 0], [0, 0, c]), perpendicular(a, c, b)
    emitter, receiver = (x @ rotation.T + shift for x in (floor, other))
    assert polygon_form_factor(emitter, receiver) == pytest.approx(truth, abs=1e-11)
    mesh = [primitives.polygons(x, [[0, 1, 2, 3]]) for x in (emitter, receiver)]
    found = mesh_form_factor(*mesh)
    assert found.method == "contour" and found.value == pytest.approx(truth, abs=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_coaxial_discs(seed: int) -> None:
    r1, r2, h = 10.0 ** np.random.default_rng([seed, 2]).uniform(-0.5, 0.5, 3)
    found = [
        mesh_form_factor(primitives.disc([0, 0, 0], [0, 0, 1], r1, n), primitives.disc([0, 0, h], [0, 0, -1], r2, n))
        for n in (32, 64)
    ]
    assert abs(found[1].value - found[0].value) < 2e-4
    assert abs(found[1].value - coaxial(r1, r2, h)) <= abs(found[1].value - found[0].value) + 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_crossed_strings(seed: int) -> None:
    """Two strips that see each other whole: (crossed − uncrossed strings) / twice the emitter's width (Hottel 1954)."""
    rng = np.random.default_rng([seed, 3])
    a, b = np.array([0.0, 0.0]), np.array([1.0, 0.0])
    hidden = True
    while hidden:  # where the upper strip's plane meets the lower one
        c = np.array([rng.uniform(0.5, 1.5), rng.uniform(0.3, 1.0)])
        d = c + np.array([-rng.uniform(0.2, 1.0), rng.uniform(-0.2, 0.5)])
        (x, y), (nx, ny) = d - c, c
        hidden = any(x * (end[1] - ny) - y * (end[0] - nx) < 0.0 for end in (a, b))
    truth = (math.dist(a, c) + math.dist(b, d) - math.dist(a, d) - math.dist(b, c)) / 2.0
    strips = [[primitives.extruded(*ends, length) for ends in ((a, b), (c, d))] for length in (2e3, 4e3)]
    short, long = (mesh_form_factor(*pair).value for pair in strips)
    assert 2.0 * long - short == pytest.approx(truth, abs=1e-6)


def plate(x0: float, x1: float, y0: float, y1: float, z: float, up: bool) -> Any:
    corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
    return primitives.polygons(corners, [[0, 1, 2, 3] if up else [3, 2, 1, 0]])


@pytest.mark.parametrize("seed", range(6))
def test_plates_and_apertures(seed: int) -> None:
    """The receiver catches whatever comes by: F12 = F(1 → 2) − F(1 → plate), or F(1 → hole) behind a wide screen."""
    rng = np.random.default_rng([seed, 4])
    x, y, z = rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(0.3, 0.7)
    w, h = rng.uniform(0.1, 0.4, 2)
    emitter, receiver = plate(-0.5, 0.5, -0.5, 0.5, 0.0, True), plate(-9, 9, -9, 9, 1.0, False)
    square = plate(x - w, x + w, y - h, y + h, z, False)
    through = mesh_form_factor(emitter, square).value
    if seed % 2:
        between = [square]
        truth = mesh_form_factor(emitter, receiver).value - through
    else:
        between = [
            plate(-40, x - w, -40, 40, z, True), plate(x + w, 40, -40, 40, z, True),
            plate(x - w, x + w, -40, y - h, z, True), plate(x - w, x + w, y + h, 40, z, True),
        ]  # fmt: skip
        truth = through
    found = mesh_form_factor(emitter, receiver, between, 4 * RAYS, SEED)  # a second; 1e-4 is then five standard errors
    assert abs(found.value - truth) <= min(1e-4, 4.0 * found.se)
