"""Settings of materials and their JSON Schema."""

from __future__ import annotations

import jsonschema
import pytest
from lightgauge.reference.config import MaterialSettings, scene_json_schema
from pydantic import ValidationError


def test_emission_texture_is_optional() -> None:
    assert MaterialSettings().emission_texture is None
    assert MaterialSettings(emission=(1, 2, 3), emission_texture="a.png").emission == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"emission_texture": 3},
        {"emission_textur": "a.png"},
        {"albedo": (1.0, 0.5, 0.5)},
        {"albedo": (-0.1, 0.5, 0.5)},
        {"emission": (float("nan"), 0.0, 0.0)},
        {"emission": (float("inf"), 0.0, 0.0)},
        {"emission": (-1.0, 0.0, 0.0)},
    ],
)
def test_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        MaterialSettings.model_validate(wrong)


def test_schema_knows_it() -> None:
    schema = scene_json_schema()
    scene = {"materials": {"lamp": {"emission": [1, 1, 1], "emission_texture": "a.png"}}, "meshes": {}}
    jsonschema.validate(scene, schema)
    scene["materials"]["lamp"]["emission_texture"] = 3
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(scene, schema)
