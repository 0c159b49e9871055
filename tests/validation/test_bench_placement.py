"""The rows of `bench placement`, on a valley of coarse voxels: what they count, and that pieces are the same work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from lightgauge.reference import pipeline
from lightgauge.reference.datatypes import Sky
from lightgauge.reference.lattice import distinct
from lightgauge.reference.progress import silent
from lightgauge.validation.benchmarks import place_rows, registry
from lightgauge.validation.benchmarks.place_rows import Place, array_bytes, corner_cost, fine_valley, memory, staged
from small_scenes import box, scene

PROMISED = ("valley_place_s", "corner_cost_ratio_1e6_1e4")


@pytest.fixture(scope="module")
def valley() -> Place:
    return fine_valley(8.0)


def test_placement_has_the_promised_rows_once() -> None:
    names = [name for group in registry.placement() for name in group.names]
    assert set(PROMISED) <= set(names) and len(set(names)) == len(names)


def test_all_of_the_valley_is_asked_for_at_one_size(valley: Place) -> None:
    """Terrain, houses and the walkable volume: the bitmap's finest level holds whatever is marked at all."""
    assert {mesh.probe_size for mesh in valley.scene.meshes} == {8.0} == {valley.grid.finest}
    assert {v.probe_size for v in valley.scene.settings.volumes.values()} == {8.0}
    marks = pipeline.bitmap(valley.scene, valley.grid)
    held = marks.occupied[-1]
    assert len(held) > 5_000 and marks.notes == ()


def test_seconds_are_those_of_the_stages(valley: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that moves by one second whenever it is read: four stages are four seconds."""
    ticks = iter(range(100))
    monkeypatch.setattr(place_rows.time, "perf_counter", lambda: float(next(ticks)))
    (row,) = staged(valley, silent, repeats=2)
    assert (row.name, row.value, row.n, row.target) == ("valley_place_s", 4.0, 2, 10.0)
    assert all(f"{stage} 1.00 s" in row.note for stage in place_rows.STAGES)
    tree = place_rows._place(valley)[0]
    assert f"{len(tree.corners)} probes, {tree.corners_tested} corners tested" in row.note
    assert f"plain subdivision would place {tree.plain_probes} probes" in row.note and tree.plain_probes > len(
        tree.corners
    )


def test_pieces_are_the_bitmap_cut_up(valley: Place) -> None:
    marks = pipeline.bitmap(valley.scene, valley.grid)
    parts = place_rows.pieces(marks, valley.grid, 3)
    assert len(parts) == 9
    for level, every in enumerate(marks.occupied):
        together = np.concatenate([part.occupied[level] for part in parts])
        np.testing.assert_array_equal(distinct(together), every)
    assert sum(len(part.occupied[-1]) for part in parts) == len(marks.occupied[-1])


def test_cost_of_a_corner(valley: Place) -> None:
    (row,) = corner_cost(valley, silent, sides=2, repeats=1)
    assert row.name == "corner_cost_ratio_1e6_1e4" and row.target == 1.25 and 0.05 < row.value < 20
    assert "against 4 pieces of " in row.note


def test_against_embree(valley: Place) -> None:
    (row,) = place_rows.against_embree(valley, silent, sample=2_000, repeats=1)
    assert row.name == "corner_rays_vs_embree" and row.target is None and 0.01 < row.value < 10


def test_array_bytes() -> None:
    @dataclass(frozen=True)
    class Thing:
        whole: object
        parts: object
        other: object = 3.0

    thing = Thing(np.zeros(5), (np.zeros((2, 3), np.int32), np.zeros(7, np.uint8), "text"))
    assert array_bytes(thing, thing) == 2 * (40 + 24 + 7)


def test_memory_of_a_bake() -> None:
    sky = Sky(np.ones((1, 1, 3), np.float32), 0.0, False)
    room = scene(
        [box((0, 0, 0), (2, 2, 2), inward=False, name="block")], sky=sky,
        radiosity={"patch_size": 1.0, "rays": 64}, placement={"min_voxel": 0.5, "probe_rays": 128},
    )  # fmt: skip
    (row,) = memory(room, silent)
    assert row.name == "memory_per_probe_bytes" and row.unit == "B" and row.target is None
    each = [float(part.split()[1]) for part in row.note.split(";")[1].split(",")]
    assert sum(each) == pytest.approx(row.value, abs=2) and min(each) > 0
