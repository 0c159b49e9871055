"""A finished result as arrays and back."""

from __future__ import annotations

import dataclasses

import numpy as np
from lightgauge.validation.report.pictures import CameraPictures, CameraPose, ProbeDots, SceneView
from lightgauge.validation.run import pack, unpack


def view(seed: int, dots: bool) -> SceneView:
    rng = np.random.default_rng(seed)
    image = rng.random((4, 5, 3)).astype(np.float32)
    pictures = CameraPictures(f"s{seed}", f"c{seed}", image, image * 2, rng.random((4, 5)) > 0.5, image / 2, 0.1 * seed,
                              rng.random((4, 5)).astype(np.float32))  # fmt: skip
    pose = CameraPose((0.0, 1.0, 2.0), (1.0, 1.0, 1.0), (0.0, 1.0, 0.0), 50.0, 5, 4)
    some = ProbeDots(rng.random((7, 3)).astype(np.float32), np.arange(7, dtype=np.int32), np.zeros(7, np.uint8))
    return SceneView(pictures, pose, some if dots else None)


def test_round_trip_of_twelve_views() -> None:
    """More than ten, so that view 1 and view 10 do not mix."""
    views = [view(i, i % 2 == 0) for i in range(12)]
    record = {
        "name": "x",
        "status": "ok",
        "metrics": {"relrmse": {"value": 0.1, "se": 0.01, "n": 5}},
        "notes": ["é <b>"],
    }
    got_record, got = unpack(pack(record, views))
    assert got_record == record and len(got) == 12
    for a, b in zip(views, got, strict=True):
        for one, other in ((a.pictures, b.pictures), (a.pose, b.pose), (a.dots, b.dots)):
            if one is None:
                assert other is None
                continue
            for field in dataclasses.fields(one):
                x, y = getattr(one, field.name), getattr(other, field.name)
                np.testing.assert_array_equal(np.asarray(x), np.asarray(y), err_msg=field.name)


def test_no_views() -> None:
    assert unpack(pack({"name": "x"}, [])) == ({"name": "x"}, [])
