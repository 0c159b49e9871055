"""The files of `run --explain-leaks`: NAME.leaks.json and NAME.edit.json, the one-cell edits of the worst places, and the command lines
that apply and measure them."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...fastpath.device import OpenDevice
from ...reference.bitmap_file import write_bitmap
from ...reference.datatypes import BitmapLayer, Scene
from ...reference.progress import Progress
from .. import cache
from ..record import write_json_atomic
from .explain import Explained, explain


def recalled_story(name: str, scene: Scene, device: OpenDevice, seed: int, progress: Progress) -> Explained:
    """The leaks of a scene, explained now or kept from before under the key `name`."""
    kept = cache.load("leaks", name)
    if kept is None:
        found = explain(scene, device, seed, progress)
        cache.store("leaks", name, _packed(found))
        return found
    return _unpacked(kept)


def _packed(found: Explained) -> cache.Arrays:
    plain = [{"origin": layer.origin.tolist(), "size": layer.size, "mode": layer.mode} for layer in found.layers]
    arrays: cache.Arrays = {"story": cache.pack_json({"record": found.record, "layers": plain})}
    return arrays | {f"cells.{i}": layer.cells for i, layer in enumerate(found.layers)}


def _unpacked(kept: cache.Arrays) -> Explained:
    story = cache.unpack_json(kept["story"])
    layers = tuple(
        BitmapLayer(np.asarray(layer["origin"], np.float64), layer["size"], kept[f"cells.{i}"], layer["mode"])
        for i, layer in enumerate(story["layers"])
    )
    return Explained(story["record"], layers)


def write_story(out: Path, name: str, found: Explained, command: str) -> dict[str, Any]:
    """Write the two files into folder `out`; returns {"leaks": table of the record, "files": names}.

    command: what applies and measures the edit. Without an edit there is no edit file and no command.
    """
    table = dict(found.record)
    files = {"leaks": f"{name}.leaks.json"}
    if table["edit"]["cells"]:
        files["edit"] = f"{name}.edit.json"
        table["command"] = command
        write_bitmap(out / files["edit"], found.layers)
    files |= _singles(out, name, found, table, command)
    edit = [dataclasses.asdict(layer) for layer in found.layers]
    write_json_atomic(out / files["leaks"], {"scene": name, **table, "layers": edit})
    return {"leaks": table, "files": files}


def _singles(out: Path, name: str, found: Explained, table: dict[str, Any], command: str) -> dict[str, str]:
    """Write the one-cell edits of the worst places, NAME.place1.edit.json and so on, the worst first; the files by key. In `table`
    each of these places is given the command that applies and measures its own edit."""
    given = found.layers[: len(found.layers) - len(table["edit"]["layers"])]
    files, rows = {}, []
    for number, row in enumerate(table["worst"], 1):
        own = row.get("edit")
        if own and "cell" in own:
            layer = BitmapLayer(np.asarray(own["origin"], np.float64), own["size_m"], np.array([own["cell"]]), "place")
            files[f"edit_place{number}"] = f"{name}.place{number}.edit.json"
            write_bitmap(out / files[f"edit_place{number}"], (*given, layer))
            row = {
                **row,
                "edit": {**own, "command": _single_command(command, out, files[f"edit_place{number}"], number)},
            }
        rows.append(row)
    table["worst"] = rows
    return files


def _single_command(command: str, out: Path, file: str, number: int) -> str:
    """The command line with the edit of a place instead."""
    words = shlex.split(command)
    for option, value in (("--bitmap", str(out / file)), ("--out", f"{out}-place{number}")):
        if option in words:
            words[words.index(option) + 1] = value
    return shlex.join(words)


def edited_command(given: Namespace, scene: str, out: Path, name: str) -> str:
    """The command line that runs scene `scene`, as it was typed, with the edit in `out` laid over it. given: the parsed
    arguments of the run that wrote the edit."""
    typed = Path(sys.argv[0])
    words = [str(typed) if typed.name == "lightgauge" else "lightgauge", "run", scene]
    if given.config is not None:
        words += ["--config", str(given.config)]
    for assignment in given.assignments:
        words += ["--set", assignment]
    if given.seed:
        words += ["--seed", str(given.seed)]
    words += ["--bitmap", str(out / f"{name}.edit.json"), "--out", f"{out}-edited"]
    return shlex.join(words)


def typed_scenes(given: Namespace, sources: Sequence[Path]) -> list[str]:
    """What was typed for each of the `sources`, in their order."""
    from ..sources import resolve_scene

    typed = {resolve_scene(word): word for word in reversed(given.scene)}
    return [typed.get(path, str(path)) for path in sources]
