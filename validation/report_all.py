"""What `make report` does: the bundled scenes measured, and the speed-against-accuracy chart of one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..fastpath.device import open_device
from .chart import chart
from .progress_bar import ProgressBar
from .run import load_all, run_scenes

CHARTED = ("cornell",)


def report_scenes(
    sources: Sequence[Path], overrides: Mapping[str, Any], seed: int, out: Path, quiet: bool, command: str
) -> dict[str, Any]:
    """As `run_scenes`, after charting the scenes in CHARTED: a page shows the charts that are at hand."""
    for scene in load_all(sources, overrides):
        if scene.name in CHARTED:
            with ProgressBar(scene.name, quiet) as progress:
                chart(scene, open_device(), seed, progress)
    return run_scenes(sources, overrides, seed, out, quiet, command)
