"""In a browser: the script runs under the page's own policy and draws what Python's tone mapping gives."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.page import write_report
from lightgauge.validation.report.pictures import SceneView, error_colours, exposure, relative_error, tonemap

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-logging=stderr", "--virtual-time-budget=10000", "--dump-dom",
)  # fmt: skip
READ = """<script>(async () => {
  for (let i = 0; i < 200 && !document.querySelector('[data-drawn]'); i++) await new Promise((r) => setTimeout(r, 20));
  const found = [...document.querySelectorAll('canvas')].map((c) =>
    PLACES.map(([x, y]) => [...c.getContext('2d').getImageData(x, y, 1, 1).data].slice(0, 3)));
  document.body.dataset.found = JSON.stringify(found);
})()</script></body>"""


def visit(address: str, folder: Path, limit_s: float = 60.0) -> tuple[str, str] | None:
    """(DOM after the script ran, what the browser said); None where the browser did not end in time.

    Written to files, not pipes: a browser's children keep a pipe open after it was killed, and reading it would never end.
    """
    folder.mkdir(parents=True)
    command = [str(CHROMIUM), *OPTIONS, f"--user-data-dir={folder / 'profile'}", address]
    with (folder / "dom").open("wb") as dom, (folder / "said").open("wb") as said:
        browser = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=dom, stderr=said, start_new_session=True)
        try:
            browser.wait(limit_s)
        except subprocess.TimeoutExpired:
            return None
        finally:
            if browser.poll() is None:
                os.killpg(browser.pid, signal.SIGKILL)
                browser.wait()
    return (folder / "dom").read_text(encoding="utf-8"), (folder / "said").read_text(encoding="utf-8", errors="replace")


@pytest.fixture(scope="module", autouse=True)
def working_browser(tmp_path_factory: pytest.TempPathFactory) -> None:
    """One that cannot even show an empty page says nothing about ours."""
    if visit("about:blank", tmp_path_factory.mktemp("blank") / "visit") is None:
        pytest.skip("the browser of this machine does not end on an empty page")


def load(page: Path, folder: Path) -> tuple[str, str]:
    """The page as the browser left it; started again up to twice, as a headless start sometimes hangs."""
    for attempt in range(3):
        if answer := visit(page.as_uri(), folder / str(attempt)):
            return answer
    pytest.fail(f"the browser did not end on {page.name} in three visits")


def test_the_script_runs_under_the_policy(
    tmp_path: Path, view: Callable[..., SceneView], results: Callable[..., JsonObject]
) -> None:
    name = "<img src=x onerror=alert(1)>"
    write_report(tmp_path / "out", results(name), [view(name, "main"), view(name, "side", 1)])
    dom, said = load(tmp_path / "out" / "index.html", tmp_path / "visits")
    assert dom.count('data-drawn="yes"') == 2
    assert "Content Security Policy" not in said and "CONSOLE" not in said


def test_the_canvases_hold_what_python_draws(
    tmp_path: Path, view: Callable[..., SceneView], results: Callable[..., JsonObject]
) -> None:
    made = view("room", "main", noise=0.0)
    write_report(tmp_path / "out", results("room"), [made])
    places = [(3, 3), (60, 40), (128, 96), (200, 150), (128, 180), (250, 20)]
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    html = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html)
    probing = html.replace("</body>", READ.replace("PLACES", json.dumps(places)))
    (tmp_path / "probing.html").write_text(probing, encoding="utf-8")
    dom, _ = load(tmp_path / "probing.html", tmp_path / "visits")
    match = re.search(r'data-found="([^"]*)"', dom)
    assert match is not None
    found = np.array(json.loads(match[1]))
    p = made.pictures
    factor = exposure(p.truth, p.ours, p.hit)
    expected = [tonemap(p.truth, p.hit, factor), tonemap(p.ours, p.hit, factor)]
    expected.append(error_colours(relative_error(p.truth, p.ours, p.hit), p.hit))
    for canvas, picture in zip(found, expected, strict=True):
        assert np.abs(canvas - np.array([picture[y, x] for x, y in places], int)).max() <= 2


CLICK = """<script>(async () => {
  for (let i = 0; i < 200 && !document.querySelector('[data-drawn]'); i++) await new Promise((r) => setTimeout(r, 20));
  const canvas = document.querySelector('[data-picture="ours"] canvas'), box = canvas.getBoundingClientRect();
  const x = Math.ceil(box.left + box.width * 60.1 / 256), y = Math.ceil(box.top + box.height * 40.1 / 192);  // whole in events
  canvas.dispatchEvent(new MouseEvent('click', {clientX: x, clientY: y}));
})()</script></body>"""


def test_a_click_says_how_to_explain_the_pixel(
    tmp_path: Path, view: Callable[..., SceneView], results: Callable[..., JsonObject]
) -> None:
    """The values of the pixel, and the command that made the page as one that explains it."""
    made = view("room", "main", noise=0.0)
    write_report(tmp_path / "out", results("room"), [made])
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    html = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html)
    (tmp_path / "clicking.html").write_text(html.replace("</body>", CLICK), encoding="utf-8")
    dom, _ = load(tmp_path / "clicking.html", tmp_path / "visits")
    match = re.search(r'data-role="clicked"[^>]*>([^<]*)<', dom)
    assert match is not None
    assert match[1].startswith("clicked: pixel 60, 40   truth ")
    assert "\nlightgauge run room --out reports/demo-pixel --explain main:60,40" in match[1]
