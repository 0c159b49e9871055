"""What the knobs of validity and sampling are worth on a baked scene, without baking again: the sample's offset along the normal,
the tolerance of back faces, copies into dead edges, levels of detail.

Each row is one value of one knob, all others as the scene has them, measured like the record's own errors. The tolerance's
rows are without copies: copies belong to one tolerance, and are judged by rows of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..reference import pipeline
from ..reference.datatypes import F64, I32, Bool
from ..reference.texture_types import Samples, VirtualTexture
from ..reference.truth.points import PointSet
from ..reference.volume.levels import complete_sets, lod_of_distance
from .bake import Baked, lifted, plain_samples, sample_points
from .ground_truth import GroundTruth
from .metrics.dead_edges import fallback_share
from .metrics.error import Measured, jackknife, measure_rel_rmse, rel_rmse
from .metrics.validity import Judged, rates
from .record import metric

OFFSETS = (0.0, 0.25, 0.5, 0.75, 1.0)
TOLERANCES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
Row = dict[str, Any]


def error_sets(baked: Baked, truth: GroundTruth) -> Iterator[tuple[str, PointSet, Bool | slice]]:
    """Name, set of points, and which of its points: every lit set, and every camera's own points where there are several."""
    for name in truth.points:
        if truth.estimates[name].irradiance.mean() > 0.0:
            yield name, name, slice(None)
    cameras = list(baked.scene.settings.cameras)
    for number, camera in enumerate(cameras if len(cameras) > 1 and "camera" in truth.points else []):
        mine = np.asarray(truth.points["camera"].camera == number)
        if mine.any() and truth.estimates["camera"].irradiance[:, mine].mean() > 0.0:
            yield f"camera {camera}", "camera", mine


def sweep_tables(baked: Baked, truth: GroundTruth, judged: Judged | None) -> tuple[list[Row], list[Row]]:
    """Rows of the record's `sweeps` and `offset_gains`. judged: places whose validity is known, for the ROC curve."""
    offsets = {v: _samples(baked, truth, v) for v in sorted({*OFFSETS, baked.scene.settings.sampling.normal_offset})}
    own = baked.scene.settings.sampling.normal_offset
    rows = [
        r for v, s in offsets.items() for r in _rows(baked, truth, "normal_offset", v, v == own, s, surface_only=True)
    ]
    return rows + tolerance_rows(baked, truth, judged) + copy_rows(baked, truth), _gains(baked, truth, offsets)


def tolerance_rows(baked: Baked, truth: GroundTruth, judged: Judged | None) -> list[Row]:
    """Errors, invalid probes and the ROC curve by tolerance of back faces; one that changes no probe is not sampled again."""
    own, share = baked.scene.settings.placement.backface_tolerance, baked.probes.rows.back_share
    found: list[Row] = []
    rows, last = [], None
    for value in sorted({*TOLERANCES, own}):
        valid = share <= value
        if last is None or not np.array_equal(valid, last):
            last = valid
            texture = with_light_from(baked, np.where(valid, np.arange(len(valid)), -1).astype(np.int32))
            found = _rows(baked, truth, "backface_tolerance", value, False, _plain_samples(baked, truth, texture))
        more: Row = {"value": value, "current": value == own, "invalid_share": float(1.0 - valid.mean())}
        if judged is not None:
            more["missed"], more["false_alarms"] = rates(judged, value)
        rows += [{**r, **more} for r in found]
    return rows


def copy_rows(baked: Baked, truth: GroundTruth) -> list[Row]:
    """Errors without (0) and with (1) copies into dead edges; no rows where there are no copies."""
    if not copied(baked):
        return []
    rows = []
    for value, texture in ((0.0, without_copies(baked)), (1.0, baked.texture)):
        found = _plain_samples(baked, truth, texture)
        for row, (_, points, chosen) in zip(
            _rows(baked, truth, "copies", value, value == 1.0, found), error_sets(baked, truth), strict=True
        ):
            where = lifted(baked.scene, texture, truth.points[points])[chosen]
            part = Samples(*(getattr(found[points], f.name)[chosen] for f in dataclasses.fields(Samples)))
            rows.append({**row, "fallback_share": fallback_share(texture, where, part).value})
    return rows


def copied(baked: Baked) -> int:
    """Number of invalid probes that use a neighbour's light."""
    return int(((baked.probes.light_from >= 0) & ~baked.probes.valid).sum())


def with_light_from(baked: Baked, source: I32) -> VirtualTexture:
    """The same bake and light with another choice of whose light each probe uses, (R,) i32."""
    return dataclasses.replace(baked.texture, texels=pipeline.tile_texels(baked.probes, baked.coefficients, source))


def without_copies(baked: Baked) -> VirtualTexture:
    """The same bake and light with nothing copied into dead edges."""
    probes = baked.probes
    return with_light_from(baked, np.where(probes.valid, probes.light_from, -1).astype(np.int32))


def _samples(baked: Baked, truth: GroundTruth, offset: float) -> dict[PointSet, Samples]:
    """Kernel samples of all sets, `offset` finest voxels off surfaces."""
    return {n: sample_points(baked, p, offset) for n, p in truth.points.items()}


def _plain_samples(baked: Baked, truth: GroundTruth, texture: VirtualTexture) -> dict[PointSet, Samples]:
    """Samples of another texture as the device stores it, by the kernel's plain twin: no kernel is built for one use."""
    return {n: plain_samples(baked, texture, p) for n, p in truth.points.items()}


def _rows(
    baked: Baked, truth: GroundTruth, knob: str, value: float, current: bool, found: Mapping[PointSet, Samples],
    surface_only: bool = False,
) -> list[Row]:  # fmt: skip
    """One row per set of points."""
    rows = []
    for name, points, chosen in error_sets(baked, truth):
        if surface_only and points == "volume":
            continue
        ours = found[points].irradiance.astype(np.float64)[chosen]
        error = as_metric(measure_rel_rmse(ours, truth.estimates[points].irradiance[:, chosen]))
        unlit = float((found[points].level[chosen] == 0).mean())
        if error is not None:
            rows.append(
                {"knob": knob, "value": value, "set": name, "current": current, "relrmse": error, "unlit_share": unlit}
            )
    return rows


def as_metric(m: Measured) -> Row | None:
    """As the record holds it, None where it is not finite."""
    return metric(m.value, m.se, m.n, **({"below_noise": True} if m.below_noise else {}))


def _gains(baked: Baked, truth: GroundTruth, offsets: Mapping[float, Mapping[PointSet, Samples]]) -> list[Row]:
    """Per set the best offset, and by how much its relRMSE is under that of no offset, with the standard error of the difference at
    the same points."""
    rows = []
    for name, points, chosen in error_sets(baked, truth):
        if points == "volume":
            continue
        batches = truth.estimates[points].irradiance[:, chosen]
        ours = {v: s[points].irradiance.astype(np.float64)[chosen] for v, s in offsets.items() if v in OFFSETS}
        best = min(OFFSETS, key=lambda v: rel_rmse(ours[v], batches))

        def gain(pair: F64, reference: F64) -> float:
            return rel_rmse(pair[0], reference) - rel_rmse(pair[1], reference)

        pair = np.stack([ours[0.0], ours[best]])
        entry = metric(gain(pair, batches), jackknife(gain, pair, batches), batches.shape[1])
        rows.append({"set": name, "best": best, "gain": entry})
    return rows


def lod_table(baked: Baked, truth: GroundTruth) -> list[Row]:
    """Rows of the record's `lods`: each level's complete set, and the error if everything is sampled at that level, at the first lit
    set of points; nothing where none is lit."""
    first = next(error_sets(baked, truth), None)
    if first is None:
        return []
    name = first[1]
    points, batches = truth.points[name], truth.estimates[name].irradiance
    where = lifted(baked.scene, baked.texture, points)
    tree, rows = baked.probes.octree, []
    for level, probes in enumerate(complete_sets(tree).tolist(), start=1):
        found = baked.sampler(where, points.normals, level)
        entry = as_metric(measure_rel_rmse(found.irradiance.astype(np.float64), batches))
        rows.append(
            {"level": level, "voxel_m": tree.grid.size(level), "probes": probes, "set": name, "relrmse": entry,
             "unlit_share": float((found.level == 0).mean())}
        )  # fmt: skip
    return rows


def lod_errors(baked: Baked, truth: GroundTruth) -> dict[str, Measured]:
    """relrmse_lod and lod_coarser_share at the cameras' points, each sampled at the level that its distance from its own camera gives;
    nothing where the scene asks for no levels of detail or has no lit camera."""
    d0, cameras = baked.scene.settings.sampling.lod_distance, list(baked.scene.settings.cameras.values())
    if d0 is None or "camera" not in truth.points or truth.estimates["camera"].irradiance.mean() <= 0.0:
        return {}
    points = truth.points["camera"]
    assert points.camera is not None
    eyes = np.array([c.origin for c in cameras], dtype=np.float64)[points.camera]
    # The levels are those of placement.min_voxel: what a bitmap file asks for beyond them belongs to the finest.
    wanted = baked.probes.octree.grid.wanted_level
    lod = lod_of_distance(np.linalg.norm(points.positions - eyes, axis=1), d0, wanted)
    lod = np.where(lod == wanted, baked.texture.level, lod).astype(np.int32)
    found = baked.sampler(lifted(baked.scene, baked.texture, points), points.normals, lod)
    error = measure_rel_rmse(found.irradiance.astype(np.float64), truth.estimates["camera"].irradiance)
    share, n = float((lod < baked.texture.level).mean()), len(lod)
    return {"relrmse_lod": error, "lod_coarser_share": Measured(share, float(np.sqrt(share * (1.0 - share) / n)), n)}
