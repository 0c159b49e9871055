"""Choosing and checking LLVM. What needs a fresh Dr.Jit runs in its own process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from lightgauge.reference import variant
from lightgauge.reference.errors import EnvironmentLacks


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.19.1", (19, 1, 0)),
        ("libLLVM-15.so.1", (15, 0, 0)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM-17.so", (17, 0, 0)),
        ("libLLVM.so", None),
        ("libLLVMSPIRVLib.so.14", None),
    ],
)
def test_version_in_name(name: str, version: tuple[int, int, int] | None) -> None:
    assert variant.version_in_name(f"/usr/lib/llvm-18/lib/{name}") == version


def test_best_library_is_the_newest_good_one() -> None:
    names = ["libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM.so"]
    assert variant.best_library(names) == "libLLVM.so.19.1"
    assert variant.best_library(["libLLVM-15.so.1", "libLLVM-16.so.1"]) is None


def test_choose_library(tmp_path: Path) -> None:
    for name in ("libLLVM-15.so.1", "libLLVM.so.18.1"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "libLLVM.so.20.1").symlink_to("gone")
    patterns = [f"{tmp_path}/libLLVM*.so*"]
    environment: dict[str, str] = {}
    assert variant.choose_library(environment, patterns) == str(tmp_path / "libLLVM.so.18.1")
    assert environment == {variant.PATH_VARIABLE: str(tmp_path / "libLLVM.so.18.1")}
    own = {variant.PATH_VARIABLE: "mine"}
    assert variant.choose_library(own, patterns) == "mine"
    assert variant.choose_library({}, [f"{tmp_path}/nothing*"]) is None


@pytest.mark.parametrize(
    ("version", "says"), [(None, "found no usable LLVM"), ((15, 0, 6), "loaded LLVM 15.0.6"), ((16, 0, 0), "16.0.0")]
)
def test_require_names_the_mending_line(
    version: tuple[int, int, int] | None, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(variant, "installed_libraries", list)
    with pytest.raises(EnvironmentLacks) as caught:
        variant.require_llvm(variant.LlvmStatus(version, None))
    assert says in str(caught.value)
    assert str(caught.value).endswith("apt-get install -y libllvm19")


def test_good_versions_pass() -> None:
    for major in (17, 19, 21):
        variant.require_llvm(variant.LlvmStatus((major, 1, 0), None))


def test_bad_choice_of_the_user_names_the_better_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variant, "installed_libraries", lambda: ["/lib/libLLVM.so.19.1"])
    with pytest.raises(EnvironmentLacks, match=r"export DRJIT_LIBLLVM_PATH=/lib/libLLVM\.so\.19\.1$"):
        variant.require_llvm(variant.LlvmStatus((15, 0, 6), "/lib/libLLVM-15.so.1"), {variant.PATH_VARIABLE: "15"})


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `code` in a process whose Dr.Jit is not loaded yet."""
    clean = {key: value for key, value in os.environ.items() if key != variant.PATH_VARIABLE}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**clean, **environment}
    )


def test_ensure_variant_twice_then_a_kernel() -> None:
    code = (
        "import sys; from lightgauge.reference import variant\n"
        "assert 'drjit' not in sys.modules\n"
        "variant.ensure_variant(); variant.ensure_variant()\n"
        "import mitsuba as mi, drjit as dr\n"
        "print(mi.variant(), float(dr.max(dr.minimum(dr.arange(mi.Float, 8), 3))[0]))"
    )
    done = run_python(code)
    assert done.stdout.split() == ["llvm_ad_rgb", "3.0"], done.stderr


old = [path for path in variant.installed_libraries() if (variant.version_in_name(path) or (99,))[0] < variant.MIN_LLVM]


@pytest.mark.skipif(not old, reason="no old libLLVM on this machine")
@pytest.mark.parametrize("path", sorted(set(map(os.path.realpath, old))))
def test_old_library_is_refused_without_an_abort(path: str) -> None:
    code = (
        "from lightgauge.reference import errors, variant\n"
        "try: variant.ensure_variant()\n"
        "except errors.EnvironmentLacks as error: print('refused', error)"
    )
    done = run_python(code, **{variant.PATH_VARIABLE: path})
    assert done.returncode == 0 and done.stdout.startswith("refused"), done.stderr


def test_doctor_exits_3_on_a_missing_library() -> None:
    code = "import sys; from lightgauge.validation import cli; sys.exit(cli.main(['doctor']))"
    done = run_python(code, **{variant.PATH_VARIABLE: "/nowhere/libLLVM.so.19"})
    assert done.returncode == 3
    assert "export DRJIT_LIBLLVM_PATH=" in done.stdout or "apt-get install -y libllvm19" in done.stdout
