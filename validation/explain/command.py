"""The command line that explains a pixel of a page, to be shown where one is clicked."""

from __future__ import annotations

import shlex
from pathlib import Path

VALUED = ("--config", "--set", "--seed", "--bitmap", "--out")
PIXEL = "{pixel}"


def explain_command(command: str, scene: str, camera: str) -> str:
    """`command`, the one that made the page, as one that explains a pixel of `scene`: `{pixel}` stands for X,Y.

    What was set stays; other scenes, and what else was asked for, goes. A scene that was typed as a path stays that path.
    """
    try:
        words = shlex.split(command)
    except ValueError:
        words = []
    typed, kept, at = scene, list[str](), 2
    while at < len(words):
        word = words[at]
        if word in VALUED and at + 1 < len(words):
            kept += words[at : at + 2] if word != "--out" else [word, f"{words[at + 1]}-pixel"]
            at += 1
        elif word.startswith(tuple(f"{v}=" for v in VALUED)):
            kept.append(f"{word}-pixel" if word.startswith("--out=") else word)
        elif word in ("--explain", "--fly", "--tile-budget", "--frames"):
            at += 1
        elif scene in (word, Path(word).stem, Path(word).parent.name):
            typed = word
        at += 1
    line = shlex.join(["lightgauge", "run", typed, *kept, "--explain"])
    return f"{line} {shlex.quote(camera)}:{PIXEL}"
