"""All probes invalid, as a user meets it.

Rationale: a room of 0.3 m height, open on one side, whose faces look inwards, within eight probes of a lattice of 3.3 m: none stands in
it, and each sees the backs of its faces in 2 % of all directions. The sky makes them ask for all the 2,048 rays they may have; that
none of a probe's meets a back has a chance under 1e-17. Such a volume would be black without a word; so the bake is refused, with what
was counted, the setting and the likely causes. With voxels that put probes into the room the same scene is baked.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from lightgauge.validation import cli

CORNERS = [(x, y, z) for x in (0.0, 4.0) for y in (0.0, 0.3) for z in (0.0, 4.0)]
FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2))  # fronts inwards, one side open
TOML = """
[materials]
grey = { albedo = [0.5, 0.5, 0.5] }
[meshes]
room = { file = "room.obj", material = "grey" }
[lights]
lamp = { type = "point", position = [2.0, 0.15, 2.0], intensity = [1.0, 1.0, 1.0] }
sky = { type = "sky", radiance = [1.0, 1.0, 1.0] }
[placement]
probe_rays = 2048
probe_noise = 1e-4
backface_tolerance = 0.0
[radiosity]
patch_size = 2.0
rays = 64
"""


@pytest.fixture
def flat_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path / "cache"))
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["f " + " ".join(str(i + 1) for i in face) for face in FACES]
    (tmp_path / "room.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "scene.toml").write_text(TOML)
    return tmp_path / "scene.toml"


def bake(scene: Path, voxel: float) -> int:
    """The exit code of the bake with voxels of `voxel` m."""
    words = ["bake", str(scene), "--set", f"placement.min_voxel={voxel}", "--out", str(scene.with_name("x.bake"))]
    return cli.main([*words, "--quiet"])


def test_a_lattice_without_a_valid_probe_is_refused(flat_room: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bake(flat_room, 3.3) == 2
    said = capsys.readouterr().err
    assert "no probe placed: all " in said and "see back faces (placement.backface_tolerance 0.0)" in said
    assert "are the meshes inside out, or two_sided meant?" in said
    assert flat_room.parent.name in said and "Traceback" not in said
    assert not flat_room.with_name("x.bake").exists()


def test_the_same_room_with_probes_in_it_is_baked(flat_room: Path) -> None:
    assert bake(flat_room, 0.4) == 0
    assert flat_room.with_name("x.bake").exists()
