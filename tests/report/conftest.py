"""Plausible made-up pictures and records: a room with a box, no renderer needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lightgauge.validation.record import metric
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.pictures import CameraPictures, CameraPose, ProbeDots, SceneView

POSE = CameraPose((2.0, 2.2, 8.5), (2.0, 1.6, 0.0), (0.0, 1.0, 0.0), 42.0, 256, 192)


def rays(pose: CameraPose) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) and unit directions (H, W, 3) through the pixel centres."""
    origin, target, up = (np.asarray(v, float) for v in (pose.origin, pose.target, pose.up))
    forward = (target - origin) / np.linalg.norm(target - origin)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    half = np.tan(np.radians(pose.fov_deg) / 2)
    x = ((np.arange(pose.width) + 0.5) / pose.width * 2 - 1) * half
    y = -((np.arange(pose.height) + 0.5) * 2 - pose.height) / pose.width * half
    d = forward + x[None, :, None] * right + y[:, None, None] * np.cross(right, forward)
    return origin, d / np.linalg.norm(d, axis=-1, keepdims=True)


def room(pose: CameraPose, size: float = 4.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inside of the cube 0..size, open at z = size: hit (H, W), depth (H, W), albedo (H, W, 3)."""
    origin, d = rays(pose)
    depth = np.full(d.shape[:2], np.inf)
    albedo = np.zeros(d.shape)
    colours = {(0, 0): (0.6, 0.07, 0.05), (0, 1): (0.12, 0.45, 0.1)}
    for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1), (2, 0)):
        t = (size * side - origin[axis]) / np.where(d[..., axis] == 0, 1e-12, d[..., axis])
        p = origin + t[..., None] * d
        inside = ((p > -1e-6) & (p < size + 1e-6)).all(axis=-1) & (t > 0) & (t < depth)
        depth = np.where(inside, t, depth)
        albedo = np.where(inside[..., None], colours.get((axis, side), (0.72, 0.7, 0.66)), albedo)
    return np.isfinite(depth), depth, albedo


def make_view(scene: str, camera: str, seed: int = 0, pose: CameraPose = POSE, noise: float = 0.08) -> SceneView:
    rng = np.random.default_rng(seed)
    hit, depth, albedo = room(pose)
    origin, d = rays(pose)
    p = np.where(hit[..., None], origin + np.where(hit, depth, 0)[..., None] * d, 0.0)
    base = 2.5 + 2.0 * np.exp(-((p[..., :1] - 0.4) ** 2)) * (1.2, 0.5, 0.4) + 1.5 * p[..., 1:2] / 4 + 0.2 * p[..., 2:]
    truth = base * (1 + noise * rng.standard_normal(base.shape[:2])[..., None])
    wrong = 0.12 * np.sin(2.2 * p[..., 0] + seed) * np.cos(1.7 * p[..., 1]) - 0.3 * np.exp(-8 * p[..., 1] ** 2)
    ours = base * (1 + wrong[..., None])
    mask = hit[..., None]
    pictures = CameraPictures(
        scene, camera, np.where(mask, truth, 0).astype(np.float32), np.where(mask, ours, 0).astype(np.float32), hit,
        albedo.astype(np.float32), noise, depth.astype(np.float32),
    )  # fmt: skip
    return SceneView(pictures, pose, make_dots())


def make_dots() -> ProbeDots:
    """Three levels in the room, finer towards the floor and the left wall."""
    found: list[tuple[np.ndarray, int]] = []
    for level, n in enumerate((3, 5, 9)):
        axis = np.linspace(0.02, 3.98, n)
        grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        keep = (grid[:, 1] < 4.1 / 2**level) | (grid[:, 0] < 4.1 / 4**level)
        found.append((grid[keep], level))
    positions = np.concatenate([g for g, _ in found]).astype(np.float32)
    level = np.concatenate([np.full(len(g), n) for g, n in found]).astype(np.int32)
    kind = np.where(positions[:, 1] < 0.05, 2, np.where((level == 2) & (positions[:, 0] > 3.0), 1, 0)).astype(np.uint8)
    return ProbeDots(positions, level, kind)


def make_scene(name: str, error: float = 0.11, floor: float = 0.094, **extra: Any) -> JsonObject:
    m: dict[str, Any] = {}
    for suffix, k in (("", 1.0), ("_surface", 1.15), ("_volume", 0.8)):
        m[f"relrmse{suffix}"] = metric(error * k, error * k * 0.03, 2099)
        m[f"bias{suffix}"] = metric(-0.012 * k, 0.002, 2099)
        m[f"p99{suffix}"] = metric(error * 3.1 * k, error * 0.2, 2099)
        m[f"floor_l1{suffix}"] = metric(floor * k, floor * 0.015, 2099)
        m[f"reference_noise{suffix}"] = metric(0.0171 * k, None, 2099)
    m["relrmse_over_floor"] = metric(error / floor, 0.03, 2099)
    m |= {
        "seam_sup": metric(3.1e-7, None, 48211), "seam_p99": metric(0.0, None, 48211),
        "seam_sup_half": metric(1.42e-3, None, 48211), "seam_sup_half8": metric(0.0173, None, 48211),
        "energy_residual": metric(2.1e-4, None, 2503), "gradient_jump": metric(0.31, 0.05, 512, unit="1/m"),
    }  # fmt: skip
    cost = {
        "real_probes": 4113, "valid_probes": 2371, "virtual_probes": 1904, "invalid_probes": 1742, "tiles": 611,
        "patches": 2503, "bake_bytes": 31_871_233, "texture_bytes": 1_204_224, "bake_s": 7.31, "update_ms": 3.42,
        "sample_ns": 41.2, "truth_s": 9.8, "truth_rays": 268_435_456, "peak_rss_mib": 1422.3, "kernels_compiled": 14,
    }  # fmt: skip
    levels = [
        {"level": i, "voxel_m": 2.0 / 2**i, "voxels": 8 * 6**i, "real": 27 * 5**i, "virtual": 30 * i, "invalid": 9 * i, "tiles": 6**i}
        for i in range(3)
    ]  # fmt: skip
    worst = [
        {"set": "camera", "position": p, "ours": [1.1, 0.9, 0.8], "truth": [2.4, 1.2, 0.9], "relative": r}
        for p, r in (([0.4, 0.0, 1.2], -0.54), ([3.9, 1.2, 0.0], 0.31), ([0.0, 3.2, 2.0], -0.28), ([2.0, 2.0, -3.0], 0.27))
    ]  # fmt: skip
    return {
        "name": name, "status": "ok", "metrics": m, "cost": cost, "counts_by_level": levels, "worst": worst,
        "verdicts": [], "files": {}, "notes": ["leak: not measured, the scene has no dark set"], **extra,
    }  # fmt: skip


def make_chart(scene: str = "cornell") -> JsonObject:
    rng = np.random.default_rng(3)
    rows = []
    for method, counts in (
        ("uniform", (27, 125, 729, 4913)),
        ("adaptive", (60, 150, 400, 900, 2100, 4100, 9000)),
        ("per_mesh", (8,)),
    ):
        for n in counts:
            e = {"uniform": 1.9, "adaptive": 1.25, "per_mesh": 1.6}[method] * n**-0.42 * rng.uniform(0.9, 1.1)
            rows.append({
                "method": method, "setting": f"n={n}", "probes": n, "bytes": int(n * 7400 * rng.uniform(0.8, 1.2)),
                "update_ms": 0.4 + n / 900, "relrmse": {"value": float(np.hypot(e, 0.085)), "se": 0.006, "n": 2099},
            })  # fmt: skip
    return {"scene": scene, "rows": rows, "floor": {"value": 0.091, "se": 0.002}, "noise": {"value": 0.0171}}


def make_results(*names: str, charts: bool = True) -> JsonObject:
    return {
        "schema": 1,
        "provenance": {
            "versions": {"lightgauge": "0.1.0", "mitsuba": "3.9.1", "drjit": "1.5.0"}, "cpu": "AMD EPYC 9B14", "cores": 2,
            "llvm": "19.1.7", "opencl": ["PoCL 3.0, cpu-znver4"], "seed": 1, "config": {"placement": {"threshold": 2.0}},
            "commit": "56ed67a", "command": "lightgauge run " + " ".join(names) + " --out reports/demo", "date": "2026-11-20T07:12:44Z",
        },
        "scenes": [make_scene(name) for name in names],
        "charts": [make_chart(names[0])] if charts and names else [],
    }  # fmt: skip


@pytest.fixture(scope="session")
def view() -> Callable[..., SceneView]:
    return make_view


@pytest.fixture(scope="session")
def scene() -> Callable[..., JsonObject]:
    return make_scene


@pytest.fixture(scope="session")
def results() -> Callable[..., JsonObject]:
    return make_results


@pytest.fixture(scope="session")
def chart() -> Callable[..., JsonObject]:
    return make_chart
