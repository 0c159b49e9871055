"""The page: complete, self-contained, and harmless whatever a scene is called (failure-catalogue G7, G9)."""

from __future__ import annotations

import base64
import copy
import hashlib
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import jsonschema
import pytest
from lightgauge.validation.record import load_results, metric
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.page import exr_names, write_report
from lightgauge.validation.report.pictures import SceneView
from lightgauge.validation.report.sections import shortened

HOSTILE = "<script>alert(1)</script></script><!-- =cmd|'/C calc'!A0 \x1b[31m \u202e & \" onload=x"
View, Results = Callable[..., SceneView], Callable[..., JsonObject]


class Elements(HTMLParser):
    """All start tags with their attributes, and the text of scripts and styles."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.blocks: list[tuple[str, dict[str, str | None], str]] = []
        self.words: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in ("script", "style"):
            self.blocks.append((tag, dict(attrs), ""))

    def handle_data(self, data: str) -> None:
        if self.cdata_elem and self.blocks:
            tag, attributes, text = self.blocks[-1]
            self.blocks[-1] = (tag, attributes, text + data)
        else:
            self.words.append(data)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, view: View, results: Results) -> tuple[Path, Elements]:
    out = tmp_path_factory.mktemp("page")
    views = [view("cornell", "front"), view("cornell", "side", 1), view("house", "outside", 2)]
    write_report(out, results("cornell", "house"), views)
    return out, Elements((out / "index.html").read_text(encoding="utf-8"))


def test_all_files_are_there_and_agree(page: tuple[Path, Elements]) -> None:
    out, _ = page
    files = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    exr = ["exr/cornell-front.exr", "exr/cornell-side.exr", "exr/house-outside.exr"]
    assert files == [*exr, "index.html", "results.json", "results.schema.json"]
    written = load_results(out)
    jsonschema.validate(written, json.loads((out / "results.schema.json").read_text(encoding="utf-8")))
    assert written["scenes"][0]["files"]["exr"] == {"front": exr[0], "side": exr[1]}


def test_the_record_given_is_left_alone(tmp_path: Path, view: View, results: Results) -> None:
    given = results("cornell")
    before = copy.deepcopy(given)
    write_report(tmp_path, given, [view("cornell", "front")])
    assert given == before


def test_the_page_is_one_file_and_its_policy_fits(page: tuple[Path, Elements]) -> None:
    _, elements = page
    policy = next(a["content"] for t, a in elements.tags if a.get("http-equiv") == "Content-Security-Policy") or ""
    assert policy.startswith("default-src 'none'") and "unsafe" not in policy
    for tag, attributes, text in elements.blocks:
        if attributes.get("type") != "application/json":
            digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
            assert f"{tag}-src 'sha256-{digest}'" in policy
    for tag, attributes in elements.tags:
        assert not [name for name in attributes if name == "style" or name.startswith("on")], tag
        assert (attributes.get("src") or "data:").startswith("data:")
        assert tag not in ("iframe", "object", "embed", "form", "base")


def test_the_page_shows_every_number_also_unknown_ones(page: tuple[Path, Elements]) -> None:
    text = " ".join(" ".join(page[1].words).split())
    for said in ("gradient_jump", "kernels_compiled", "48,211", "n = 2,099", "56ed67a", "PoCL 3.0", "lightgauge run cornell",
                 "not measured, the scene has no dark set", "Pareto front"):  # fmt: skip
        assert said in text, said


def test_a_failed_scene_shows_why(tmp_path: Path, results: Results) -> None:
    made = results("cornell", charts=False)
    made["scenes"].append({"name": "valley", "status": "failed", "error": "vertex 1204 is NaN"})
    write_report(tmp_path, made, [])
    assert "vertex 1204 is NaN" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_a_chart_alone_and_nothing_at_all_are_pages_too(tmp_path: Path, chart: Results, results: Results) -> None:
    for name, charts in (("chart", [chart("elsewhere")]), ("nothing", [])):
        write_report(tmp_path / name, {**results(), "charts": charts}, [])
        assert ("elsewhere" in (tmp_path / name / "index.html").read_text(encoding="utf-8")) == bool(charts)


def test_a_record_that_is_not_valid_writes_nothing(tmp_path: Path, results: Results) -> None:
    made = results("cornell")
    made["scenes"][0]["metrics"]["relrmse"]["value"] = float("nan")
    with pytest.raises(ValueError, match="relrmse"):
        write_report(tmp_path / "out", made, [])
    assert not (tmp_path / "out").exists()


def hostile(results: JsonObject, chart: JsonObject) -> JsonObject:
    """The record with every text it has room for replaced by a hostile one."""
    scene = results["scenes"][0]
    scene |= {"name": HOSTILE, "verdicts": [HOSTILE], "notes": [HOSTILE], "error": HOSTILE, "files": {HOSTILE: HOSTILE}}
    scene["metrics"][HOSTILE] = metric(1.0, 0.1, 3, unit=HOSTILE)
    scene["cost"][HOSTILE] = HOSTILE
    scene["worst"][0]["set"] = HOSTILE
    chart["rows"][0] |= {"method": HOSTILE, "setting": HOSTILE}
    provenance = {"versions": {HOSTILE: HOSTILE}, "command": HOSTILE, "config": {HOSTILE: HOSTILE}, HOSTILE: HOSTILE}
    return {**results, "provenance": provenance, "charts": [chart]}


@pytest.mark.parametrize("own", [True, False])
def test_hostile_names_are_harmless(tmp_path: Path, view: View, results: Results, chart: Results, own: bool) -> None:
    made = hostile(results("x"), chart(HOSTILE if own else HOSTILE + "2"))
    made["scenes"].append({"name": HOSTILE + "3", "status": "failed", "error": HOSTILE})
    write_report(tmp_path, made, [view(HOSTILE, HOSTILE)])
    html = (tmp_path / "index.html").read_text(encoding="utf-8")
    elements = Elements(html)
    assert [a.get("type") for t, a in elements.tags if t == "script"] == ["application/json", None]
    assert not any(name.startswith("on") for _, attributes in elements.tags for name in attributes)
    assert "alert(1)</script>" not in html and "<!--" not in html
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e\u2066-\u2069]", html)
    assert "\x1b" not in (tmp_path / "results.json").read_text(encoding="utf-8")
    assert all(re.fullmatch(r"exr/[a-z0-9.-]+", str(p.relative_to(tmp_path))) for p in tmp_path.glob("exr/*"))


def test_names_of_files_are_plain_and_distinct(view: View) -> None:
    named = exr_names([view(s, c) for s, c in (("a b", "c"), ("a", "b/c"), ("a.b", "../c"), ("//", "?"), ("é", "ü"))])
    assert named == ["exr/a-b-c.exr", "exr/a-b-c.2.exr", "exr/a-b-c.3.exr", "exr/view.exr", "exr/view.2.exr"]


def test_the_page_of_six_scenes_is_small_enough(page: tuple[Path, Elements]) -> None:
    assert (page[0] / "index.html").stat().st_size / 3 < 1_000_000


def test_long_lists_of_notes_fold_and_paths_are_short(tmp_path: Path, results: Results) -> None:
    made = results("cornell", charts=False)
    made["scenes"][0]["notes"] = [f"/home/me/many/folders/room/scene.xml: material m{i}" for i in range(7)]
    write_report(tmp_path, made, [])
    html = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "<summary>7 notes</summary>" in html
    assert "…/room/scene.xml: material m6" in html and "/home/me" not in html
    assert load_results(tmp_path)["scenes"][0]["notes"] == made["scenes"][0]["notes"]
    made["scenes"][0]["notes"] = made["scenes"][0]["notes"][:6]
    write_report(tmp_path, made, [])
    assert " notes</summary>" not in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("note", "shown"),
    [
        ("/a/b/c/d.ply: said", "…/c/d.ply: said"),
        ("in '/a/b/c/d.ply', and", "in '…/c/d.ply', and"),
        ("a/b/c/d.ply", "a/b/c/d.ply"),
        ("/a/d.ply", "/a/d.ply"),
        ("see https://example.org/a/b/c/d", "see https://example.org/a/b/c/d"),
        ("3 W/m²/sr", "3 W/m²/sr"),
    ],
)
def test_only_long_absolute_paths_are_cut(note: str, shown: str) -> None:
    assert shortened(note) == shown


@pytest.mark.parametrize(("noise", "chosen"), [(0.02, "each pixel"), (0.08, "mean of 5 × 5"), (0.4, "mean of 11 × 11")])
def test_a_noisy_truth_is_averaged_at_first(
    noise: float, chosen: str, tmp_path: Path, view: View, results: Results
) -> None:
    write_report(tmp_path, results("room", charts=False), [view("room", "main", noise=noise)])
    found = re.findall(r" selected>([^<]*)<", (tmp_path / "index.html").read_text(encoding="utf-8"))
    assert len(found) == 1 and found[0].startswith(chosen)


def test_every_control_has_a_name(page: tuple[Path, Elements]) -> None:
    """For readers of the screen: sliders and choices lie in labels, pictures have alternatives, the language is said."""
    out, elements = page
    html = (out / "index.html").read_text(encoding="utf-8")
    for control in ("input", "select"):
        assert all(re.search(rf"<label>[^<]*<{control}", part) for part in re.findall(rf"<label>.*?<{control}", html))
        assert len(re.findall(rf"<label>[^<]*<{control}", html)) == sum(t == control for t, _ in elements.tags)
    assert all(a.get("alt") for t, a in elements.tags if t == "img")
    assert ("html", {"lang": "en"}) in elements.tags
    assert all(a.get("aria-hidden") or a.get("role") == "img" for t, a in elements.tags if t == "svg")
