"""What each verb does. Every function takes the parsed arguments and returns an exit code; errors are raised."""

from __future__ import annotations

import contextlib
import os
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..reference.errors import InputError

if TYPE_CHECKING:
    from .explain.request import Dissection
    from .flight.plan import FlightPlan

GOOD, FAILED, BAD_INPUT, LACKING, OUR_FAULT, STOPPED = 0, 1, 2, 3, 4, 130


def print_json(value: Any) -> None:
    """One JSON object on standard output. ValueError on NaN or infinity."""
    from .record import dumps

    sys.stdout.write(dumps(value))


def doctor(arguments: Namespace) -> int:
    """Examine the machine."""
    from . import doctor as doctor_module

    with contextlib.redirect_stdout(sys.stderr):
        examination = doctor_module.examine()
    if arguments.json:
        print_json(doctor_module.as_json(examination))
    else:
        print(doctor_module.as_text(examination))
    return GOOD if examination.ok else LACKING


def run(arguments: Namespace) -> int:
    """The main job on the named scenes."""
    from .explain.request import dissection
    from .flight.plan import flight_plan
    from .sources import resolve_scene

    dissected = dissection(arguments.waterfall, arguments.explain)
    flight = flight_plan(arguments.fly, arguments.tile_budget, arguments.frames)
    sources = [resolve_scene(name) for name in arguments.scene]
    more = arguments.explain_leaks or flight is not None or dissected is not None
    return _measure(arguments, sources, _running(arguments, flight, dissected) if more else _run_scenes)


def report(arguments: Namespace) -> int:
    """The main job on all bundled scenes."""
    from .sources import bundled_scenes

    return _measure(arguments, bundled_scenes(), _report_scenes)


def chart(arguments: Namespace) -> int:
    """Many settings of the named scenes."""
    from .sources import resolve_scene

    return _measure(arguments, [resolve_scene(name) for name in arguments.scene], _chart_scenes)


def _run_scenes(*values: Any) -> dict[str, Any]:
    from .run import run_scenes

    return run_scenes(*values)


def _running(
    arguments: Namespace, flight: FlightPlan | None, dissected: Dissection | None
) -> Callable[..., dict[str, Any]]:
    """The run, with what else was asked of it: leaks explained, a flight, the error or a pixel taken apart."""

    def work(
        paths: list[Path], overrides: dict[str, Any], seed: int, out: Path, quiet: bool, line: str
    ) -> dict[str, Any]:
        from .leaks.story import edited_command, typed_scenes
        from .run import run_scenes

        typed = typed_scenes(arguments, paths)

        def command(number: int, name: str) -> str:
            return edited_command(arguments, typed[number], out, name)

        explain = command if arguments.explain_leaks else None
        return run_scenes(paths, overrides, seed, out, quiet, line, explain, flight, dissected)

    return work


def _report_scenes(*values: Any) -> dict[str, Any]:
    from .report_all import report_scenes

    return report_scenes(*values)


def _chart_scenes(*values: Any) -> dict[str, Any]:
    from .chart import chart_scenes

    return chart_scenes(*values)


def _measure(arguments: Namespace, sources: list[Path], work: Callable[..., dict[str, Any]]) -> int:
    """Run `work` on the scenes; print its results object, or a table of it. 1 if a scene failed."""
    from . import summary
    from .options import read_overrides

    bitmap = getattr(arguments, "bitmap", None)  # `report` has none: a file suits one scene
    overrides = read_overrides(arguments.config, arguments.assignments, bitmap)
    check_out(arguments.out)
    with contextlib.redirect_stdout(sys.stderr):  # whatever a library prints, standard output is ours
        results = work(
            list(dict.fromkeys(sources)), overrides, arguments.seed, arguments.out, arguments.quiet, arguments.command
        )
    if arguments.json:
        print_json(results)
    else:
        print(summary.results_table(results))
        print(summary.where(arguments.out))
        if any(scene.get("leaks") for scene in results["scenes"]):
            from .leaks.text import leaks_text

            print(leaks_text(results))
        if any(scene.get("fly") for scene in results["scenes"]):
            from .flight.text import flights_text

            print(flights_text(results))
        if any(scene.get("waterfall") or scene.get("pixel") for scene in results["scenes"]):
            from .explain.text import pixels_text
            from .waterfall.text import waterfalls_text

            print("\n".join(text for text in (waterfalls_text(results), pixels_text(results)) if text))
    return GOOD if all(scene["status"] == "ok" for scene in results["scenes"]) else FAILED


def check_out(out: Path) -> None:
    """Raise InputError now, not after the work, if nothing can be written to `out`. Creates nothing."""
    place = out.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise InputError(f"--out {out}: {place} is not a folder")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"--out {out}: {place} may not be written to")


def bake(arguments: Namespace) -> int:
    """Bake one scene into a file."""
    from . import summary
    from .baking import bake_scene
    from .options import read_overrides
    from .sources import resolve_scene

    overrides = read_overrides(arguments.config, arguments.assignments, arguments.bitmap)
    source = resolve_scene(arguments.scene)
    with contextlib.redirect_stdout(sys.stderr):
        from ..reference.scene import load_scene

        scene = load_scene(source, overrides)
        out = arguments.out or Path(f"{scene.name}.bake")
        check_out(out.absolute().parent)
        made = bake_scene(scene, out, arguments.seed, arguments.quiet)
    if arguments.json:
        print_json(made)
    else:
        print(summary.bake_text(made))
    return GOOD


def relight(arguments: Namespace) -> int:
    """New lights through a bake."""
    from . import summary
    from .relight import relight_file

    out = arguments.out or arguments.bake.with_suffix(".npz")
    for name, given in (("the bake", arguments.bake), ("the lights file", arguments.lights)):
        if given is not None and out.resolve() == given.resolve():
            raise InputError(f"--out {out}: that is {name} itself; choose another name")
    if out.suffix != ".npz" or out.is_dir():
        raise InputError(f"--out {out}: the values are written as a file that ends in .npz; give such a name")
    check_out(out.absolute().parent)
    with contextlib.redirect_stdout(sys.stderr):
        made = relight_file(arguments.bake, arguments.lights, out)
    if arguments.json:
        print_json(made)
    else:
        print(summary.relight_text(made))
    return GOOD


def formfactor(arguments: Namespace) -> int:
    """Form factor between two mesh files."""
    from . import formfactor as formfactor_module
    from .summary import plain

    def say(text: str) -> None:
        print(f"lightgauge: note: {plain(text)}", file=sys.stderr)

    with contextlib.redirect_stdout(sys.stderr):
        found = formfactor_module.pair_of_files(
            arguments.emitter, arguments.receiver, arguments.occluder, arguments.rays, arguments.seed, say
        )
    if arguments.json:
        print_json(formfactor_module.as_json(found))
    else:
        names = plain(arguments.emitter.name), plain(arguments.receiver.name)
        print(formfactor_module.as_text(found, *names))
    return GOOD


def bench(arguments: Namespace) -> int:
    """Measure against peers and limits. 1 if a row misses its target, 3 if the machine lacks what one needs."""
    from .benchmarks import output, registry
    from .progress_bar import ProgressBar

    if arguments.out is not None:
        check_out(arguments.out)
    with contextlib.redirect_stdout(sys.stderr), ProgressBar("bench", arguments.quiet) as progress:
        result = registry.run(arguments.name, arguments.row, progress)
        written = [] if arguments.out is None else output.write_files(arguments.out, result)
    if arguments.json:
        print_json(result)
    else:
        print("\n".join([output.as_text(result), *(f"written: {path}" for path in written)]))
    if result["lacking"]:
        return LACKING
    return FAILED if registry.missed(result) else GOOD


def stress(arguments: Namespace) -> int:
    """The failure catalogue, or seeded faults. 1 if a case fails otherwise than stated, or the faults' report is not good."""
    from .stress import verb

    if arguments.faults and arguments.id:
        raise InputError(f"--faults takes no case, got {' '.join(arguments.id)}; leave one of them out")
    out = arguments.out or Path("reports/faults" if arguments.faults else "reports/stress")
    check_out(out)
    with contextlib.redirect_stdout(sys.stderr):
        made, text = verb.faults(arguments, out) if arguments.faults else verb.cases(arguments, out)
    if arguments.json:
        print_json(made)
    else:
        print(text)
    return GOOD if made["good"] else FAILED


def gate(arguments: Namespace) -> int:
    """Judge a run."""
    from . import gate_output, gates
    from .record import write_bytes_atomic

    limits = gates.only(gates.load_gates(arguments.gates), arguments.scene)
    results = gates.load_run(arguments.run)
    if not (arguments.scene or arguments.every_scene):
        limits, absent = gates.present(limits, results)
        if absent:
            print(f"gate: not judged, not in the run: {', '.join(absent)}", file=sys.stderr)
    judged = gates.judge(results, limits)
    for path, render in ((arguments.junit, gate_output.junit), (arguments.markdown, gate_output.markdown)):
        if path is not None:
            check_out(path.absolute().parent)
            write_bytes_atomic(path, render(judged).encode())
    if arguments.json:
        print_json(gate_output.as_json(judged, arguments.run, arguments.gates))
    else:
        print("\n".join(gate_output.lines(judged)))
    return GOOD if judged.ok else FAILED


VERBS: dict[str, Callable[[Namespace], int]] = {
    "doctor": doctor,
    "run": run,
    "report": report,
    "chart": chart,
    "bake": bake,
    "relight": relight,
    "formfactor": formfactor,
    "bench": bench,
    "stress": stress,
    "gate": gate,
}
