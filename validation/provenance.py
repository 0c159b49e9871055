"""What a run was made with: versions, machine, seed, settings, commit, command."""

from __future__ import annotations

import datetime
import platform
import re
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from ..fastpath.device import OpenDevice
from .machine import usable_cores

PACKAGES = ("lightgauge", "mitsuba", "drjit", "numpy", "scipy", "pyopencl", "OpenEXR")
VECTOR_LANES = 64  # of the kernel that is asked for its width: no machine has wider vectors


def provenance(device: OpenDevice, overrides: Mapping[str, Any], seed: int, command: str) -> dict[str, Any]:
    """The "provenance" object of results.json."""
    import drjit as dr

    return {
        "versions": {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}},
        "cpu": _cpu(),
        "cores": usable_cores(),
        "llvm": ".".join(str(n) for n in dr.detail.llvm_version()),
        "vector_width": vector_width(),
        "opencl": f"{device.info.platform}, {device.info.name}",
        "seed": seed,
        "config": dict(overrides),
        "commit": _commit(),
        "command": command,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def vector_width() -> int:
    """Lanes of single precision that Dr.Jit's LLVM kernels compute at a time, as the text of a small kernel has them: another width
    gives sums in another order, so other bits. 0 where no kernel says."""
    import drjit as dr
    from drjit.llvm import Float

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.eval(dr.opaque(Float, 1.0, VECTOR_LANES) + 1.0)
        texts = [kernel["ir"].getvalue() for kernel in dr.kernel_history([dr.KernelType.JIT])]
    return max((int(lanes) for text in texts for lanes in re.findall(r"<(\d+) x float>", text)), default=0)


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _commit() -> str:
    """Commit of the source tree, with "+changes" where it was edited; "unknown" outside a checkout."""
    root = Path(__file__).resolve().parent.parent
    try:
        commit = _git(root, "rev-parse", "--short=12", "HEAD")
        return commit + ("+changes" if _git(root, "status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()
