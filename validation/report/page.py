"""The report: one self-contained `index.html`, and beside it `results.json`, its schema and the pictures as OpenEXR.

Everything a scene or a machine says reaches the page through Jinja's autoescape or, in data blocks, as JSON without `<`,
`>` and `&`; the content policy allows only this page's own script and style, by hash (failure-catalogue G9).
`index.html` is written last: a page that is there is complete.
"""

from __future__ import annotations

import base64
import copy
import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..record import SCHEMA_FILE, validate_results, write_bytes_atomic, write_json_atomic
from ..record_models import JsonObject
from .chart import METHODS, draw_chart, fronts
from .exr import write_exr
from .pictures import ERROR_STOPS, SceneView
from .sections import scene_section, summary_row
from .svg import printable, tag
from .verdict import badness
from .words import percent

TEMPLATES = Path(__file__).with_name("templates")


def write_report(out: Path, results: Mapping[str, Any], views: Sequence[SceneView]) -> JsonObject:
    """Write the whole report into folder `out` (made if missing).

    results: the record, see results.schema.json; left as it is. Returns what results.json holds: it names the files too.
    views: pictures of the scenes, matched by `view.pictures.scene`; any number, also none.
    """
    record = copy.deepcopy(dict(results))
    validate_results(record)
    names = exr_names(views)
    for view, name in zip(views, names, strict=True):
        write_exr(out / name, view.pictures)
        for scene in record["scenes"]:
            if scene["name"] == view.pictures.scene:
                scene.setdefault("files", {}).setdefault("exr", {})[view.pictures.camera] = name
    html = render(record, views, names)
    write_bytes_atomic(out / "results.schema.json", SCHEMA_FILE.read_bytes())
    write_json_atomic(out / "results.json", record)
    write_bytes_atomic(out / "index.html", html.encode("utf-8", "replace"))
    return record


def exr_names(views: Sequence[SceneView]) -> list[str]:
    """A harmless, distinct file name for each view, relative to the report's folder."""
    found: list[str] = []
    taken: Counter[str] = Counter()
    for view in views:
        words = f"{view.pictures.scene}-{view.pictures.camera}".lower()
        slug = re.sub(r"[^a-z0-9]+", "-", words).strip("-")[:80] or "view"
        taken[slug] += 1
        found.append(f"exr/{slug}.{taken[slug]}.exr" if taken[slug] > 1 else f"exr/{slug}.exr")
    return found


def render(record: JsonObject, views: Sequence[SceneView], exr: Sequence[str]) -> str:
    """The page's HTML. exr: file name of each view."""
    style = (TEMPLATES / "page.css").read_text("utf-8")
    script = (TEMPLATES / "page.js").read_text("utf-8")
    charts = record.get("charts", [])
    scenes = sorted(record["scenes"], key=badness, reverse=True)
    named = {scene["name"] for scene in scenes}
    sections = []
    for i, scene in enumerate(scenes):
        mine = [(v, name) for v, name in zip(views, exr, strict=True) if v.pictures.scene == scene["name"]]
        drawn = [chart_context(c) for c in charts if c["scene"] == scene["name"]]
        sections.append({"id": f"scene-{i + 1}", "charts": drawn, **scene_section(scene, mine, record["provenance"])})
    template = environment().get_template("page.html.j2")
    return template.render(
        policy=content_policy(style, script),
        style=Markup(style),
        script=Markup(script),
        summary=[{"id": f"scene-{i + 1}", **summary_row(scene)} for i, scene in enumerate(scenes)],
        sections=sections,
        charts=[chart_context(c) for c in charts if c["scene"] not in named],
        provenance=provenance(record["provenance"]),
        config=json.dumps(record["provenance"].get("config", {}), indent=2, sort_keys=True, default=str),
        scale=error_scale(),
    )


def content_policy(style: str, script: str) -> str:
    """Nothing but this very script and style, and pictures within the page."""
    return (
        "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
        f"style-src '{_sha256(style)}'; script-src '{_sha256(script)}'"
    )


def _sha256(source: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()


def environment() -> Environment:
    """Templates of this folder, everything escaped."""
    return Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, finalize=_shown,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip


def _shown(value: object) -> object:
    """What a template prints: markup as it is, text with control signs made visible."""
    return value if isinstance(value, Markup) or not isinstance(value, str) else printable(value)


def chart_context(chart: Mapping[str, Any]) -> JsonObject:
    """A chart drawn, with its rows for the table below it."""
    on = fronts(chart["rows"])
    rows = [
        {
            **row,
            "words": METHODS[row["method"]][0] if row["method"] in METHODS else row["method"],
            "fronts": ", ".join(label for label, front in on.items() if front[i]),
            "sample": "" if row.get("sample_ns") is None else f"{row['sample_ns']:.3g}",
            "note": row.get("remark", ""),
            "leaked": percent(row["leak"]["value"]) if row.get("leak") else "",
            "lost": percent(row["overdark"]["value"]) if row.get("overdark") else "",
        }
        for i, row in enumerate(chart["rows"])
    ]
    leaks = any(row.get("leak") for row in chart["rows"])
    return {"scene": chart["scene"], "svg": Markup(draw_chart(chart)), "rows": rows, "leaks": leaks}


def provenance(given: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, text) lines: everything but the configuration and the command, which have their own places."""
    lines = []
    for key, value in given.items():
        if key in ("config", "command"):
            continue
        if isinstance(value, Mapping):
            words = ", ".join(f"{k} {v}" for k, v in value.items())
        else:
            words = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        lines.append((key, words))
    return lines


def error_scale() -> Markup:
    """The colour bar of the error pictures, -50 % to +50 %."""
    stops = [tag("stop", offset=place, stop_color="#{:02x}{:02x}{:02x}".format(*c)) for place, c in ERROR_STOPS]
    gradient = tag("linearGradient", *stops, id="error-scale")
    bar = tag("rect", width=200.0, height=12.0, rx=2.0, fill="url(#error-scale)")
    svg = tag("svg", gradient, bar, viewBox="0 0 200 12", width=200.0, height=12.0, class_="bar", role="img",
              preserveAspectRatio="none", aria_label="colour scale of the error, minus 50 to plus 50 percent")  # fmt: skip
    return Markup(svg)
