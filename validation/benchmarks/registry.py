"""The benches by name, and one run of them: groups that are wanted, their rows, and why others are absent."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from ...reference.errors import EnvironmentLacks, InputError
from ...reference.progress import Progress
from ..summary import plain
from .rows import CannotMeasure, Group, Row

SCHEMA_VERSION = 1


def transport() -> tuple[Group, ...]:
    """Form factors, radiosity's products, and their peers."""
    from . import box_rows, memory_rows, peer_rows, ray_rows, relight_rows, solver_rows

    return (
        *ray_rows.GROUPS, *memory_rows.GROUPS, *relight_rows.GROUPS, *solver_rows.GROUPS, *peer_rows.GROUPS, *box_rows.GROUPS,
    )  # fmt: skip


def placement() -> tuple[Group, ...]:
    """Where probes stand: what placing costs, what it saves, and against whom."""
    from . import culling_rows, eta_rows, leak_rows, place_rows, scheme_rows

    return (*eta_rows.GROUPS, *scheme_rows.GROUPS, *place_rows.GROUPS, *leak_rows.GROUPS, *culling_rows.GROUPS)


def fastpath() -> tuple[Group, ...]:
    """Sampling, streaming and lighting of the virtual texture on the device."""
    from . import fastpath_rows, stream_rows

    return (*fastpath_rows.GROUPS, *stream_rows.GROUPS)


BENCHES: dict[str, Callable[[], tuple[Group, ...]]] = {
    "transport": transport,
    "placement": placement,
    "fastpath": fastpath,
}


def chosen(names: Sequence[str], rows: Sequence[str]) -> tuple[list[str], list[Group], frozenset[str]]:
    """Benches, their groups with a wanted row, and the wanted rows: `names` and `rows`, all where nothing is named.

    Raises InputError for names that are not known, and says which are.
    """
    benches = list(dict.fromkeys(names)) or list(BENCHES)
    for name in benches:
        if name not in BENCHES:
            raise InputError(f"no bench {name!r}; known: {', '.join(BENCHES)}")
    groups = [group for name in benches for group in BENCHES[name]()]
    known = [name for group in groups for name in group.names]
    for row in rows:
        if row not in known:
            raise InputError(f"--row {row}: no such row in {', '.join(benches)}; known: {', '.join(known)}")
    wanted = frozenset(rows or known)
    return benches, [group for group in groups if wanted & set(group.names)], wanted


def run(names: Sequence[str], rows: Sequence[str], progress: Progress) -> dict[str, Any]:
    """Measure. Returns {"schema", "bench", "rows", "notes", "lacking"}; notes say why rows are absent, and are told at once; lacking:
    names of those that are absent because the machine lacks something.

    Raises EnvironmentLacks where nothing could be measured for want of something."""
    benches, groups, wanted = chosen(names, rows)
    found: list[Row] = []
    notes: list[str] = []
    lacking: list[str] = []
    lacks: EnvironmentLacks | None = None
    for group in groups:
        names_here = wanted & set(group.names)
        try:
            found += [row for row in group.measure(names_here, progress) if row.name in names_here]
        except (CannotMeasure, EnvironmentLacks) as error:
            absent = [name for name in group.names if name in names_here]
            if isinstance(error, EnvironmentLacks):
                lacks, lacking = error, [*lacking, *absent]
            notes.append(f"not measured: {', '.join(absent)}: {error}")
            print(plain(f"lightgauge: bench: {notes[-1]}"), file=sys.stderr)
    if lacks is not None and not found:
        raise lacks
    return {
        "schema": SCHEMA_VERSION,
        "bench": "+".join(benches),
        "rows": [row.as_json() for row in found],
        "notes": notes,
        "lacking": lacking,
    }


def missed(result: dict[str, Any]) -> list[str]:
    """Names of the rows that miss their targets."""
    keys = ("name", "value", "unit", "target", "better", "spread", "n")
    return [row["name"] for row in result["rows"] if Row(*(row[key] for key in keys)).missed]
