"""What all tests share: small scenes built in memory, and the folder of answers that this project did not make."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest


# --import-mode=importlib does not put this folder on sys.path, so what lies beside this file is loaded by path.
def _beside(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


_beside("chance")
_beside("small_scenes")
_seed_shift = _beside("seed_shift")
pytest_addoption, pytest_configure = _seed_shift.pytest_addoption, _seed_shift.pytest_configure


@pytest.fixture(scope="session")
def shared_truth() -> Path:
    """The folder of published answers; tests that need it are skipped where it is absent."""
    repository = Path(__file__).resolve().parents[1]
    candidates = [repository / ".." / "shared" / "truth"]
    if scenes := os.environ.get("LIGHTGAUGE_SCENES"):
        candidates.insert(0, Path(scenes) / ".." / "truth")
    for folder in candidates:
        if folder.is_dir():
            return folder.resolve()
    pytest.skip(f"no folder of published answers at {candidates[-1]}; set LIGHTGAUGE_SCENES to its neighbour")


@pytest.fixture(scope="session")
def published(shared_truth: Path) -> dict[str, dict[str, Any]]:
    """Every published case by its id."""
    cases: dict[str, dict[str, Any]] = {}
    for name in ("viewfactors.json", "radiosity.json", "sh.json"):
        for case in json.loads((shared_truth / name).read_text(encoding="utf-8")):
            cases[case["id"]] = case
    return cases
