"""Measurements that are imported when they are called: the catalogue of cases must load without Mitsuba and OpenCL."""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from .case import Measure, Reading


def late(module: str, function: str) -> Measure:
    """`function` of the module called `module` beside this file, imported at its first call."""

    def measure(value: float, seed: int) -> Mapping[str, Reading]:
        found: Measure = getattr(importlib.import_module(f"{__package__}.{module}"), function)
        return found(value, seed)

    return measure
