"""The command line's grammar: verbs, options, help with examples. No heavy imports, so `--help` is instant."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, NoReturn

EXIT_CODES = """exit codes:
  0 good   1 a gate or a scene failed   2 wrong use or bad input   3 the environment lacks something
  4 our own fault   130 stopped with Ctrl-C (finished work is kept)"""

SCENE_HELP = "name under scenes/ or $LIGHTGAUGE_SCENES, or a path (scene.toml, .xml, .glb, .gltf, .obj, .ply)"
EXAMPLES = {
    "doctor": "lightgauge doctor\nlightgauge doctor --json",
    "run": "lightgauge run cornell\n"
    "lightgauge run cornell two-rooms sphere --out /tmp/a --json\n"
    "lightgauge run house --set placement.min_voxel=0.25 --seed 3\n"
    "lightgauge run two-rooms --set scene.rotation=30 --set placement.min_voxel=0.5 --explain-leaks --out /tmp/l\n"
    "lightgauge run house --waterfall --explain inside:160,120 --out /tmp/w --json\n"
    "lightgauge run two-rooms --bitmap edit.json\n"
    "lightgauge run valley --fly orbit --tile-budget 2000 --out /tmp/f --json\n"
    "lightgauge run model.glb --set 'lights.sun.direction=[-0.4,-1,-0.3]'",
    "report": "lightgauge report\nlightgauge report --out /tmp/all --quiet",
    "chart": "lightgauge chart cornell\nlightgauge chart cornell --out /tmp/ch --json",
    "bake": "lightgauge bake house --out house.bake\n"
    "lightgauge bake house --set radiosity.noise=9e-4 --set radiosity.patch_size=4 --json",
    "relight": "lightgauge relight house.bake --lights scenes/house/evening.toml --json\n"
    "lightgauge relight house.bake --out noon.npz",
    "formfactor": "lightgauge formfactor floor.ply ceiling.ply\n"
    "lightgauge formfactor lamp.obj wall.ply --occluder shelf.ply --occluder door.obj --rays 4194304\n"
    "lightgauge formfactor dome.ply dome.ply --json",
    "bench": "lightgauge bench transport\n"
    "lightgauge bench transport --json --out /tmp/bench\n"
    "lightgauge bench transport --row rays_vs_embree_2k --row boxinbox_hybrid_rms\n"
    "lightgauge bench placement --row valley_place_s",
    "stress": "lightgauge stress --out /tmp/st --json\n"
    "lightgauge stress A3 D4 --quiet\n"
    "lightgauge stress G\n"
    "lightgauge stress --faults --out /tmp/fa --json",
    "gate": "lightgauge gate reports/latest\n"
    "lightgauge gate reports/run --scene cornell --scene sphere\n"
    "lightgauge gate /tmp/a --gates gates.toml --junit gate.xml --markdown gate.md",
}


class Parser(argparse.ArgumentParser):
    """Argparse with our one-line error."""

    def error(self, message: str) -> NoReturn:
        """Print usage and the message, exit 2."""
        self.print_usage(sys.stderr)
        self.exit(2, f"lightgauge: error: {message} (see {self.prog} --help)\n")


def build_parser(version: str) -> argparse.ArgumentParser:
    """The whole grammar. The verb is in `arguments.verb`."""
    parser = Parser(
        prog="lightgauge",
        description="Reference implementation and validator for probe-volume global illumination.",
        epilog=f"{EXIT_CODES}\n\n`lightgauge VERB --help` explains one verb with examples.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"lightgauge {version}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=Parser)
    _doctor(verbs)
    _measuring(verbs, "run", "bake, update, sample, ground truth, metrics, pictures, page", "reports/run", scenes=True)
    _measuring(verbs, "report", "`run` over all bundled scenes", "reports/latest", scenes=False)
    _measuring(verbs, "chart", "speed against accuracy: many settings, the Pareto front", "reports/chart", scenes=True)
    _bake(verbs)
    _relight(verbs)
    _formfactor(verbs)
    _bench(verbs)
    _stress(verbs)
    _gate(verbs)
    return parser


def _verb(verbs: Any, name: str, text: str) -> argparse.ArgumentParser:
    examples = "\n".join("  " + line for line in EXAMPLES[name].splitlines())
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=f"examples:\n{examples}\n\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    return parser


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")


def _doctor(verbs: Any) -> None:
    _json(_verb(verbs, "doctor", "what this machine has and lacks, and the line that mends it"))


def _measuring(verbs: Any, name: str, text: str, out: str, *, scenes: bool) -> None:
    """A verb that bakes and measures: scenes in, results and a page out."""
    parser = _verb(verbs, name, text)
    if scenes:
        parser.add_argument("scene", nargs="+", metavar="SCENE", help=SCENE_HELP)
        _bitmap(parser)
    _settings(parser)
    parser.add_argument(
        "--out", type=Path, default=Path(out), metavar="DIR", help=f"folder for page and results (default {out})"
    )
    if name == "run":
        parser.add_argument(
            "--explain-leaks",
            action="store_true",
            help="say which walls leak, from which probes, and write and measure the bitmap edit that stops it",
        )
        _dissection(parser)
        _flight(parser)
    _json(parser)
    _quiet(parser)


def _dissection(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--waterfall",
        action="store_true",
        help="take the error apart, link by link from the path-traced truth to the sampled pixel, as figures and pictures",
    )
    parser.add_argument(
        "--explain",
        metavar="[CAMERA:]X,Y",
        help="explain one pixel (of the first camera): its eight probes, what each gives, what stands between, and its waterfall",
    )


def _flight(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fly",
        metavar="PATH",
        help="also stream the tiles around a viewer who takes this path, and measure every frame: orbit, line or teleport",
    )
    parser.add_argument(
        "--tile-budget", type=int, metavar="N", help="tiles that fit into the flight's cache (default 2000)"
    )
    parser.add_argument("--frames", type=int, metavar="N", help="frames of the flight (default 120)")


def _bitmap(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bitmap",
        type=Path,
        metavar="FILE",
        help="voxel bitmap laid over what the scene marks, in place of its own placement.bitmap; after --set",
    )


def _settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML table laid over each scene's own settings")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="assignments",
        help="one setting, as in placement.min_voxel=0.25; after --config; repeatable",
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of all random numbers (default 0)")


def _quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")


def _bake(verbs: Any) -> None:
    parser = _verb(verbs, "bake", "all that does not depend on the lighting, into one checksummed file")
    parser.add_argument("scene", metavar="SCENE", help=SCENE_HELP)
    _bitmap(parser)
    _settings(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="the bake (default SCENE.bake in this folder)")
    _json(parser)
    _quiet(parser)


def _relight(verbs: Any) -> None:
    parser = _verb(verbs, "relight", "new lights through a bake: patches, probes, lumels and cubemaps")
    parser.add_argument("bake", type=Path, metavar="BAKE", help="file that `lightgauge bake` wrote")
    parser.add_argument(
        "--lights", type=Path, metavar="FILE", help="TOML with `scene = NAME` and [lights] (default: the scene's own)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="values as .npz (default BAKE with .npz for its suffix)"
    )
    _json(parser)


def _formfactor(verbs: Any) -> None:
    parser = _verb(verbs, "formfactor", "the form factor between two meshes, with its standard error")
    parser.add_argument(
        "emitter",
        type=Path,
        metavar="FROM",
        help="mesh that emits, PLY or OBJ; its front is where corners run counter-clockwise",
    )
    parser.add_argument("receiver", type=Path, metavar="TO", help="mesh that receives, on its front")
    parser.add_argument(
        "--occluder",
        type=Path,
        action="append",
        default=[],
        metavar="MESH",
        help="stands between, opaque on both sides; repeatable",
    )
    parser.add_argument(
        "--rays", type=int, default=1 << 20, metavar="N", help="rays for what has no closed form (default 1048576)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of all random numbers (default 0)")
    _json(parser)


def _bench(verbs: Any) -> None:
    parser = _verb(verbs, "bench", "speed and memory as ratios to peers and to the machine's limits")
    parser.add_argument("name", nargs="*", metavar="NAME", help="bench: transport, placement, fastpath (default all)")
    parser.add_argument(
        "--row", action="append", default=[], metavar="NAME", help="measure only this row; repeatable (default all)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="also write bench.json and the error-time curve here")
    _json(parser)
    _quiet(parser)


def _stress(verbs: Any) -> None:
    parser = _verb(
        verbs, "stress", "the failure catalogue: each case provoked, measured, judged, followed to where it breaks"
    )
    parser.add_argument(
        "id", nargs="*", metavar="ID", help="case, as A3, or group, as G (default all, and the bundled scenes)"
    )
    parser.add_argument(
        "--faults",
        action="store_true",
        help="instead, seed faults into the product in memory and say which the gates catch",
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of all random numbers (default 0)")
    parser.add_argument(
        "--jobs", type=_jobs, metavar="N", help="cases at a time (default one a core, as memory allows)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder for page and record (default reports/stress, with --faults reports/faults)",
    )  # fmt: skip
    _json(parser)
    _quiet(parser)


def _gate(verbs: Any) -> None:
    parser = _verb(verbs, "gate", "pass or fail a run against limits, judged with each metric's interval")
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run, or its results.json")
    parser.add_argument(
        "--gates", type=Path, default=Path("gates.toml"), metavar="FILE", help="limits (default gates.toml)"
    )
    parser.add_argument(
        "--scene", action="append", default=[], metavar="NAME", help="judge only this scene's limits; repeatable"
    )
    parser.add_argument(
        "--every-scene", action="store_true", help="fail for scenes that have limits but are not in the run"
    )
    _json(parser)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="also write JUnit XML")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write a Markdown table")


def _seed(text: str) -> int:
    return _whole(text, 0, 2**32 - 1, "0 to 2^32 - 1")


def _jobs(text: str) -> int:
    return _whole(text, 1, 64, "1 to 64")


def _whole(text: str, low: int, high: int, wanted: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"expected {wanted}, got {text[:40]!r}")
    return value
