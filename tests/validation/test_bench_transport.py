"""The transport bench at tiny sizes: that each side of a ratio does what the row says, and that what is absent is said."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from lightgauge.fastpath.device import open_device
from lightgauge.reference.progress import silent
from lightgauge.reference.transport.accumulate import launch_batch
from lightgauge.reference.transport.form_factors import patch_form_factors, probe_form_factors
from lightgauge.reference.transport.hits import columns_of_rays, upload_patches
from lightgauge.reference.transport.receivers import patch_receivers
from lightgauge.validation.benchmarks import (
    box_rows,
    memory_child,
    memory_rows,
    peer_rows,
    places,
    ray_rows,
    registry,
    relight_rows,
)
from lightgauge.validation.benchmarks.box_rows import Box, Setting, build
from lightgauge.validation.benchmarks.rows import CannotMeasure

CORNELL = ("cornell", 0.25)


def test_bare_rays_are_those_of_the_form_factors() -> None:
    g, p = ray_rows.patched(*CORNELL)
    receivers, rows = patch_receivers(g, p), np.arange(3, p.count)
    device = upload_patches(g, p)
    keys = np.array(launch_batch(g, device, receivers, rows, 64, 8, ray_rows.SEED).keys)
    columns, _ = columns_of_rays(g, device, *ray_rows.rays_in_memory(receivers, rows, 64, 8, ray_rows.SEED))
    assert (keys >> 6 == np.array(columns)).all()
    assert len(np.unique(np.array(columns))) > 20


def test_bare_asks_for_every_ray_in_any_number_of_launches(monkeypatch: pytest.MonkeyPatch) -> None:
    g, p = ray_rows.patched(*CORNELL)
    asked: list[int] = []
    monkeypatch.setattr(ray_rows, "query_seconds", lambda g, origins, directions: asked.append(len(origins.x)) or 1.0)
    for launches in (1, 3):
        asked.clear()
        monkeypatch.setattr(ray_rows, "BARE_RAYS", p.count * 64 // launches)
        assert ray_rows.bare(g, patch_receivers(g, p), 64)(0) == len(asked) == launches
        assert sum(asked) == p.count * 64


def test_rays_against_embree() -> None:
    rows = {r.name: r for r in ray_rows.against_embree(CORNELL, "tiny", 0.8, 2, silent, rays=64)}
    ratio, ours, bare = (rows[f"{kind}_tiny"] for kind in ("rays_vs_embree", "mrays_per_s", "embree_mrays_per_s"))
    assert (ratio.n, ratio.target, ratio.better) == (2, 0.8, "higher")
    assert ours.value > 0.0 and bare.value > 0.0
    one, two = ours.value - 2 * ours.spread, ours.value + 2 * ours.spread  # the two repeats
    below, above = bare.value - 2 * bare.spread, bare.value + 2 * bare.spread
    assert one / above <= ratio.value * 1.001 and ratio.value <= two / below * 1.001


def test_exponent() -> None:
    seconds = np.stack([[2.0 * n**1.3, 1.0] for n in (256, 512, 1024)])
    assert ray_rows.exponents((256, 512, 1024), seconds) == pytest.approx([1.3, 0.0])


def test_memory_of_a_child() -> None:
    values = {r.name: r.value for r in memory_rows.memory(silent, CORNELL, 64)}
    assert tuple(values) == memory_rows.NAMES
    _, p = ray_rows.patched(*CORNELL)
    assert 0.0 < values["memory_matrices_mib"] < p.count * (p.count + 500) * 12 / 2**20
    growth = values["memory_growth_mib"]
    assert 1.0 < growth < 512.0 and values["memory_vs_matrices"] == 0.0  # all within the allowance
    assert values["memory_growth_vs_matrices"] == pytest.approx(growth / values["memory_matrices_mib"])


def test_peak_is_seen_and_forgotten() -> None:
    """Three times, since the system may take other pages of the process away in the meantime."""
    grown = []
    for _ in range(3):
        memory_child.forget_peak()
        before = memory_child.resident("VmHWM")
        held = np.ones(64 << 20, np.uint8)
        grown.append(memory_child.resident("VmHWM") - before)
        del held
        assert memory_child.resident("VmRSS") <= memory_child.resident("VmHWM")
    assert 60 << 20 < max(grown) < 100 << 20


def test_a_child_that_fails_is_said() -> None:
    with pytest.raises(CannotMeasure, match=r"failed \(1\).*no scene 'gone'"):
        memory_rows.measured("gone", 1.0, 64)


def test_scipy_and_the_device_make_the_same_products() -> None:
    g, p = ray_rows.patched(*CORNELL)
    patch_rows = patch_form_factors(g, p, 64, 0, silent)
    probe_rows = probe_form_factors(g, p, np.array([[0.0, 0.5, 0.0], [0.3, 0.4, 0.1]]), 64, 0, silent)
    first, *rest = relight_rows.scipy_products(patch_rows, probe_rows)()  # type: ignore[misc]
    device = open_device()
    light = np.ones((first.shape[0] + relight_rows.SKY_BINS + 1, 3), np.float32)
    ours = [relight_rows.on_device(device, f)(light) for f in (patch_rows, probe_rows)]
    assert first.dtype == np.float32
    np.testing.assert_allclose(ours[0][:, 0], first, rtol=1e-5)
    np.testing.assert_allclose(ours[1], np.stack(rest, axis=1), rtol=1e-4, atol=1e-5)


def test_every_array_is_copied() -> None:
    pairs = relight_rows.copy_arrays(1 << 20)
    assert len(pairs) == relight_rows.COPY_THREADS and all(a.nbytes == b.nbytes == 1 << 20 for a, b in pairs)
    with ThreadPoolExecutor(2) as pool:
        relight_rows.host_copy(pool, pairs)()
    assert all((b == 1.0).all() for _, b in pairs)


def test_cube_in_cube() -> None:
    quads = places.cube_in_cube(2, 1)
    assert quads.shape == (30, 4, 3)
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(6 * 9.0 + 6 * 1.0)
    towards = np.einsum("qc,qc->q", normal, -quads.mean(axis=1))
    assert (towards[:24] > 0.0).all() and (towards[24:] < 0.0).all()


def test_the_published_box_is_the_same_construction(shared_truth: Path) -> None:
    with np.load(shared_truth / box_rows.TRUTH) as z:
        published = z["quads"]
    ours = places.cube_in_cube(5, 3)

    def centres(quads: np.ndarray) -> np.ndarray:
        return np.unique(np.round(quads.mean(axis=1), 9), axis=0)

    np.testing.assert_allclose(centres(ours), centres(published), atol=1e-8)


def test_matrix_is_in_the_order_of_the_quads() -> None:
    quads = places.cube_in_cube(1, 1)
    built = build(places.scene_of_quads(quads), 64, 1e-3, 0)
    f = built.matrix
    np.testing.assert_allclose(f[6:, :6].sum(axis=1), 1.0, atol=1e-6)  # the inner cube sees only the outer one
    np.testing.assert_allclose(f[:6, 6:].sum(axis=1), 1.0 / 9.0, atol=1e-6)  # by reciprocity and symmetry
    assert (f[6:, 6:] == 0.0).all()
    facing = np.einsum("qc,rc->qr", quads[:6].mean(axis=1), quads[6:].mean(axis=1)) > 0.1
    assert (f[:6, 6:][facing] > 0.05).all() and built.se < 1e-3 and built.seconds > 0.0


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Box:
    """A folder of answers with a small box; its matrix is a hybrid of 30 times less noise than what is measured here."""
    quads = places.cube_in_cube(2, 1)
    quads = quads[np.random.default_rng(0).permutation(len(quads))]
    truth = build(places.scene_of_quads(quads), 64, 1e-4, 99).matrix
    (tmp_path / "truth").mkdir()
    (tmp_path / "scenes").mkdir()
    np.savez(tmp_path / "truth" / box_rows.TRUTH, quads=quads, F=truth)
    monkeypatch.setenv("LIGHTGAUGE_SCENES", str(tmp_path / "scenes"))
    return Box(places.scene_of_quads(quads), quads, truth)


def test_curve_skips_what_is_not_wanted(published: Box, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = (Setting("rays_256", 256, None), Setting("rays_64", 64, None), Setting("hybrid_3e-3", 64, 3e-3, 1e-2))
    monkeypatch.setattr(box_rows, "SETTINGS", settings)
    wanted = frozenset({"boxinbox_rays_256_rms", "boxinbox_hybrid_3e-3_s"})
    rows = {r.name: r for r in box_rows.curve(wanted, silent)}
    assert list(rows) == [*settings[0].names, *settings[2].names]
    rays, hybrid = rows["boxinbox_rays_256_rms"], rows["boxinbox_hybrid_3e-3_rms"]
    assert 0.0 < 4.0 * hybrid.value < rays.value < 0.05 and hybrid.target == 1e-2 and rays.n == box_rows.REPEATS


def test_large_box_needs_no_file() -> None:
    rows = {r.name: r for r in box_rows.large(silent, (2, 1), 3e-3, 1)}
    assert set(rows) == {"boxinbox_1920_rms", "boxinbox_1920_s", "boxinbox_1920_cpu_s"}
    assert 0.0 < rows["boxinbox_1920_rms"].value < 3e-3 and "30 quads" in rows["boxinbox_1920_rms"].note


def test_without_published_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("LIGHTGAUGE_SCENES", str(tmp_path / "scenes"))
    monkeypatch.setattr(places, "REPOSITORY", tmp_path / "elsewhere")
    made = registry.run(["transport"], ["boxinbox_hybrid_rms", "error_vs_pyviewfactor"], silent)
    assert made["rows"] == [] and len(made["notes"]) == 2
    for note in made["notes"]:
        assert "published answers boxinbox_204_truth.npz" in note and "To mend it: export LIGHTGAUGE_SCENES=" in note
    assert "not measured: boxinbox_hybrid_rms" in capsys.readouterr().err


def test_without_the_peer(published: Box, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_rows, "PACKAGE", "no_such_package")
    made = registry.run(["transport"], ["speed_vs_pyviewfactor"], silent)
    assert made["rows"] == []
    (note,) = made["notes"]
    assert "no_such_package is not installed. To mend it: " in note and "[bench]" in note


FAKE_PEER = """
import sys, numpy
numpy.save(sys.argv[-2], numpy.eye(len(numpy.load(sys.argv[-3]))) * numpy.arange(30))
print("ready", flush=True)
for count, line in enumerate(sys.stdin):
    if count == 2: sys.exit("worn out")
    print(0.25, flush=True)
"""


def test_peer_protocol(published: Box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "python"
    script.write_text(f"#!{sys.executable}\n{FAKE_PEER}")
    script.chmod(0o755)
    monkeypatch.setattr(peer_rows, "PACKAGE", "numpy")
    monkeypatch.setattr(sys, "executable", str(script))
    with peer_rows.peer(published, tmp_path) as (matrix, task):
        # The obstacle goes last to the peer; its answer comes back in our order.
        inner = np.abs(published.quads).max(axis=(1, 2)) < 1.0
        assert sorted(np.diag(matrix)[inner]) == [24.0, 25.0, 26.0, 27.0, 28.0, 29.0]
        assert (task(0), task(1)) == (0.25, 0.25)
        with pytest.raises(CannotMeasure, match="numpy ended before it answered: worn out"):
            task(2)
        with pytest.raises(CannotMeasure):
            task(3)


def test_the_peer_itself(published: Box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyviewfactor")
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")  # compiling takes twice as long as 30 quads interpreted
    with peer_rows.peer(published, tmp_path) as (matrix, task):
        assert task(0) > 0.0
    error = np.abs(matrix - published.truth)
    assert error.max() < 0.05  # it checks the centres of quads only, and these are large
    unoccluded = (np.abs(published.quads).max(axis=(1, 2)) < 1.0)[:, None] & np.ones(len(matrix), bool)
    assert np.median(error[unoccluded]) < 1e-5
