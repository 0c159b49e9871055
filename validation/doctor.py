"""`lightgauge doctor`: what this machine has, what it lacks, and the exact line that mends it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from ..fastpath import device, probe, speed
from ..reference import variant
from ..reference.errors import EnvironmentLacks
from .formats import remember
from .machine import cache_folder, folder_size, memory, size, usable_cores
from .summary import plain, table

DISTRIBUTION = "lightgauge"
OPTIONAL_PACKAGES = ("pymeshlab",)
MIN_PYTHON = (3, 11)
MIN_MEMORY = 4 << 30
State = Literal["ok", "missing", "warning", "info"]


@dataclass(frozen=True)
class Check:
    """One line of the examination.

    mend: the line to type, empty where nothing is wrong. needed: if it is missing, the exit code is 3.
    """

    area: str
    name: str
    state: State
    value: str
    mend: str = ""
    needed: bool = True


@dataclass(frozen=True)
class Examination:
    """All checks, and the facts behind them as plain numbers and strings for `--json`."""

    checks: tuple[Check, ...]
    facts: dict[str, Any]

    @property
    def ok(self) -> bool:
        """True when nothing needed is missing."""
        return not any(check.state == "missing" and check.needed for check in self.checks)


def examine() -> Examination:
    """Look at everything. Imports Dr.Jit and Mitsuba, runs no Dr.Jit kernel; on each OpenCL device a tiny kernel and, for a
    second, the sampler."""
    parts = [_python(), _packages(), _llvm(), _opencl(), _machine()]
    facts: dict[str, Any] = {}
    for _, found in parts:
        facts |= found
    return Examination(tuple(check for checks, _ in parts for check in checks), facts)


Part = tuple[list[Check], dict[str, Any]]


def _python() -> Part:
    version = platform.python_version()
    good = sys.version_info[:2] >= MIN_PYTHON
    mend = "" if good else variant.apt_line("python3.11 python3.11-venv")
    return [Check("software", "python", "ok" if good else "missing", version, mend)], {"python": version}


def package_version(name: str) -> str | None:
    """Installed version, without importing the package; None if it is not there."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def required_packages() -> list[str]:
    """Names of the packages this one depends on, extras left out."""
    try:
        lines = importlib.metadata.requires(DISTRIBUTION) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    names = (re.match(r"[A-Za-z0-9._-]+", line) for line in lines if "extra ==" not in line)
    return [name.group() for name in names if name]


def _packages() -> Part:
    checks, versions = [], {}
    for name in [DISTRIBUTION, *required_packages(), *OPTIONAL_PACKAGES]:
        version = package_version(name)
        needed = name not in OPTIONAL_PACKAGES
        versions[name] = version
        if version is not None:
            checks.append(Check("software", name, "ok", version, needed=needed))
        else:
            absent: State = "missing" if needed else "info"
            mend = ("make setup" if name == DISTRIBUTION else f"pip install {name}") if needed else ""
            checks.append(Check("software", name, absent, "not installed", mend, needed))
    return checks, {"packages": versions}


def _llvm() -> Part:
    """LLVM as Dr.Jit sees it, then Mitsuba's variant on top of it."""
    try:
        status = variant.llvm_status()
        version = ".".join(map(str, status.version)) if status.version else None
        fact = {"llvm": {"version": version, "path": status.path, "ok": status.ok, "variant": None}}
    except EnvironmentLacks as error:
        return [_lacks("compute", "drjit", error)], {
            "llvm": {"version": None, "path": None, "ok": False, "variant": None}
        }
    try:
        variant.ensure_variant()
    except EnvironmentLacks as error:
        return [_lacks("compute", "LLVM" if not status.ok else "mitsuba", error)], fact
    fact["llvm"]["variant"] = variant.VARIANT
    return [
        Check("compute", "LLVM", "ok", f"{version}  {status.path or ''}".strip()),
        Check("compute", "mitsuba variant", "ok", variant.VARIANT),
    ], fact


def _lacks(area: str, name: str, error: EnvironmentLacks, *, needed: bool = True) -> Check:
    """A missing thing, its message split at the mending line."""
    what, _, mend = str(error).partition("To mend it: ")
    return Check(area, name, "missing", what.strip(" ;."), mend, needed)


def _opencl() -> Part:
    try:
        devices = device.list_devices()
        chosen = device.choose(devices, os.environ.get(device.VARIABLE))
    except EnvironmentLacks as error:
        return [_lacks("compute", "OpenCL", error)], {"opencl": []}
    checks, facts = [], []
    for info in devices:
        used = info.index == chosen.index
        try:
            probed = probe.probe_isolated(info)
        except EnvironmentLacks as error:
            checks.append(_lacks("compute", f"OpenCL {info.index}", error, needed=used))
            facts.append({**asdict(info), "used": used, "probe": None})
            continue
        measured = speed.measure_isolated(info)
        if measured:
            remember(info, measured)
        storage, layout = speed.preferred(info, measured)
        sampling = {"samples_per_s": measured, "storage": storage, "layout": layout}
        facts.append({**asdict(info), "used": used, "probe": asdict(probed), "sampling": sampling})
        checks.append(_device_check(info, probed, used, "" if probed.ok else _other_device(info.index, devices)))
        checks.append(_layout_check(info, measured, storage, layout))
    return checks, {"opencl": facts}


def _layout_check(info: device.DeviceInfo, measured: speed.Speeds, storage: str, layout: str) -> Check:
    """How fast each layout is sampled on a device, and which one runs use."""
    rates = ", ".join(f"{name} {1e-6 * rate:.3g}" for name, rate in measured.items())
    found = f"{rates} M samples/s" if rates else "not measured"
    return Check("compute", f"layouts {info.index}", "info", f"{found}; runs use {layout} {storage}", needed=False)


def _device_check(info: device.DeviceInfo, probed: probe.Probe, used: bool, mend: str) -> Check:
    """A failed probe matters only on the device that would be used, which is marked with a star."""
    text = f"{info.name} ({info.platform}, {info.compute_units} units, {size(info.memory)})"
    verdict = "half RGBA 3D linear read ok" if probed.ok else f"probe failed: {probed.reason}"
    state: State = "ok" if probed.ok else "missing" if used else "warning"
    return Check("compute", f"OpenCL {info.index}{' *' if used else ''}", state, f"{text}: {verdict}", mend, used)


def _other_device(bad: int, devices: Sequence[device.DeviceInfo]) -> str:
    """The line that leads away from a device that fails its probe."""
    others = [info.index for info in devices if info.index != bad]
    return f"export {device.VARIABLE}={others[0]}" if others else device.MEND_OPENCL


def _machine() -> Part:
    total, available = memory()
    cores = usable_cores()
    folder = cache_folder()
    used = folder_size(folder)
    enough = total == 0 or total >= MIN_MEMORY
    text = f"{size(total)}, {size(available)} free" if total else "unknown"
    low = "" if enough else "runs may need up to 4 GiB: give the machine or container more"
    return [
        Check("machine", "cores", "info", str(cores), needed=False),
        Check("machine", "memory", "info" if enough else "warning", text, low, needed=False),
        Check("machine", "cache", "info", f"{folder} ({size(used)})", needed=False),
    ], {
        "platform": platform.platform(),
        "cores": cores,
        "memory_bytes": {"total": total, "available": available},
        "cache": {"folder": str(folder), "bytes": used},
    }


def as_json(examination: Examination) -> dict[str, Any]:
    """The object `doctor --json` prints."""
    missing = [asdict(check) for check in examination.checks if check.state in ("missing", "warning")]
    return {"schema": 1, "ok": examination.ok, **examination.facts, "missing": missing}


def as_text(examination: Examination) -> str:
    """An aligned table, then what is missing with the line that mends it."""
    rows = [[check.area, check.name, check.state, plain(check.value)] for check in examination.checks]
    text = [table([["", "what", "state", "found"], *rows])]
    mends = [check for check in examination.checks if check.mend]
    text += [f"\n{check.name}: {plain(check.value)}\n    {check.mend}" for check in mends]
    text.append("\neverything needed is here" if examination.ok else "\nsomething needed is missing")
    return "\n".join(text)
