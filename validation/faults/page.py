"""The page of a campaign of faults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ..record import write_bytes_atomic
from ..report.page import TEMPLATES, content_policy, environment, provenance
from ..report.svg import tag, text
from .text import alarm_words, flag_words, margin_words, power_words, size_words, summary_words

ROW, LEFT, WIDTH = 22.0, 210.0, 900.0


def write_page(out: Path, record: Mapping[str, Any]) -> None:
    """Write `index.html` into `out`."""
    style = (TEMPLATES / "page.css").read_text("utf-8")
    html = (
        environment()
        .get_template("faults.html.j2")
        .render(
            policy=content_policy(style, ""),
            style=Markup(style),
            record=record,
            summary=summary_words(record["summary"]),
            faults=[
                {**row, "by": flag_words(row), "percent": "" if row["size"] is None else f"{row['size']:.1%}"}
                for row in record["faults"]
            ],
            sizes=[size_words(row) for row in record["sizes"]],
            power=[power_words(row) for row in record["power"]],
            alarms=alarm_words(record["false_alarms"]),
            margins=margin_words(record["margins"]),
            bars=_bars(record["gates"]),
            provenance=provenance(record["provenance"]),
        )
    )
    write_bytes_atomic(out / "index.html", html.encode("utf-8", "replace"))


def _bars(gates: list[Mapping[str, Any]]) -> Markup:
    """How many faults each metric noticed; the dark part it alone did."""
    most = max((g["noticed"] for g in gates), default=1)
    parts = []
    for i, gate in enumerate(gates):
        y, long = ROW * i, (WIDTH - LEFT - 60.0) / most
        parts += [
            text(gate["metric"], LEFT - 8.0, y + 15.0, text_anchor="end", fill="currentColor", font_size=13.0),
            tag("rect", x=LEFT, y=y + 4.0, width=long * gate["noticed"], height=ROW - 8.0, fill="#67a9cf"),
            tag("rect", x=LEFT, y=y + 4.0, width=long * gate["alone"], height=ROW - 8.0, fill="#2166ac"),
            text(
                f"{gate['noticed']}, {gate['alone']} alone",
                LEFT + long * gate["noticed"] + 6.0,
                y + 15.0,
                fill="currentColor",
                font_size=13.0,
            ),
        ]
    height = ROW * max(len(gates), 1)
    return Markup(tag("svg", *parts, viewBox=f"0 0 {WIDTH:g} {height:g}", width=WIDTH, height=height, role="img",
                      aria_label="how many faults each metric noticed"))  # fmt: skip
