"""Numbers and metrics in plain words: how they are written, what they mean, what is good.

An interval is the 95 % one, value ± 1.96 standard errors. A metric is judged against its guide value with the interval:
`good` when all of it lies within, `over` when none of it does, else `unsure`. The texts are in `templates/words.toml`.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

Z95 = 1.96
TIED = "\u00a0"  # no line breaks between a number and its sign
SUFFIXES = {"": "seen by the cameras", "_surface": "on probe-lit surfaces", "_volume": "inside the probe volumes"}
BOUNDS = {"at least": "\u2265\u00a0", "at most": "\u2264\u00a0"}
Kind = Literal["percent", "signed", "times", "plain"]
Judgement = Literal["good", "over", "unsure", ""]


@dataclass(frozen=True)
class Meaning:
    """A metric for a reader: name, how its value is written, what it says, what is good, the guide value."""

    label: str
    kind: Kind
    says: str
    good: str = ""
    limit: float | None = None


TABLES = tomllib.loads((Path(__file__).with_name("templates") / "words.toml").read_text("utf-8"))
MEANINGS: dict[str, Meaning] = {name: Meaning(**entry) for name, entry in TABLES["metric"].items()}
COSTS: dict[str, tuple[str, str]] = {name: (entry["label"], entry["says"]) for name, entry in TABLES["cost"].items()}


def meaning(name: str) -> tuple[Meaning | None, str, str]:
    """Metric name -> (its meaning or None, base name, point set's suffix, or words for it)."""
    if name in MEANINGS:
        return MEANINGS[name], name, ""
    for suffix in ("_surface", "_volume"):
        base = name.removesuffix(suffix)
        if base != name and base in MEANINGS:
            return MEANINGS[base], base, suffix
    base, camera, seen_by = name.partition("_camera_")
    if camera and base in MEANINGS:
        return MEANINGS[base], base, f"seen by camera {seen_by} alone"
    return None, name, ""


def number(value: float, figures: int = 3) -> str:
    """So many significant figures; scientific below 1e-3, whole and grouped where large."""
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -3 <= exponent < 9:
        mantissa, power = f"{value:.{figures - 1}e}".split("e")
        return f"{mantissa}e{int(power)}"
    return f"{value:,.{max(figures - 1 - exponent, 0)}f}"


def percent(value: float, figures: int = 3) -> str:
    """0.0912 -> `9.12 %`, the blank one that does not break."""
    return f"{number(100.0 * value, figures)}{TIED}%"


def interval(value: float, half: float) -> tuple[str, str]:
    """(value, half width): the half width with two figures, the value down to the same place."""
    if half <= 0.0:
        return number(value), ""
    if abs(value) < 1e-3 and half < 1e-3:
        return number(value), number(half, 2)
    places = min(max(1 - math.floor(math.log10(half)), 0), 5)
    return f"{value:,.{places}f}", f"{half:,.{places}f}"


def written(metric: Mapping[str, Any], kind: Kind, unit: str = "") -> tuple[str, str]:
    """(value with its unit; its 95 % interval, `± half width` or, where it is not symmetric, `low to high`, or an empty string)."""
    scale = 100.0 if kind in ("percent", "signed") else 1.0
    sign = f"{TIED}%" if scale > 1.0 else "\u00d7" if kind == "times" else f" {unit}" if unit else ""
    shown, half = interval(scale * float(metric["value"]), scale * Z95 * float(metric.get("se") or 0.0))
    spread = f"±{TIED}{half}{sign}" if half else ""
    if ends := metric.get("interval"):
        shown = number(scale * float(metric["value"]))
        spread = " to ".join(number(scale * float(end)) for end in ends) + sign
    shown = f"+{shown}" if kind == "signed" and metric["value"] > 0 else shown
    return BOUNDS.get(str(metric.get("bound", "")), "") + shown + sign, spread


def judge(metric: Mapping[str, Any], limit: float | None) -> Judgement:
    """Where the 95 % interval of |value| lies against the guide value."""
    if limit is None:
        return ""
    if metric.get("below_noise"):
        return "unsure"
    value, half = abs(float(metric["value"])), Z95 * float(metric.get("se") or 0.0)
    low, high = metric.get("interval") or (value - half, value + half)
    return "good" if high <= limit else "over" if low > limit else "unsure"


def amount(key: str, value: object) -> str:
    """A cost with its unit, guessed from the end of its name: `_bytes`, `_mib`, `_s`, `_ms`, `_ns`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value) if value is not None else "not measured"
    if key.endswith("bytes"):
        return size(float(value))
    if key.endswith("_mib"):
        return size(float(value) * 1048576.0)
    for suffix, factor in (("_ns", 1e-9), ("_us", 1e-6), ("_ms", 1e-3), ("_s", 1.0)):
        if key.endswith(suffix):
            return duration(float(value) * factor)
    whole = float(value).is_integer()
    return f"{int(value):,}" if whole and abs(value) < 1e7 else number(float(value))


def size(value: float) -> str:
    """Bytes with a binary unit."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if abs(value) < 1024.0 or unit == "GiB":
            break
        value /= 1024.0
    return f"{value:.0f} {unit}" if unit == "B" or value >= 100.0 or value == round(value) else f"{value:.1f} {unit}"


def duration(seconds: float) -> str:
    """Seconds with the unit that suits."""
    if abs(seconds) >= 120.0:
        return f"{int(seconds // 60)} min {int(seconds % 60)} s"
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("\u00b5s", 1e6)):
        if abs(seconds) * factor >= 1.0 or seconds == 0.0:
            return f"{number(seconds * factor)} {unit}"
    return f"{number(seconds * 1e9)} ns"
