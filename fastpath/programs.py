"""OpenCL programs: sources of this package with their headers, built once per device and set of options."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from typing import Any

from ..reference.errors import EnvironmentLacks
from .device import OpenDevice, pyopencl_module

_INCLUDE = re.compile(r'^#include "([a-z0-9_]+\.clh)"$', re.MULTILINE)


def text_of(name: str) -> str:
    """Text of a kernel file of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def source(name: str) -> str:
    """Text of a kernel file, its own headers put in place (a device's compiler sees no folder of ours)."""
    return _INCLUDE.sub(lambda found: source(found.group(1)), text_of(name))


def program(device: OpenDevice, name: str, options: Sequence[str]) -> Any:
    """The built program of file `name` (pyopencl.Program). Built once per device and options, then shared.

    -w, as clang warns of the calling convention of vectors that are never passed: all functions are inlined.
    Raises EnvironmentLacks with the compiler's words where the device cannot build it.
    """
    key = (name, tuple(options))
    if key not in device.programs:
        cl = pyopencl_module()
        try:
            device.programs[key] = cl.Program(device.context, source(name)).build(options=["-w", *options])
        except cl.RuntimeError as error:
            raise EnvironmentLacks(f"the OpenCL device {device.info.name} cannot build {name}: {error}") from error
    return device.programs[key]
