"""Sums and standard errors of compressed rows against the plain twin."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from lightgauge.reference.sh import basis
from lightgauge.reference.transport.accumulate import accumulate_plain, collect_batch, finish_batch, launch_batch
from lightgauge.reference.transport.hits import DevicePatches, upload_patches
from lightgauge.reference.transport.receivers import Receivers, patch_receivers, probe_receivers, texel_receivers
from lightgauge.reference.visibility import Geometry
from small_scenes import box, box_quads, material, quad, scene, surfaces

Array = npt.NDArray[Any]
MIDDLE = np.array([[0.5, 0.4, 0.6], [0.2, 0.7, 0.9], [0.4, 0.3, 0.3]])


def open_room() -> tuple[Geometry, DevicePatches, dict[str, Receivers]]:
    walls = [quad(q, mat=1) for q in box_quads((0, 0, 0), (1, 1, 1))[:5]]
    crate = box((0.3, 0.2, 0.2), (0.5, 0.5, 0.4), inward=False)
    g, p = surfaces(scene([*walls, crate], [material(), material(two_sided=True)]), 0.4)
    made = {
        "patches": patch_receivers(g, p),
        "probes": probe_receivers(g, MIDDLE),
        "texels": texel_receivers(g, MIDDLE, 2),
    }
    return g, upload_patches(g, p), made


@pytest.mark.parametrize("kind", ["patches", "probes", "texels"])
@pytest.mark.parametrize(
    "rays, replicates, wide", [(16, 8, False), (128, 8, True), (1 << 16, 8, False), (64, 2, False)]
)
def test_rows_are_those_of_the_plain_twin(kind: str, rays: int, replicates: int, wide: bool) -> None:
    """wide: so many columns that keys take 64 bits; the sky's columns then begin elsewhere."""
    g, device, made = open_room()
    if wide:
        device = dataclasses.replace(device, columns=1 << 30)
    receivers = made[kind]
    rows = np.arange(receivers.count)[::-1][: 40 if rays < 1000 else 3].copy()
    traced = launch_batch(g, device, receivers, rows, rays, replicates, 5)
    keys = np.array(traced.keys).astype(np.uint64).reshape(len(rows), rays)
    np.testing.assert_array_equal(keys % rays, np.tile(np.arange(rays, dtype=np.uint64), (len(rows), 1)))
    found, terms = (keys // rays).astype(np.int64), np.ones((len(rows), rays, 1))
    assert receivers.spherical == (kind == "probes")
    if receivers.spherical:
        terms = basis(np.array(traced.directions).T.astype(np.float64))[:, :4].reshape(len(rows), rays, 4)
    batch = finish_batch(collect_batch(traced))
    np.testing.assert_array_equal(batch.rows, rows)
    at, scale = 0, receivers.weight / rays
    for r in range(len(rows)):
        expected = accumulate_plain(found[r], terms[r], replicates)
        assert batch.columns[at : at + batch.lengths[r]].tolist() == list(expected)
        for column, (value, se) in expected.items():
            reach = scale * (found[r] == column).sum()
            # Counts are whole numbers. Sums of directions carry float32's rounding, and differences of squares show it.
            of_value, of_variance = (2e-5, 3e-7) if receivers.spherical else (1e-7, 1e-13)
            np.testing.assert_allclose(batch.values[at], value * scale, rtol=1e-7, atol=of_value * reach)
            difference = np.abs(batch.se[at].astype(np.float64) ** 2 - (se * scale) ** 2)
            assert (difference <= of_variance * reach**2 + 1e-6 * (se * scale) ** 2).all(), (batch.se[at], se * scale)
            at += 1
    assert at == len(batch.columns) == len(batch.values) == len(batch.se)


def test_the_plain_twin_itself() -> None:
    """Two replicates of two rays; column 3 gets 2 and 1: sum 3, s² of the sum 2 × ((2 - 1.5)² + (1 - 1.5)²) = 1."""
    found = accumulate_plain(np.array([3, 3, 7, 3]), np.ones((4, 1)), 2)
    assert {c: (v[0], s[0]) for c, (v, s) in found.items()} == {3: (3.0, 1.0), 7: (1.0, 1.0)}


def test_back_share() -> None:
    """A probe in the crate, one outside of it, and one outside of the room: it sees two-sided walls' backs as surfaces."""
    g, device, _ = open_room()
    places = np.array([[0.4, 0.3, 0.3], [0.5, 0.8, 0.6], [-0.2, 0.5, 0.5]])
    batch = finish_batch(collect_batch(launch_batch(g, device, probe_receivers(g, places), np.arange(3), 256, 8, 1)))
    assert batch.back_share.tolist() == [1.0, 0.0, 0.0]
    assert batch.columns[: batch.lengths[0]].tolist() == [device.columns - 1]
