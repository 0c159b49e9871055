"""OpenCL devices: list them, pick one, open it. What they can do is in `probe`.

PoCL links every kernel with the system's linker, libgcc and libc, and *aborts the process* where one is missing (PoCL
3.0, measured on a minimal Debian 12), so that is checked before a context is made.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections import deque
from dataclasses import dataclass, field
from glob import glob
from typing import Any, Literal

from ..reference.errors import EnvironmentLacks

VARIABLE = "LIGHTGAUGE_OPENCL_DEVICE"
POCL_PINNED = "POCL_AFFINITY"
POCL_THREADS = ("POCL_CPU_MAX_CU_COUNT", "POCL_MAX_PTHREAD_COUNT")  # names by version
MEND_OPENCL = "pip install 'pyopencl[pocl]'"
LINKER_PACKAGES = "gcc libc6-dev"
Kind = Literal["gpu", "cpu", "other"]

_POCL = "Portable Computing Language"
_LINK_FILES = {
    "libgcc": ("/usr/lib/gcc/*/*/libgcc.a", "/usr/local/lib/gcc/*/*/libgcc.a", "/usr/lib64/gcc/*/*/libgcc.a"),
    "libc": ("/usr/lib/*-linux-gnu/libc.so", "/usr/lib64/libc.so", "/usr/lib/libc.so"),
}


@dataclass(frozen=True)
class DeviceInfo:
    """One OpenCL device.

    index: position in `list_devices`. memory: bytes. image3d: largest width, height and depth, texels; 0 without. image3d_writes:
    whether kernels may write them.
    """

    index: int
    platform: str
    name: str
    version: str
    driver: str
    kind: Kind
    compute_units: int
    memory: int
    image3d: tuple[int, int, int]
    half_arithmetic: bool
    image3d_writes: bool = False


@dataclass(frozen=True, eq=False)
class OpenDevice:
    """A device ready for work: pyopencl context and in-order queue with profiling. programs: those built so far (see `programs`).
    pending: launches that are not known to be over, and what they read (see `keep`)."""

    info: DeviceInfo
    context: Any
    queue: Any
    programs: dict[Any, Any] = field(default_factory=dict)
    pending: deque[tuple[Any, tuple[Any, ...]]] = field(default_factory=deque)

    def keep(self, event: Any, arguments: tuple[Any, ...]) -> None:
        """Hold the arguments of a launch until it is over. OpenCL does not own them: on PoCL an image sampler that its owner lets go
        of too early gives a wrong picture."""
        complete = pyopencl_module().command_execution_status.COMPLETE
        while self.pending and self.pending[0][0].command_execution_status == complete:
            self.pending.popleft()
        self.pending.append((event, arguments))


def pyopencl_module() -> Any:
    """The pyopencl package, imported late. Raises EnvironmentLacks with the line that installs it."""
    try:
        import pyopencl
    except ImportError as error:
        raise EnvironmentLacks(f"pyopencl cannot be imported ({error}). To mend it: {MEND_OPENCL}") from error
    return pyopencl


def pin_threads() -> None:
    """Ask PoCL to keep thread i on core i, unless the user chose that or the number of threads, or not all cores are this process's:
    PoCL 3.0 aborts where there is no such core.

    A frame of relighting is shorter than a tick of Linux's scheduler, which now and then wakes two threads on one core and leaves
    them there for the whole of it (README, `bench transport`).
    """
    if sys.platform != "linux" or any(name in os.environ for name in POCL_THREADS):
        return
    if os.sched_getaffinity(0) == set(range(os.cpu_count() or 0)):
        os.environ.setdefault(POCL_PINNED, "1")


def _raw_devices() -> list[Any]:
    """All devices of all platforms, in the platforms' order. A platform without devices is passed over."""
    cl = pyopencl_module()
    pin_threads()
    devices: list[Any] = []
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports "no platform" as an error
        return devices
    for platform in platforms:
        try:
            devices += platform.get_devices()
        except cl.Error:
            continue
    return devices


def _info(index: int, device: Any) -> DeviceInfo:
    cl = pyopencl_module()
    kind: Kind = "other"
    if device.type & cl.device_type.GPU:
        kind = "gpu"
    elif device.type & cl.device_type.CPU:
        kind = "cpu"
    size = (device.image3d_max_width, device.image3d_max_height, device.image3d_max_depth)
    return DeviceInfo(
        index=index,
        platform=str(device.platform.name).strip(),
        name=str(device.name).strip(),
        version=str(device.version).strip(),
        driver=str(device.driver_version).strip(),
        kind=kind,
        compute_units=int(device.max_compute_units),
        memory=int(device.global_mem_size),
        image3d=size if device.image_support else (0, 0, 0),
        half_arithmetic="cl_khr_fp16" in str(device.extensions).split(),
        image3d_writes="cl_khr_3d_image_writes" in str(device.extensions).split(),
    )


def list_devices() -> tuple[DeviceInfo, ...]:
    """Every OpenCL device on this machine, possibly none. Raises EnvironmentLacks without pyopencl."""
    return tuple(_info(index, device) for index, device in enumerate(_raw_devices()))


def choose(devices: tuple[DeviceInfo, ...], wanted: str | None) -> DeviceInfo:
    """Pick by `wanted` (index, or part of name or platform), else the first GPU, else the first CPU, else the first.

    Raises EnvironmentLacks when there is no device, or none that is wanted.
    """
    if not devices:
        raise EnvironmentLacks(f"no OpenCL device. To mend it: {MEND_OPENCL}")
    if wanted:
        named = [d for d in devices if wanted.lower() in f"{d.platform} {d.name}".lower()]
        matches = [d for d in devices if wanted == str(d.index)] or named
        if matches:
            return matches[0]
        names = ", ".join(f"{device.index}: {device.name}" for device in devices)
        raise EnvironmentLacks(
            f"no OpenCL device matches {VARIABLE}={wanted!r}; there are: {names}. To mend it: unset {VARIABLE}"
        )
    rank = {"gpu": 0, "cpu": 1, "other": 2}
    return min(devices, key=lambda device: (rank[device.kind], device.index))


def require_linker() -> None:
    """Raise EnvironmentLacks if what PoCL needs to link a kernel is missing."""
    missing = ["ld"] if shutil.which("ld") is None else []
    missing += [name for name, patterns in _LINK_FILES.items() if not any(map(glob, patterns))]
    if missing:
        sudo = "" if os.geteuid() == 0 else "sudo "
        what = f"the OpenCL device PoCL links its kernels with {', '.join(missing)}, missing here"
        raise EnvironmentLacks(f"{what}. To mend it: {sudo}apt-get install -y {LINKER_PACKAGES}")


def open_device(wanted: str | None = None) -> OpenDevice:
    """Open the device that `choose` picks; without `wanted`, $LIGHTGAUGE_OPENCL_DEVICE says which is wanted.

    Raises EnvironmentLacks without pyopencl, without a device, or when none is the wanted one.
    """
    cl = pyopencl_module()
    raw = _raw_devices()
    devices = tuple(_info(index, device) for index, device in enumerate(raw))
    info = choose(devices, wanted or os.environ.get(VARIABLE))
    if info.platform == _POCL and sys.platform == "linux":
        require_linker()
    context = cl.Context([raw[info.index]])
    queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    return OpenDevice(info, context, queue)
