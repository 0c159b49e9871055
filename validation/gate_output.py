"""A gate's judgements as lines, JSON, JUnit XML and Markdown."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from .gates import GateReport, Judgement
from .summary import plain


def measured(item: Judgement) -> str:
    """`0.12 ± 0.003 (n 2099)`, without ± where the metric has no standard error, or a dash."""
    if item.value is None:
        return "-"
    spread = "" if item.se is None else f" ± {item.se:.2g}"
    return f"{item.value:.4g}{spread} (n {item.n})"


def lines(report: GateReport) -> list[str]:
    """One line per failure, then the summary."""
    failed = [
        f"FAIL {plain(item.scene)}.{plain(item.metric)}: {measured(item)}, limit {item.limit}: {plain(item.reason)}"
        for item in report.failures
    ]
    return [*failed, summary(report)]


def summary(report: GateReport) -> str:
    """`gate: 12 of 13 limits hold, 1 fails`."""
    total, bad = len(report.judgements), len(report.failures)
    return f"gate: {total - bad} of {total} limits hold" + (f", {bad} fail" if bad else "")


def as_json(report: GateReport, results: Path, gates: Path) -> dict[str, Any]:
    """The object `gate --json` prints."""
    return {
        "schema": 1,
        "ok": report.ok,
        "results": str(results),
        "gates": str(gates),
        "judgements": [
            {key: value for key, value in asdict(item).items() if value is not None} for item in report.judgements
        ],
    }


def junit(report: GateReport) -> str:
    """JUnit XML: a test suite per scene, a test case per metric."""
    root = ElementTree.Element("testsuites", _counts(report.judgements))
    for scene in dict.fromkeys(item.scene for item in report.judgements):
        items = tuple(item for item in report.judgements if item.scene == scene)
        suite = ElementTree.SubElement(root, "testsuite", {"name": plain(scene), **_counts(items)})
        for item in items:
            name = {"classname": f"gate.{plain(scene)}", "name": plain(item.metric), "time": "0"}
            case = ElementTree.SubElement(suite, "testcase", name)
            if item.verdict == "fail":
                text = f"{measured(item)}, limit {item.limit}"
                ElementTree.SubElement(case, "failure", {"message": plain(item.reason)}).text = text
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _counts(items: tuple[Judgement, ...]) -> dict[str, str]:
    return {"tests": str(len(items)), "failures": str(sum(item.verdict == "fail" for item in items)), "errors": "0"}


def markdown(report: GateReport) -> str:
    """A table, failures first, for a pull request's comment."""
    head = [
        f"**{summary(report)}**",
        "",
        "| | scene | metric | value ± se | limit | why |",
        "|---|---|---|---|---|---|",
    ]
    ordered = sorted(report.judgements, key=lambda item: item.verdict != "fail")
    rows = [
        f"| {item.verdict} | {_cell(item.scene)} | {_cell(item.metric)} | {measured(item)} | {item.limit}"
        f" | {_cell(item.reason)} |"
        for item in ordered
    ]
    return "\n".join([*head, *rows]) + "\n"


def _cell(text: str) -> str:
    """Text that can neither break the table nor become markup."""
    escaped = plain(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for character in "\\|`*_[]":
        escaped = escaped.replace(character, "\\" + character)
    return escaped
