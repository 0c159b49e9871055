"""A seeded fault: one place in the product's own source that says something else.

The source on disk is never touched. A process that is to have the fault reads the changed text in its place (`inject`).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # the folder that holds reference/, fastpath/ and validation/
SIZE = "SIZE"  # stands for the fault's size in `new`
# Quick to measure, quickest first: 5, 8, 8 and 16 s of CPU where the reference is known.
ALL = ("two-rooms", "corridor", "sphere", "cornell")
ENERGY = ("sphere", "two-rooms", "cornell", "corridor")  # one that is checked against closed forms first


@dataclass(frozen=True)
class Fault:
    """id: a short name. title: what is wrong, for a reader. file: below ROOT. old: text that occurs once in it; new: what stands there
    instead; in faults of a size, `SIZE` stands for it (0.01: one per cent too much). scenes: bundled scenes on which gates may
    notice it, in this order. fly: tiles are also streamed around a viewer. sizes: what is tried, largest first, for faults of a
    size."""

    id: str
    title: str
    file: str
    old: str
    new: str
    scenes: tuple[str, ...] = ALL
    fly: bool = False
    sizes: tuple[float, ...] = ()

    def changed(self, text: str, size: float | None) -> str:
        """The file's text with the fault. Raises ValueError if the place is not there exactly once."""
        if text.count(self.old) != 1:
            raise ValueError(f"fault {self.id}: {self.file} holds {text.count(self.old)} times\n{self.old}")
        new = self.new if size is None else self.new.replace(SIZE, repr(size))
        return text.replace(self.old, new)

    def digest(self, size: float | None) -> str:
        """Hash of what the fault changes."""
        return hashlib.sha256(f"{self.file}\n{self.old}\n{self.new}\n{size}".encode()).hexdigest()
