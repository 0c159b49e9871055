"""Sweeps of a baked scene against the record's own figures, and the tables they make.

The truth is made up (a smooth field with noise): what is tested is that rows describe what they say.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from lightgauge.fastpath.device import open_device
from lightgauge.reference import pipeline
from lightgauge.reference.progress import silent
from lightgauge.reference.truth.path_traced import Estimate
from lightgauge.reference.truth.points import choose_points
from lightgauge.validation.bake import Baked, bake, lifted, sample_points
from lightgauge.validation.ground_truth import GroundTruth
from lightgauge.validation.metrics.dead_edges import dead_jump, fallback_share
from lightgauge.validation.metrics.error import measure_error
from lightgauge.validation.placement_findings import placement_findings
from lightgauge.validation.placement_sweeps import OFFSETS, TOLERANCES, lod_errors, sweep_tables
from lightgauge.validation.record_models import SceneResult
from lightgauge.validation.report.sweep_tables import lod_rows, sweeps_context
from small_scenes import box, scene

SETTINGS: dict[str, Any] = {
    "placement": {"min_voxel": 0.5, "probe_rays": 256},
    "radiosity": {"patch_size": 0.5, "rays": 256},
    "cameras": {
        "near": {"origin": [0.2, 3.7, 0.2], "target": [2.0, 1.0, 2.0]},
        "far": {"origin": [3.8, 3.7, 3.8], "target": [2.0, 0.5, 2.0]},
    },
    "volumes": {"air": {"min": [0.2, 2.5, 0.2], "max": [3.8, 3.8, 3.8]}},
}


@pytest.fixture(scope="module")
def measured() -> tuple[Baked, GroundTruth]:
    """A room with a glowing ceiling and two blocks, a slot of 0.2 m between them, where edges are dead."""
    blocks = [
        box((0.5, 0.6, 0.6), (1.9, 2.2, 3.4), inward=False),
        box((2.1, 0.6, 0.6), (3.5, 2.2, 3.4), inward=False),
    ]
    s = scene([box((0, 0, 0), (4, 4, 4), emission=1.0), *blocks], **SETTINGS)
    surfaces = pipeline.bake_surfaces(s, 0, silent)
    light = pipeline.light_patches(s, surfaces, 0, silent)
    baked = bake(s, open_device(), (surfaces, light), pipeline.place(s, surfaces, 0), 0, silent)
    points = choose_points(s, surfaces.geometry, 300, 0)
    rng = np.random.default_rng(0)
    field = {n: 3.0 + 0.4 * p.positions[:, 1:2] * np.ones(3) for n, p in points.items()}
    estimates = {n: Estimate(f * rng.normal(1.0, 0.05, (8, len(f), 3)), f, 64, 4) for n, f in field.items()}
    return baked, GroundTruth(points, estimates, {}, {}, 4, 0.0, surfaces.geometry)


def with_sampling(baked: Baked, **values: Any) -> Baked:
    sampling = baked.scene.settings.sampling.model_copy(update=values)
    settings = baked.scene.settings.model_copy(update={"sampling": sampling})
    return dataclasses.replace(baked, scene=dataclasses.replace(baked.scene, settings=settings))


def test_the_scenes_own_rows_are_the_records_own_errors(measured: tuple[Baked, GroundTruth]) -> None:
    baked, truth = measured
    rows, gains = sweep_tables(baked, truth, None)
    assert {(r["knob"], r["value"]) for r in rows} >= {("normal_offset", v) for v in OFFSETS} | {
        ("backface_tolerance", v) for v in TOLERANCES
    }
    for name, points in truth.points.items():
        ours = sample_points(baked, points).irradiance.astype(np.float64)
        own = measure_error(ours, truth.estimates[name].irradiance)["relrmse"]
        mine = {r["knob"]: r for r in rows if r["current"] and r["set"] == name}
        # The kernel's twin is as near as rounding.
        assert mine["copies"]["relrmse"]["value"] == pytest.approx(own.value, rel=1e-4)
        assert mine["copies"]["relrmse"]["se"] == pytest.approx(own.se, rel=1e-3)
        if name != "volume":
            assert mine["normal_offset"]["relrmse"]["value"] == own.value
    assert {g["set"] for g in gains} == {"camera", "surface", "camera near", "camera far"}
    for g in gains:
        value = {
            r["value"]: r["relrmse"]["value"] for r in rows if r["knob"] == "normal_offset" and r["set"] == g["set"]
        }
        assert g["best"] == min(value, key=lambda v: value[v])
        assert g["gain"]["value"] == pytest.approx(value[0.0] - value[g["best"]], abs=1e-12)


def test_a_tolerance_of_one_calls_all_probes_valid(measured: tuple[Baked, GroundTruth]) -> None:
    baked, truth = measured
    share = {r["value"]: r["invalid_share"] for r in sweep_tables(baked, truth, None)[0] if "invalid_share" in r}
    assert share[1.0] == 0.0 and list(share.values()) == sorted(share.values(), reverse=True)
    back = baked.probes.rows.back_share
    assert share[0.3] == pytest.approx(float((back > 0.3).mean()))


def test_all_tables_fit_the_record_and_the_page(measured: tuple[Baked, GroundTruth]) -> None:
    baked, truth = measured
    sampled = {n: sample_points(baked, p) for n, p in truth.points.items()}
    found = placement_findings(baked, truth, sampled, 0)
    # A point far outside of the shells sees few backs, and the room is closed: all is known of it.
    assert found.metrics["validity_auc"]["value"] >= 0.99
    record = {"name": "test", "status": "ok", "metrics": found.metrics, **found.tables, "notes": found.notes}
    SceneResult.model_validate(record)
    last = found.tables["lods"][-1]
    own = measure_error(sampled["camera"].irradiance.astype(np.float64), truth.estimates["camera"].irradiance)[
        "relrmse"
    ]
    assert last["probes"] == len(baked.probes.valid) and last["relrmse"]["value"] == own.value
    probes = [r["probes"] for r in found.tables["lods"]]
    assert probes == sorted(probes) and len(probes) == baked.texture.level
    tables = sweeps_context(record)
    assert [t["title"] for t in tables] == [
        "Offset along the normal",
        "Tolerance of back faces",
        "Light copied into dead edges",
    ]
    assert all(len(line["cells"]) == len(t["heads"]) for t in tables for line in t["lines"])
    assert [sum(line["current"] for line in t["lines"]) for t in tables] == [1, 1, 1]
    assert len(lod_rows(record)) == len(probes) and not sweeps_context({}) and not lod_rows({})


def test_copies_shrink_the_jump_at_dead_edges(measured: tuple[Baked, GroundTruth]) -> None:
    baked, truth = measured
    found = placement_findings(baked, truth, {n: sample_points(baked, p) for n, p in truth.points.items()}, 0).metrics
    assert baked.cost["copied_probes"] > 3
    assert found["dead_jump"]["value"] < 0.7 * found["dead_jump_without_copies"]["value"]


def test_the_jump_is_that_of_a_made_up_texture(measured: tuple[Baked, GroundTruth]) -> None:
    """Light that is the same everywhere does not jump; nor is there anything to say without places."""
    baked, _ = measured
    texels = np.zeros_like(baked.texture.texels)
    texels[..., 0] = texels[..., 4] = texels[..., 8] = texels[..., 12] = 1.0
    flat = dataclasses.replace(baked.texture, texels=texels)
    places = np.random.default_rng(0).uniform(0.5, 3.5, (50, 3))
    found = dead_jump(flat, places, np.full(50, flat.level))
    assert found["dead_jump_sup"].value < 1e-6 and found["dead_jump"].n == 50
    assert not dead_jump(flat, places[:0], np.zeros(0, np.int64))


def test_fallback_is_counted(measured: tuple[Baked, GroundTruth]) -> None:
    baked, _ = measured
    rng = np.random.default_rng(0)
    where, dark = rng.uniform(0.1, 3.9, (400, 3)), np.zeros_like(baked.texture.texels)
    texture = dataclasses.replace(baked.texture, texels=dark)
    from lightgauge.reference.volume.sampler import sample

    assert fallback_share(texture, where, sample(texture, where, where)).value == 1.0
    lit = dataclasses.replace(baked.texture, texels=np.ones_like(dark))
    assert fallback_share(lit, where, sample(lit, where, where)).value == 0.0


def test_distance_decides_the_level_of_detail(measured: tuple[Baked, GroundTruth]) -> None:
    """Far serves the finest level everywhere, near the coarsest."""
    baked, truth = measured
    assert not lod_errors(baked, truth)
    points, batches = truth.points["camera"], truth.estimates["camera"].irradiance
    for d0, level in ((100.0, baked.texture.level), (1e-3, 1)):
        found = lod_errors(with_sampling(baked, lod_distance=d0), truth)
        ours = baked.sampler(lifted(baked.scene, baked.texture, points), points.normals, level).irradiance
        assert found["relrmse_lod"].value == measure_error(ours.astype(np.float64), batches)["relrmse"].value
        assert found["lod_coarser_share"].value == float(level == 1)
    some = lod_errors(with_sampling(baked, lod_distance=3.0), truth)
    assert 0.0 < some["lod_coarser_share"].value < 1.0
