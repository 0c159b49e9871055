"""What `lightgauge stress --faults` does: the campaign run, counted, written and told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...fastpath.device import open_device
from ...reference.errors import InputError
from ...reference.variant import ensure_variant
from ..gates import load_gates
from ..progress_bar import ProgressBar
from ..provenance import provenance
from ..record import write_json_atomic
from ..record_models import JsonObject
from .campaign import CLEAN_SEEDS, Answers, Campaign
from .fault import ROOT
from .page import write_page
from .power import ERROR, energy_power, false_alarms, margins, smallest_caught
from .text import faults_text

GATES = Path("gates.toml")  # of this folder, else of the source tree
MOST_MISSED = 2 / 60  # of the faults
MOST_FALSE = 1 / 200  # of the sound runs
LEAST_POWER = 0.99


def fault_report(out: Path, seed: int, quiet: bool, jobs: int | None, command: str) -> JsonObject:
    """Seed every fault, judge by gates.toml, run the sound product over many seeds; writes `faults.json` and a page.

    Raises InputError for a seed other than 0, which the limits of gates.toml are for, and where there is no gates.toml.
    """
    if seed != 0:
        raise InputError(
            f"--seed {seed}: gates.toml holds for seed 0, and --faults asks what it catches; leave --seed out"
        )
    path = GATES if GATES.exists() else ROOT / GATES
    gates = load_gates(path)
    ensure_variant()
    about = provenance(open_device(), {}, seed, command)
    with ProgressBar("faults", quiet) as progress:
        answers = Campaign(path, jobs).run(lambda n, of: progress("faults and sound runs", n, of))
    record = fault_record(about, answers, {name: dict(limits) for name, limits in gates.root.items()})
    write_json_atomic(out / "faults.json", record)
    write_page(out, record)
    return {**record, "text": faults_text(record, out)}


def fault_record(about: JsonObject, answers: Answers, limits: dict[str, Any]) -> JsonObject:
    """`faults.json`: faults, sizes, sound runs, and what they amount to."""
    whole = [row for row in answers.faults if row["size"] is None]
    # A fault of a size counts once, at the size of the energy error that gates must notice.
    sized = smallest_caught(answers.faults)
    of_size = [row for row in answers.faults if row["size"] == ERROR]
    counted = [*whole, *of_size]
    many = [run for run in answers.clean if run["scene"] in CLEAN_SEEDS]
    alarms, power = false_alarms(many), energy_power([r for r in many if r["metrics"]], limits)
    thin = margins([run for run in answers.clean if run["seed"] == 0], limits)
    others = false_alarms([run for run in answers.clean if run["seed"] == 0])
    missed = [row["id"] for row in counted if not row["caught"]]
    broken = [row["id"] for row in answers.faults if not row["valid"]]
    verdicts = {
        "faults": not broken and len(missed) <= MOST_MISSED * len(counted),
        "false_alarms": alarms["flagged"] <= MOST_FALSE * alarms["runs"] and not others["flagged"],
        "power": all(row["noticed"] >= LEAST_POWER * row["runs"] for row in power),
    }
    return {
        "schema": 1,
        "provenance": about,
        "good": all(verdicts.values()),
        "verdicts": verdicts,
        "summary": {
            "faults": len(counted),
            "caught": len(counted) - len(missed),
            "missed": missed,
            "broken": broken,
            "stopped": [row["id"] for row in counted if row["caught"] and not row["by_gate"]],
        },
        "faults": answers.faults,
        "sizes": sized,
        "false_alarms": alarms,
        "first_seed": others,
        "margins": thin,
        "power": power,
        "gates": _gates(counted),
    }


def _gates(rows: Sequence[JsonObject]) -> list[JsonObject]:
    """How many faults each metric noticed, and how many it alone did."""
    found: dict[str, list[int]] = {}
    for row in rows:
        names = {flag["metric"] for flag in row["flags"]}
        for name in names:
            counts = found.setdefault(name, [0, 0])
            counts[0] += 1
            counts[1] += len(names) == 1
    return [
        {"metric": name, "noticed": n, "alone": alone}
        for name, (n, alone) in sorted(found.items(), key=lambda i: -i[1][0])
    ]
