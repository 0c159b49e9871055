"""The page of a stress run: heat map, table, a curve a case. Beside it `stress.json` and its schema; the page is written last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ..record import write_bytes_atomic, write_json_atomic
from ..record_models import JsonObject
from ..report.page import TEMPLATES, content_policy, environment, provenance
from ..report.svg import tag
from ..summary import number
from .catalogue import GROUPS
from .curves import COLOURS, draw_case
from .heat_map import BELOW_NOISE, STATUS_FILLS, STEPS, draw_heat_map, is_noise
from .record import SCHEMA_FILE, status_words
from .text import bands_words, breaks_words, expected_words, measured_words

BADGES = {
    "pass": "good",
    "fails as stated": "fair",
    "below noise": "mute",
    "fail": "bad",
    "crashed": "bad",
    "out of scope": "mute",
}


def write_stress(out: Path, record: JsonObject) -> None:
    """Write `stress.json`, `stress.schema.json` and `index.html` into `out`."""
    html = render(record)
    write_bytes_atomic(out / "stress.schema.json", SCHEMA_FILE.read_bytes())
    write_json_atomic(out / "stress.json", record)
    write_bytes_atomic(out / "index.html", html.encode("utf-8", "replace"))


def render(record: Mapping[str, Any]) -> str:
    """The page's HTML."""
    style = (TEMPLATES / "page.css").read_text("utf-8")
    cases = [_case(case) for case in record["cases"]]
    groups = [(name, words, [c for c in cases if c["id"][0] == name]) for name, words in GROUPS.items()]
    return environment().get_template("stress.html.j2").render(
        policy=content_policy(style, ""),
        style=Markup(style),
        record=record,
        badges=[(status, count, BADGES[status]) for status, count in record["summary"].items()],
        cases=cases,
        groups=[(name, words, those) for name, words, those in groups if those],
        heat_map=Markup(draw_heat_map(record)),
        steps=_steps(),
        statuses=[(Markup(_swatch(fill)), words) for words, fill in STATUS_FILLS.items()],
        over=_over(record),
        provenance=provenance(record["provenance"]),
    )  # fmt: skip


def _case(case: Mapping[str, Any]) -> JsonObject:
    """What the page says of a case."""
    breaking = case.get("breaking") or {}
    status = status_words(case)
    return {
        **case,
        "words": status,
        "badge": BADGES[status],
        "svg": Markup(draw_case(case)),
        "expected": expected_words(case),
        "measured": measured_words(case),
        "breaks": breaks_words(case),
        "said": breaking.get("said", ""),
        "legend": [
            (Markup(_swatch(COLOURS[i % len(COLOURS)])), curve, _wanted(curve))
            for i, curve in enumerate(case["curves"])
        ],
        "crash": case.get("crash"),
    }


def _wanted(curve: Mapping[str, Any]) -> str:
    """What a curve should read, and what is stated where it cannot."""
    good, stated = bands_words(curve, "good"), bands_words(curve, "stated")
    words = [f"good {good}"] if good else []
    return "; ".join(
        [*words, f"{'where the method fails' if good else 'without the remedy'} {stated}"] if stated else words
    )


def _steps() -> list[tuple[Markup, str]]:
    """The legend of the heat map's colours."""
    words, below = [], 0.0
    for most, fill in STEPS:
        words.append((Markup(_swatch(fill)), f"over {below:g}" if most == float("inf") else f"up to {most:g}"))
        below = most
    return [*words, (Markup(_swatch(BELOW_NOISE)), "under twice its standard error, written beneath it")]


def _swatch(fill: str) -> str:
    return tag(
        "svg", tag("rect", width=12.0, height=12.0, rx=2.0, fill=fill), viewBox="0 0 12 12", width=12.0, height=12.0
    )


def _over(record: Mapping[str, Any]) -> list[JsonObject]:
    """The cells that are over their limit, the worst first; not those that noise does not tell from nothing."""
    found = [{"scene": scene["name"], "id": name, **c, "shown": _with_error(c), "most": number(float(c["limit"])),
              "times": number(float(c["ratio"]))}
             for scene in record["scenes"] for name, c in scene["cells"].items() if c["ratio"] > 1.0 and not is_noise(c)]  # fmt: skip
    return sorted(found, key=lambda c: -c["ratio"])


def _with_error(found: Mapping[str, Any]) -> str:
    """A cell's figure and its standard error, where it has one."""
    error = f" ± {number(float(found['se']))}" if found.get("se") else ""
    return f"{number(float(found['value']))}{error}"
