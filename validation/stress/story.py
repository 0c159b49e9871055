"""What `lightgauge stress` does: cases run and judged, the bundled scenes read, record and page written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...fastpath.device import open_device
from ...reference.variant import ensure_variant
from ..progress_bar import ProgressBar
from ..provenance import provenance
from ..record_models import JsonObject
from ..sources import bundled_scenes
from .catalogue import Entry
from .on_scenes import scene_rows
from .page import write_stress
from .record import case_record, stress_record
from .runner import Outcome, Runner


def stress(
    entries: Sequence[Entry], out: Path, seed: int, quiet: bool, jobs: int | None, command: str, scenes: bool
) -> JsonObject:
    """Run the cases, and read the bundled scenes where `scenes`; returns the record, which is written into `out` with its page.

    Raises EnvironmentLacks for a machine that cannot run any. On Ctrl-C finished cases stay in the cache.
    """
    ensure_variant()
    about = provenance(open_device(), {}, seed, command)
    runner = Runner(seed, jobs)
    with ProgressBar("stress", quiet) as progress:
        finished = 0

        def done(entry: Entry, outcome: Outcome) -> None:
            nonlocal finished
            finished += 1
            progress(f"cases ({entry.case.id} done)", finished, len(entries))

        outcomes = runner.run(entries, done)
        paths, rows = bundled_scenes() if scenes else [], []
        if paths:
            read: list[str] = []
            rows = scene_rows(
                paths, seed, jobs, lambda name: progress(f"scenes ({name} done)", _counted(read, name), len(paths))
            )
    cases = [case_record(entry.case, outcomes[entry.case.id]) for entry in entries]
    record = stress_record(about, cases, rows)
    write_stress(out, record)
    return record


def _counted(names: list[str], name: str) -> int:
    names.append(name)
    return len(names)
