"""The seed shift moves what tests draw from, finds the tests that draw, and counts those that depend on their luck."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
SUITE = """
import random
import numpy as np
import pytest

@pytest.fixture(scope="module")
def drawn():
    return np.random.default_rng(3).random()

def test_plain():
    assert True

def test_lucky():
    assert np.random.default_rng([5, 1]).random() == {lucky}

def test_other_lucky():
    assert random.Random(4).random() == {other}

def test_by_fixture_a(drawn):
    assert 0 <= drawn < 1

def test_by_fixture_b(drawn):
    assert 0 <= drawn < 1
"""


def test_shifted_seeds_are_found_and_told_apart(tmp_path: Path) -> None:
    """Two tests hold for one seed only, two share a drawn fixture, one draws nothing."""
    # Not through default_rng, which is moved itself while this test is looked at for flakes; Python keeps random's stream as it is.
    lucky = float(np.random.Generator(np.random.PCG64([5, 1])).random())
    text = SUITE.format(lucky=repr(lucky), other="0.23604808973743452")
    (tmp_path / "test_it.py").write_text(text)
    (tmp_path / "conftest.py").write_text(
        "import importlib.util, sys\n"
        f"spec = importlib.util.spec_from_file_location('seed_shift', {str(REPOSITORY / 'tests' / 'seed_shift.py')!r})\n"
        "module = importlib.util.module_from_spec(spec)\nsys.modules['seed_shift'] = module\nspec.loader.exec_module(module)\n"
        "pytest_addoption, pytest_configure = module.pytest_addoption, module.pytest_configure\n"
    )
    rows = []
    for shift in (0, 1):
        report = tmp_path / f"report{shift}"
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--rootdir={tmp_path}",
            str(tmp_path),
        ]
        subprocess.run([*command, f"--seed-shift={shift}", f"--seed-report={report}"], check=False, capture_output=True)
        rows.append(
            {line.split("\t")[0].split("::")[1]: line.split("\t")[1:] for line in report.read_text().splitlines()}
        )
    assert [rows[0][f"test_{n}"][1] for n in ("plain", "lucky", "other_lucky", "by_fixture_a", "by_fixture_b")] == list(
        "01111"
    )
    assert {name for name, row in rows[0].items() if row[0] == "failed"} == set()
    assert {name for name, row in rows[1].items() if row[0] == "failed"} == {"test_lucky", "test_other_lucky"}
