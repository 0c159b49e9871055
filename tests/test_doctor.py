"""`lightgauge doctor`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from lightgauge.fastpath import device, probe, speed
from lightgauge.reference import variant
from lightgauge.reference.errors import EnvironmentLacks
from lightgauge.validation import cli, doctor, formats, machine

Capture = pytest.CaptureFixture[str]
SPEEDS: speed.Speeds = {"packed": 2e7, "split": 1e7, "images": 1e6}


@pytest.fixture(autouse=True)
def known_speed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Speeds are given, not measured (tests/validation/test_bench_fastpath.py does that), and remembered elsewhere."""
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path))
    monkeypatch.setattr(speed, "measure_isolated", lambda _: SPEEDS)


def test_healthy_machine(capsys: Capture) -> None:
    assert cli.main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ok"] and found["missing"] == []
    assert found["llvm"]["ok"] and found["llvm"]["variant"] == "llvm_ad_rgb"
    assert any(item["used"] and item["probe"]["ok"] for item in found["opencl"])
    assert {"lightgauge", "mitsuba", "drjit", "numpy", "pyopencl", "pymeshlab"} <= set(found["packages"])
    assert found["cores"] >= 1 and found["memory_bytes"]["total"] > 0


def test_table_is_aligned(capsys: Capture) -> None:
    assert cli.main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    column = lines[0].index("state")
    rows = lines[1 : lines.index("")]
    assert rows and all(row[column - 1] == " " and row[column] != " " for row in rows)


def test_the_faster_layout_is_chosen_and_remembered(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cli.main(["doctor"]) == 0
    assert "packed 20, split 10, images 1 M samples/s; runs use packed half" in capsys.readouterr().out
    used = device.choose(device.list_devices(), None)
    assert formats.sampling_format(used, "linear") == ("half", "packed")
    monkeypatch.setattr(speed, "measure_isolated", lambda _: {"packed": 1e7, "images": 3e7})
    (found,) = [item for item in doctor.examine().facts["opencl"] if item["index"] == used.index]
    assert found["sampling"] == {
        "samples_per_s": {"packed": 1e7, "images": 3e7},
        "storage": "half8",
        "layout": "images",
    }
    assert formats.sampling_format(used, "linear") == ("half8", "images")


def test_a_device_that_cannot_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "measure_isolated", lambda _: {})
    examination = doctor.examine()
    assert examination.ok
    assert any(
        check.name.startswith("layouts") and "not measured; runs use" in check.value for check in examination.checks
    )


def test_old_llvm_is_3_with_the_line(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr(variant, "llvm_status", lambda: variant.LlvmStatus((15, 0, 6), None))
    monkeypatch.setattr(variant, "installed_libraries", list)
    monkeypatch.setattr(variant, "_ready", False)
    assert cli.main(["doctor", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert not found["ok"] and found["llvm"]["version"] == "15.0.6"
    assert found["missing"][0]["mend"].endswith("apt-get install -y libllvm19")
    assert cli.main(["doctor"]) == 3
    assert "    " + variant.apt_line("libllvm19") in capsys.readouterr().out.splitlines()


def test_no_opencl_is_3_with_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "list_devices", tuple)
    examination = doctor.examine()
    assert not examination.ok
    assert [check.mend for check in examination.checks if check.state == "missing"] == [device.MEND_OPENCL]


def test_bad_probe_is_3(monkeypatch: pytest.MonkeyPatch) -> None:
    def bad(_: device.DeviceInfo) -> probe.Probe:
        return probe.Probe(False, (), (), "garbage")

    monkeypatch.setattr(probe, "probe_isolated", bad)
    assert not doctor.examine().ok


def test_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "required_packages", lambda: ["numpy", "no-such-package"])
    examination = doctor.examine()
    missing = [check for check in examination.checks if check.state == "missing"]
    assert [(check.name, check.mend) for check in missing] == [("no-such-package", "pip install no-such-package")]


def test_optional_package_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "OPTIONAL_PACKAGES", ("no-such-package",))
    assert doctor.examine().ok


def test_import_failure_names_the_system_package() -> None:
    cause = ImportError("libatomic.so.1: cannot open shared object file: No such file or directory")
    error = variant._import_lacks("mitsuba", cause)
    assert isinstance(error, EnvironmentLacks) and str(error).endswith("apt-get install -y libatomic1")


def test_cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LIGHTGAUGE_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert machine.cache_folder() == tmp_path / "lightgauge"
    monkeypatch.setenv("LIGHTGAUGE_CACHE", str(tmp_path / "own"))
    assert machine.cache_folder() == tmp_path / "own"
    assert machine.folder_size(tmp_path / "own") == 0
    (tmp_path / "a").write_bytes(b"12345")
    assert machine.folder_size(tmp_path) == 5


def test_sizes() -> None:
    assert [machine.size(n) for n in (0, 1536, 3 << 30, 5 << 40)] == ["0 B", "1.5 KiB", "3.0 GiB", "5.0 TiB"]
