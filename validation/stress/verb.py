"""`lightgauge stress`, from parsed arguments to a record and its text. Ids are checked before anything heavy is imported."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from ..record_models import JsonObject


def cases(arguments: Namespace, out: Path) -> tuple[JsonObject, str]:
    """The chosen cases, or all and the bundled scenes. InputError for an unknown id."""
    from .catalogue import chosen

    entries = chosen(arguments.id)
    from .story import stress
    from .text import stress_text

    record = stress(
        entries, out, arguments.seed, arguments.quiet, arguments.jobs, arguments.command, scenes=not arguments.id
    )
    return record, stress_text(record, out)


def faults(arguments: Namespace, out: Path) -> tuple[JsonObject, str]:
    """Faults seeded into the product: which the gates catch. The report says itself whether it is `good`."""
    from ..faults.story import fault_report

    report: JsonObject = fault_report(out, arguments.seed, arguments.quiet, arguments.jobs, arguments.command)
    return report, str(report.get("text", ""))
