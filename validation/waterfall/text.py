"""A waterfall in the lines that `run --waterfall` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..summary import plain, table


def waterfalls_text(results: Mapping[str, Any]) -> str:
    """A table for each scene of a results object that has a waterfall."""
    return "\n".join(_lines(scene["name"], scene["waterfall"]) for scene in results["scenes"] if scene.get("waterfall"))


def _lines(name: str, found: Mapping[str, Any]) -> str:
    whole = found["sets"]["camera"]
    labels = {link["name"]: link["label"] for link in found["links"]}
    rows = [["link", "signed, %", "RMS, %", "correlation", "share of squared error, %"]]
    for link, label in labels.items():
        one = whole["links"][link]
        rows.append(
            [
                label,
                *(
                    _written(one[k], s)
                    for k, s in (("signed", 100.0), ("rms", 100.0), ("correlation", 1.0), ("share", 100.0))
                ),
            ]
        )
    rows.append(["noise of the reference", "", "", "", f"{100.0 * whole['remainder']:.2f}"])
    rows.append(["whole", _written(whole["signed"], 100.0), _written(whole["rms"], 100.0), "", "100"])
    head = f"{plain(name)}, waterfall of the error at {whole['points']:,} camera points (± is one standard error):"
    return "\n".join([head, table(rows), *(plain(note) for note in found["notes"])])


def _written(metric: Mapping[str, Any], scale: float) -> str:
    return f"{scale * metric['value']:+.3f} ± {scale * metric.get('se', 0.0):.3f}"
