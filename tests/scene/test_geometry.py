"""Small parts of the loaders with known answers: places, polygons, pictures, names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene.checks import weld
from lightgauge.reference.scene.images import decode_pillow, read_picture, read_sky, shrink
from lightgauge.reference.scene.mtl import map_file
from lightgauge.reference.scene.names import clean, unique
from lightgauge.reference.scene.polygons import fan
from scene_files import write_exr, write_picture


def test_weld_knows_minus_zero() -> None:
    assert weld(np.array([[0.0, 0, 0], [-0.0, 0, 0], [1, 0, 0]])).tolist() == [0, 0, 1]


def test_fan() -> None:
    corners, owner = fan(np.array([3, 5, 4]))
    assert corners.tolist() == [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7], [8, 9, 10], [8, 10, 11]]
    assert owner.tolist() == [0, 1, 1, 1, 2, 2]


def test_shrink_keeps_the_mean() -> None:
    image = np.random.default_rng(3).random((37, 53, 3)).astype(np.float32)
    small = shrink(image, 10, 16)
    assert small.shape == (10, 16, 3)
    assert small.mean(axis=(0, 1)) == pytest.approx(image.mean(axis=(0, 1)), rel=1e-5)
    assert shrink(image, 64, 64).shape == image.shape


def test_srgb_values(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", [[[0, 10, 188, 64]]])
    picture = decode_pillow(tmp_path / "a.png", "x")
    assert picture.rgb[0, 0] == pytest.approx([0.0, 0.00303527, 0.5028865], abs=1e-6)
    assert picture.alpha is not None and picture.alpha[0, 0] == pytest.approx(64 / 255)
    assert decode_pillow(tmp_path / "a.png", "x", raw=True).rgb[0, 0, 2] == pytest.approx(188 / 255)


def test_exr(tmp_path: Path) -> None:
    image = np.random.default_rng(4).random((600, 8, 3)).astype(np.float32) * 100
    write_exr(tmp_path / "a.exr", image)
    assert np.array_equal(read_picture(tmp_path / "a.exr", "x").rgb, image)
    sky, notes = read_sky(tmp_path / "a.exr", "x")
    assert sky.shape == (512, 8, 3) and sky.mean() == pytest.approx(image.mean(), rel=1e-5) and len(notes) == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_broken_sky(tmp_path: Path, value: float) -> None:
    image = np.ones((4, 8, 3), np.float32)
    image[1, 2, 0] = value
    write_exr(tmp_path / "a.exr", image)
    with pytest.raises(InputError, match=r"a\.exr"):
        read_sky(tmp_path / "a.exr", "x")


def test_broken_exr(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", np.ones((4, 8, 3)))
    (tmp_path / "a.exr").write_bytes((tmp_path / "a.exr").read_bytes()[:200])
    with pytest.raises(InputError, match="cannot decode"):
        read_picture(tmp_path / "a.exr", "x")


def test_names() -> None:
    assert clean("a\x1b[1m<script>\n") == "a_[1m_script__"
    assert clean("=cmd|' /C calc'!A0")[0] == "c" and clean("") == "unnamed" and len(clean("x" * 999)) == 64
    taken = ["a", "a-2"]
    assert unique("a", taken) == "a-3" and unique("b", taken) == "b"
    assert len(unique("x" * 99, ["x" * 64])) <= 64


def test_map_options() -> None:
    assert map_file("-s 1 1 1 -o 0.5 -bm 2 my file.png") == "my file.png"
    assert map_file("-clamp on dir\\a.png") == "dir\\a.png"
