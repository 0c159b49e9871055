"""A child process that runs the gates with a fault in force: `python -m lightgauge.validation.faults.worker ID SIZE`, or without
one over some seeds: `… worker clean SCENE FIRST COUNT`.

It answers on standard output, one JSON object a line. What a fault does to the process is for the parent to say.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from ..stress.worker import Answers, leave_with_parent, own_output
from .catalogue import find_fault
from .fault import Fault
from .inject import inject

CLEAN = "clean"
THE_RUN = "the run"  # what is noticed where a run does not end well


def main(given: list[str] | None = None) -> int:
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("gates")
    parser.add_argument("id")
    parser.add_argument("rest", nargs="*")
    options = parser.parse_args(given)
    answers = Answers(own_output())
    leave_with_parent()
    if options.id == CLEAN:
        scene, first, count, *fly = options.rest
        clean(scene, range(int(first), int(first) + int(count)), options.gates, bool(fly), answers)
    else:
        size = float(options.rest[0]) if options.rest else None
        fault = find_fault(options.id)
        inject(fault, size)
        answers.say(injected=fault.id)
        faulty(fault, options.gates, answers)
    answers.say(done=True)
    return 0


def faulty(fault: Fault, gates: str, answers: Answers) -> None:
    """Scene by scene until a gate notices."""
    for name in fault.scenes:
        began = time.perf_counter()
        try:
            flags, _ = run_gates(name, 0, gates, fault.fly)
        except (SyntaxError, NameError, ImportError):  # no fault of the product's, but one that cannot run at all
            raise
        except Exception as error:  # a refusal, or a crash: nobody would take that for a good run
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            flags = [{"scene": name, "metric": THE_RUN, "reason": reason, "limit": "must end well"}]
        answers.say(scene=name, flags=flags, seconds=time.perf_counter() - began)
        if flags:
            return


def clean(name: str, seeds: range, gates: str, fly: bool, answers: Answers) -> None:
    """The sound product on one scene, seed by seed; fly: with a flight."""
    for seed in seeds:
        began = time.perf_counter()
        flags, metrics = run_gates(name, seed, gates, fly)
        answers.say(seed=seed, scene=name, flags=flags, metrics=metrics, seconds=time.perf_counter() - began)


def run_gates(name: str, seed: int, gates: str, fly: bool = False) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Gates that a scene fails, and the metrics that gates ask about."""
    from pathlib import Path

    from ...fastpath.device import open_device
    from ...reference.scene import load_scene
    from ...reference.variant import ensure_variant
    from ..gates import load_gates
    from ..sources import resolve_scene
    from .gate_run import flagged, gate_metrics

    ensure_variant()
    limits = load_gates(Path(gates))
    metrics = gate_metrics(load_scene(resolve_scene(name), {}), open_device(), seed, fly)
    found = flagged(name, metrics, limits, fly)
    flags = [
        {"scene": j.scene, "metric": j.metric, "reason": j.reason, "limit": j.limit, "value": j.value, "se": j.se}
        for j in found
    ]
    asked = {metric: metrics[metric] for metric in limits.root[name] if metric in metrics}
    return flags, asked


if __name__ == "__main__":
    sys.exit(main())
