"""What the kept ground truth depends on."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightgauge.reference.datatypes import Scene, Sky
from lightgauge.reference.progress import silent
from lightgauge.validation import ground_truth as module
from lightgauge.validation.faults.fault import ROOT
from lightgauge.validation.faults.inject import _holds
from lightgauge.validation.ground_truth import ground_truth, truth_hash
from small_scenes import box, material, quad, scene

CAMERA = {"origin": (0.5, 0.5, 0.9), "target": (0.5, 0.4, 0), "width": 8, "height": 8}
LIGHT = {"type": "point", "position": (0.5, 0.8, 0.5), "intensity": (1, 1, 1)}


def room(albedo: float = 0.5, sky: Sky | None = None, light: dict[str, Any] | None = None, **settings: Any) -> Scene:
    truth = {"noise": 0.5, "max_spp": 512, "points": 16, "picture_spp": 2}
    tables = {"cameras": {"c": CAMERA}, "lights": {"l": light or LIGHT}, "truth": truth, **settings}
    return scene([box((0, 0, 0), (1, 1, 1))], [material(albedo)], sky, **tables)


def test_placement_and_radiosity_do_not_matter() -> None:
    plain = truth_hash(room())
    assert plain == truth_hash(
        room(placement={"min_voxel": 0.1}, radiosity={"rays": 64}, sampling={"normal_offset": 0.2})
    )


def test_the_key_covers_every_file_that_is_imported() -> None:
    """TRUTH_CODE names files, so that others trace no path again: none may be left out, whoever imports it."""
    todo, seen = [ROOT / "validation/ground_truth.py", *(ROOT / "reference/scene").glob("*.py")], set()
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += _imported(path)
    names = {p.relative_to(ROOT).as_posix() for p in seen if p.name != "__init__.py"}
    used = {n for n in names if n.startswith("reference/")}
    assert "reference/sky.py" in used and "reference/transport/direct.py" in used and len(used) > 25
    assert {n for n in used if not any(_holds(part, n) for part in module.TRUTH_CODE)} == set()
    assert all((ROOT / part).exists() for part in module.TRUTH_CODE)
    assert not any(_holds(part, "reference/transport/gather.py") for part in module.TRUTH_CODE)


def _imported(path: Path) -> list[Path]:
    """Our own files that a file imports, wherever in it."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.parents[node.level - 1] / (node.module or "").replace(".", "/")
            found += [folder.with_suffix(".py"), *(folder / f"{alias.name}.py" for alias in node.names)]
    return [f for f in found if f.is_file()]


def test_everything_that_light_meets_matters() -> None:
    moved = room()
    mesh = dataclasses.replace(moved.meshes[0], vertices=moved.meshes[0].vertices * 1.001)
    scenes = [
        room(),
        room(0.51),
        room(light={**LIGHT, "intensity": (1, 1, 1.001)}),
        room(light={**LIGHT, "tag": "input"}),
        room(sky=Sky(np.ones((1, 1, 3), np.float32), 0.0, False)),
        room(sky=Sky(np.ones((1, 1, 3), np.float32), 0.0, True)),
        room(sky=Sky(np.ones((1, 1, 3), np.float32), 5.0, True)),
        room(volumes={"v": {"min": (0.1, 0.1, 0.1), "max": (0.2, 0.2, 0.2)}}),
        room(cameras={"c": {**CAMERA, "fov_deg": 61}}),
        room(truth={"noise": 0.4, "max_spp": 512, "points": 16, "picture_spp": 2}),
        dataclasses.replace(moved, meshes=(mesh,)),
        dataclasses.replace(moved, meshes=(dataclasses.replace(moved.meshes[0], emission=np.ones(3)),)),
        dataclasses.replace(moved, meshes=(dataclasses.replace(moved.meshes[0], lit_by_probes=False),)),
        dataclasses.replace(moved, materials=(material(0.5, two_sided=True),)),
        dataclasses.replace(moved, materials=(material(0.5, truth_bsdf={"type": "conductor"}),)),
    ]
    assert len({truth_hash(s) for s in scenes}) == len(scenes)


def test_second_time_is_recalled_and_equal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    first = ground_truth(room(), 1, silent)
    traced: list[Scene] = []
    build = module.build_truth_scene
    monkeypatch.setattr(module, "build_truth_scene", lambda s: traced.append(s) or build(s))
    second = ground_truth(room(), 1, silent)
    assert not traced, "traced again although nothing changed"
    for name, e in first.estimates.items():
        np.testing.assert_allclose(second.estimates[name].irradiance, e.irradiance, rtol=1e-6)
        np.testing.assert_array_equal(first.points[name].positions, second.points[name].positions)
    ground_truth(room(), 2, silent)
    assert len(traced) == 1, "another seed is another truth"


def test_a_truth_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped at its picture, it has its points: they are not traced again, and gates, which ask for fewer, have theirs."""
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(module, "picture", stopped)
        ground_truth(room(), 1, silent)
    monkeypatch.setattr(module, "estimate", stopped)
    whole = ground_truth(room(), 1, silent)
    assert whole.pictures["c"].mean.mean() > 0.0 and whole.seconds > 0.0
    gated = ground_truth(room(), 1, silent, gated=True)
    assert list(gated.estimates) == ["camera"] and not gated.pictures
    np.testing.assert_allclose(gated.estimates["camera"].mean, whole.estimates["camera"].mean, rtol=1e-6, atol=1e-9)


def test_input_tagged_point_light_is_added_exactly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same room by both tags: the difference of the irradiance is the light's own, I cosθ/d², at every point."""
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    engine, given = ground_truth(room(), 1, silent), ground_truth(room(light={**LIGHT, "tag": "input"}), 1, silent)
    p = engine.points["camera"]
    offset = np.array(LIGHT["position"]) - p.positions
    d = np.linalg.norm(offset, axis=1)
    exact = np.maximum(np.einsum("ni,ni->n", offset, p.normals), 0) / d**3
    difference = given.estimates["camera"].mean - engine.estimates["camera"].mean
    np.testing.assert_allclose(difference, exact[:, None].repeat(3, 1), rtol=1e-4, atol=1e-4)


def test_floor_knows_of_input_tagged_lights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A light from one direction alone: E = E⊥ cosθ, and exact L1 SH gives E⊥ (1/4 + cosθ/2) where it is seen."""
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    sun = {"type": "directional", "direction": (0, -1, 0), "irradiance": (2, 2, 2), "tag": "input"}
    plane = quad([[-5, 0, -5], [-5, 0, 5], [5, 0, 5], [5, 0, -5]])
    camera = {"origin": (0, 2, 3), "target": (0, 0, 0), "width": 8, "height": 8}
    truth = {"noise": 0.5, "max_spp": 512, "points": 16, "picture_spp": 1}
    s = scene([plane], [material(0.5)], lights={"sun": sun}, cameras={"c": camera}, truth=truth)
    found = ground_truth(s, 0, silent).estimates["camera"]
    assert found.l1 is not None
    np.testing.assert_allclose(found.irradiance, 2.0, rtol=1e-5)
    # What the plane itself sends back from below adds 0 on average: ∫ (1/4 + cosθ/2) over the lower half is 0.
    assert found.l1.mean() == pytest.approx(1.5, rel=0.02)
