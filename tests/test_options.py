"""`--set` and `--config`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from lightgauge.reference.errors import InputError
from lightgauge.validation.options import merge, parse_assignment, read_overrides


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("placement.min_voxel=0.25", {"placement": {"min_voxel": 0.25}}),
        ("lights.sun.direction=[-0.4,-1,-0.3]", {"lights": {"sun": {"direction": [-0.4, -1, -0.3]}}}),
        ("lights.'my.sun'.tag=input", {"lights": {"my.sun": {"tag": "input"}}}),
        ("description=a = b", {"description": "a = b"}),
        ("description=2024-01-02", {"description": "2024-01-02"}),
        ("description=", {"description": ""}),
        ("description=1\nseed = 2", {"description": "1\nseed = 2"}),
        ("volumes.fog={min=[0,0,0], max=[1,1,1]}", {"volumes": {"fog": {"min": [0, 0, 0], "max": [1, 1, 1]}}}),
    ],
)
def test_assignment(text: str, expected: dict[str, Any]) -> None:
    assert parse_assignment(text) == expected


@pytest.mark.parametrize("text", ["placement.min_voxel", "=1", "a..b=1", "a b=1", "a\nb=1", "[a]=1"])
def test_assignment_refused(text: str) -> None:
    with pytest.raises(InputError, match="--set"):
        parse_assignment(text)


def test_later_wins_over_file(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[placement]\nmin_voxel = 1.0\nrays = 64\n")
    made = read_overrides(file, ["placement.min_voxel=0.5", "placement.min_voxel=0.25"])
    assert made == {"placement": {"min_voxel": 0.25, "rays": 64}}


def test_a_bitmap_is_laid_over_last() -> None:
    made = read_overrides(None, ["placement.bitmap=a.json", "placement.rays=64"], Path("b.json"))
    assert made == {"placement": {"bitmap": "b.json", "rays": 64}}
    with pytest.raises(InputError, match=r"--bitmap b\.json: 'placement' is a table"):
        read_overrides(None, ["placement=3"], Path("b.json"))


def test_table_against_value() -> None:
    with pytest.raises(InputError, match="'a' is a table"):
        merge({"a": {"b": 1}}, {"a": 2}, "--set a=2")


@pytest.mark.parametrize("content", [b"a = ", b"\xff\xfe", None])
def test_bad_config_names_the_file(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "c.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=r"c\.toml"):
        read_overrides(file, [])
