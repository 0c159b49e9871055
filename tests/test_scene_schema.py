"""The committed JSON Schema of scene.toml is the one the settings generate, and the bundled scenes obey it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest
from lightgauge.reference.config import scene_json_schema

SCENES = Path(__file__).resolve().parent.parent / "scenes"


def test_committed_schema_is_current() -> None:
    text = json.dumps(scene_json_schema(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    assert (SCENES / "scene.schema.json").read_text(encoding="utf-8") == text, (
        "run: python -m lightgauge.reference.config > scenes/scene.schema.json"
    )


@pytest.mark.parametrize("path", sorted(SCENES.glob("*/scene.toml")), ids=lambda p: p.parent.name)
def test_bundled_scene_obeys_it(path: Path) -> None:
    jsonschema.validate(json.loads(json.dumps(tomllib.loads(path.read_text()))), scene_json_schema())


def test_it_refuses_an_unknown_key() -> None:
    scene = tomllib.loads((SCENES / "sphere" / "scene.toml").read_text())
    scene["placement"]["min_voxl"] = 0.1
    with pytest.raises(jsonschema.ValidationError, match="min_voxl"):
        jsonschema.validate(scene, scene_json_schema())
