"""What a bench is made of: rows, the groups that measure them, and how repeats become one row.

A row is the median over repeats. Its spread is half the interquartile range of the repeats: the half of them lies about
that near to the median.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ...reference.progress import Progress

Better = Literal["higher", "lower"]
Wanted = frozenset[str]


class CannotMeasure(RuntimeError):
    """Why rows are absent, with the line that mends it where there is one."""


@dataclass(frozen=True)
class Row:
    """One figure. target: what it must reach, None for a row that only informs. spread: of the n repeats, in `unit`."""

    name: str
    value: float
    unit: str
    target: float | None
    better: Better
    spread: float
    n: int
    note: str = ""

    @property
    def missed(self) -> bool:
        """True where there is a target and the value is on the wrong side of it."""
        if self.target is None:
            return False
        return self.value < self.target if self.better == "higher" else self.value > self.target

    def as_json(self) -> dict[str, Any]:
        """The row as `bench --json` prints it."""
        names = ("name", "value", "unit", "target", "better", "spread", "n")
        return {name: getattr(self, name) for name in names} | ({"note": self.note} if self.note else {})


@dataclass(frozen=True)
class Group:
    """Rows that one measurement gives. names: all of them. measure: gives those in `wanted`, and may give others.

    `measure` raises CannotMeasure where something is absent that it needs.
    """

    names: tuple[str, ...]
    measure: Callable[[Wanted, Progress], Iterable[Row]]


def row_of(
    name: str,
    values: npt.ArrayLike,
    unit: str,
    better: Better,
    target: float | None = None,
    note: str = "",
) -> Row:
    """The row of repeated measurements `values` (n,). Raises ValueError if there is none, or one is not finite."""
    v = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if v.size == 0 or not np.isfinite(v).all():
        raise ValueError(f"{name}: expected finite repeats, one at least, got {v}")
    low, middle, high = np.percentile(v, (25.0, 50.0, 75.0))
    return Row(name, float(middle), unit, target, better, float(high - low) / 2.0, len(v), note)
