"""A flight in the lines that `run --fly` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..report.flight import sentence
from ..report.words import percent, size
from ..summary import plain


def flights_text(results: Mapping[str, Any]) -> str:
    """A few lines for each scene of a results object that was flown through."""
    return "\n".join(
        line for scene in results["scenes"] if scene.get("fly") for line in _lines(scene["name"], scene["fly"])
    )


def _lines(name: str, fly: Mapping[str, Any]) -> list[str]:
    s = {key: float(metric["value"]) for key, metric in fly["summary"].items()}
    return [
        f"{plain(name)}, flight: {sentence(fly)}",
        f"  {s['loaded']:,.0f} tiles loaded, {s['evicted']:,.0f} evicted; a frame uploads {size(s['bytes_median'])} (median), "
        f"{size(s['bytes_most'])} at most; worst pop {percent(s['pop'])}, with blend {percent(s['pop_blend'])}; "
        f"samples unlike the whole texture without a missing tile: {s['unexplained']:,.0f}",
    ]
