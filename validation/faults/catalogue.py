"""All seeded faults by id."""

from __future__ import annotations

import difflib

from ...reference.errors import InputError
from .fault import Fault
from .faults_device import DEVICE
from .faults_light import LIGHT
from .faults_volume import VOLUME

FAULTS: tuple[Fault, ...] = (*LIGHT, *VOLUME, *DEVICE)


def find_fault(name: str) -> Fault:
    """By id. Raises InputError for one that does not exist, naming those that are near."""
    for fault in FAULTS:
        if fault.id == name:
            return fault
    near = difflib.get_close_matches(name, [f.id for f in FAULTS], 3)
    raise InputError(f"there is no fault {name!r}" + (f"; near: {', '.join(near)}" if near else ""))
