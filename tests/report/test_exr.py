"""The OpenEXR file holds every layer, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from lightgauge.validation.report.exr import layers, read_exr, write_exr
from lightgauge.validation.report.pictures import SceneView


def test_layers_come_back_bit_for_bit(tmp_path: Path, view: Callable[..., SceneView]) -> None:
    made = view("room", "main").pictures
    made.ours[3, 4] = np.nan
    write_exr(tmp_path / "deep" / "room.exr", made)
    found, expected = read_exr(tmp_path / "deep" / "room.exr"), layers(made)
    names = {f"{layer}.{c}" for layer in ("truth", "ours", "albedo") for c in "RGB"} | {"error.Y", "depth.Z", "hit.A"}
    assert set(found) == set(expected) == names
    for name, channel in expected.items():
        assert found[name].tobytes() == channel.tobytes(), name
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["room.exr"]
