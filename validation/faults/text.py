"""A campaign of faults as text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..summary import plain, table, where
from .power import ERROR, LEVEL

WIDEST = 60


def faults_text(record: Mapping[str, Any], out: Path) -> str:
    """A line a fault, what was missed, sizes, false alarms, power."""
    rows = [["fault", "size", "caught", "on", "by"], *(_row(row) for row in record["faults"])]
    alarms = record["false_alarms"]
    lines = [table(rows), summary_words(record["summary"])]
    lines += [size_words(row) for row in record["sizes"]]
    lines += [power_words(row) for row in record["power"]]
    lines += [
        alarm_words(alarms),
        *(f"flagged with seed 0: {r['scene']}: {flag_words(r)}" for r in record["first_seed"]["which"]),
    ]
    lines.append(margin_words(record["margins"]))
    lines += [f"flagged: {r['scene']}, seed {r['seed']}: {flag_words(r)}" for r in alarms["which"]]
    lines.append(where(out))
    return "\n".join(plain(line) if "\n" not in line else line for line in lines)


def _row(row: Mapping[str, Any]) -> list[str]:
    by = flag_words(row)
    on = row["flags"][0]["scene"] if row["flags"] else ", ".join(row["scenes"])
    size = "" if row["size"] is None else f"{row['size']:.1%}"
    return [
        plain(c)
        for c in (
            row["id"],
            size,
            "yes" if row["caught"] else "MISSED",
            on,
            by if len(by) <= WIDEST else by[: WIDEST - 1] + "…",
        )
    ]


def flag_words(row: Mapping[str, Any]) -> str:
    """Which metrics noticed, in the order of the gates."""
    return ", ".join(dict.fromkeys(flag["metric"] for flag in row["flags"]))


def size_words(row: Mapping[str, Any]) -> str:
    """Down to which size a fault was caught."""
    caught = "never caught" if row["caught"] is None else f"caught down to {row['caught']:.1%}"
    return f"{row['title']}: {caught}" + ("" if row["missed"] is None else f", missed at {row['missed']:.1%}")


def power_words(row: Mapping[str, Any]) -> str:
    """How surely an error of energy is noticed."""
    return (
        f"{row['error']:+.0%} of energy in {row['stage']}: noticed in {row['noticed']} of {row['runs']} sound runs "
        f"(power at least {row['share'][0]:.3f} with {LEVEL:.0%} confidence"
        + (
            f"; {row['sigmas']:.1f} standard deviations beyond the limit, {row['normal']:.6f} if normal)"
            if "sigmas" in row
            else ")"
        )
    )


def alarm_words(alarms: Mapping[str, Any]) -> str:
    """How often the sound product is flagged."""
    return (
        f"{alarms['flagged']} of {alarms['runs']} sound runs flagged (at most {alarms['share'][1]:.3f} with {LEVEL:.0%} "
        f"confidence); an error of energy is ±{ERROR:.0%}"
    )


def margin_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """How likely one run over all scenes is flagged without a fault, and which limit is nearest."""
    chance = 1.0 - math.prod(1.0 - row["chance"] for row in rows)
    nearest = ", ".join(f"{r['scene']}.{r['metric']} {r['sigmas']:.1f}" for r in rows[:3])
    return (
        f"a sound run over all scenes would be flagged with a chance of {chance:.2g}, if errors are normal; nearest to their "
        f"limits, in standard errors: {nearest}"
    )


def summary_words(s: Mapping[str, Any]) -> str:
    """How many faults were noticed, by what, and which were not."""
    words = f"{s['caught']} of {s['faults']} faults noticed, {s['caught'] - len(s['stopped'])} by gates"
    for name, said in (
        ("stopped", "the others stopped the run"),
        ("missed", "missed"),
        ("broken", "not applied, mend the catalogue"),
    ):
        words += f"; {said}: {', '.join(s[name])}" if s[name] else ""
    return words
