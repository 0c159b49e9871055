"""The one place that chooses Dr.Jit's LLVM library and sets the Mitsuba variant.

Dr.Jit loads libLLVM while it is imported. Measured with drjit 1.5: libLLVM 14 is refused, 15 and 16 are accepted and
then abort the process in the first kernel that has a min or max, 19 works. So a good library is chosen before the
import (Dr.Jit obeys DRJIT_LIBLLVM_PATH), and what was really loaded is checked after it, before any kernel runs.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, MutableMapping
from dataclasses import dataclass
from glob import glob
from pathlib import Path

from .errors import EnvironmentLacks

VARIANT = "llvm_ad_rgb"
MIN_LLVM = 17
LLVM_PACKAGE = "libllvm19"
PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_PATTERNS = (
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/llvm*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/usr/lib/wsl/lib/libLLVM*.so*",
)
_VERSION = re.compile(r"libLLVM(?:-|\.so\.)(\d+)(?:\.(\d+))?(?:\.(\d+))?")
_LIBRARY_PACKAGES = {"libatomic.so.1": "libatomic1", "libGL.so.1": "libgl1", "libOpenGL.so.0": "libopengl0"}

_ready = False


def apt_line(package: str) -> str:
    """What this user types to install a system package."""
    sudo = "sudo " if hasattr(os, "geteuid") and os.geteuid() != 0 else ""
    return f"{sudo}apt-get install -y {package}"


@dataclass(frozen=True)
class LlvmStatus:
    """What Dr.Jit loaded. version: (major, minor, patch), or None when it has no usable LLVM. path: file, if known."""

    version: tuple[int, int, int] | None
    path: str | None

    @property
    def ok(self) -> bool:
        """True when Dr.Jit can run kernels with this library."""
        return self.version is not None and self.version[0] >= MIN_LLVM


def version_in_name(path: str) -> tuple[int, int, int] | None:
    """(major, minor, patch) written in a libLLVM file name, missing parts 0; None where it has no number."""
    found = _VERSION.search(Path(path).name)
    if found is None:
        return None
    major, minor, patch = (int(part or 0) for part in found.groups())
    return major, minor, patch


def best_library(paths: Iterable[str]) -> str | None:
    """The newest of these libLLVM files that Dr.Jit can use, by the version in its name; None if there is none."""
    versions = {path: version_in_name(path) for path in paths}
    good = [(version, path) for path, version in versions.items() if version is not None and version[0] >= MIN_LLVM]
    return max(good)[1] if good else None


def installed_libraries(patterns: Iterable[str] = LLVM_PATTERNS) -> list[str]:
    """libLLVM files on this machine, dangling links left out."""
    return sorted({path for pattern in patterns for path in glob(pattern) if Path(path).is_file()})


def choose_library(
    environment: MutableMapping[str, str] | None = None, patterns: Iterable[str] = LLVM_PATTERNS
) -> str | None:
    """Point Dr.Jit at the newest usable libLLVM, before it is imported. Returns the file, or None if there is none.

    A value the user gave DRJIT_LIBLLVM_PATH is left alone: `llvm_status` judges it.
    """
    environment = os.environ if environment is None else environment
    if environment.get(PATH_VARIABLE):
        return environment[PATH_VARIABLE]
    best = best_library(installed_libraries(patterns))
    if best is not None:
        environment[PATH_VARIABLE] = best
    return best


def llvm_status() -> LlvmStatus:
    """Import Dr.Jit and say which LLVM it loaded. Runs no kernel. Raises EnvironmentLacks if it cannot be imported."""
    path = choose_library() if "drjit" not in sys.modules else os.environ.get(PATH_VARIABLE)
    try:
        import drjit
    except ImportError as error:
        raise _import_lacks("drjit", error) from error
    version = drjit.detail.llvm_version()
    if not drjit.has_backend(drjit.JitBackend.LLVM) or version[0] < 0:
        return LlvmStatus(None, path)
    return LlvmStatus((int(version[0]), int(version[1]), int(version[2])), path)


def require_llvm(status: LlvmStatus, environment: MutableMapping[str, str] | None = None) -> None:
    """Raise EnvironmentLacks with the mending line unless `status` is good."""
    if status.ok:
        return
    if status.version is None:
        found = f"Dr.Jit cannot use {status.path}" if status.path else "Dr.Jit found no usable LLVM library"
    else:
        found = f"Dr.Jit loaded LLVM {'.'.join(map(str, status.version))}, which can abort the process"
    environment = os.environ if environment is None else environment
    better = best_library(installed_libraries())
    mend = (
        f"export {PATH_VARIABLE}={better}"
        if better and better != environment.get(PATH_VARIABLE)
        else apt_line(LLVM_PACKAGE)
    )
    raise EnvironmentLacks(f"{found}; LLVM {MIN_LLVM} or newer is needed. To mend it: {mend}")


def ensure_variant() -> None:
    """Set the Mitsuba variant; call before any use of Mitsuba or Dr.Jit. Cheap after the first time.

    Raises EnvironmentLacks, before any kernel runs, when LLVM or a system library is missing or too old.
    """
    global _ready
    if _ready:
        return
    require_llvm(llvm_status())
    try:
        import mitsuba
    except ImportError as error:
        raise _import_lacks("mitsuba", error) from error
    if mitsuba.variant() != VARIANT:
        mitsuba.set_variant(VARIANT)
    _ready = True


def _import_lacks(module: str, error: ImportError) -> EnvironmentLacks:
    """The failed import of `module` as an error with the line that mends it."""
    for library, package in _LIBRARY_PACKAGES.items():
        if library in str(error):
            return EnvironmentLacks(f"{module} needs {library}. To mend it: {apt_line(package)}")
    return EnvironmentLacks(f"{module} cannot be imported ({error}). To mend it: pip install {module}")
