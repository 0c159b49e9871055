"""What the tests of the loaders share."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest

# --import-mode=importlib does not put this folder on sys.path, so the writers of small files are loaded by path.
_spec = importlib.util.spec_from_file_location("scene_files", Path(__file__).with_name("files.py"))
assert _spec is not None and _spec.loader is not None
_module = importlib.util.module_from_spec(_spec)
sys.modules["scene_files"] = _module
_spec.loader.exec_module(_module)


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of real scenes made by others; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("LIGHTGAUGE_SCENES", Path(__file__).parents[2] / ".." / "shared" / "scenes"))
    if not folder.is_dir():
        pytest.skip(f"no folder of shared scenes at {folder}; set LIGHTGAUGE_SCENES")
    return folder.resolve()
