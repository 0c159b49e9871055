"""G1, G2, G3, G9: what comes in through files, and what goes out onto the page."""

from __future__ import annotations

import base64
import contextlib
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from .case import Reading
from .system_files import ply_text, png_bomb, sheet, telltale_library, write_toml, write_xml

UP = "../" * 24
LOADER = """
import json, resource, sys
from pathlib import Path
from lightgauge.reference.errors import InputError
from lightgauge.reference.scene import load_scene
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    load_scene(Path(sys.argv[1])); said = ""
except InputError as error:
    said = str(error)
print(json.dumps({"mib": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024, "said": said}))
"""


def code_in_scene(depth: float, seed: int) -> Mapping[str, Reading]:
    """G1: elements whose type is the path of a library, so many elements deep; paths that leave the folder."""
    from ...reference.errors import InputError
    from ...reference.scene import load_scene
    from ...reference.variant import ensure_variant

    ensure_variant()
    import mitsuba

    with tempfile.TemporaryDirectory(prefix="lightgauge-") as name:
        folder = Path(name)
        library, mark = telltale_library(folder)
        plain = str(library).removesuffix(".so")
        ran = taken = 0
        for kind in (plain, str(library), UP + plain.lstrip("/")):
            for body in (nested("bsdf", "twosided", kind, int(depth)), nested("shape", "instance", kind, int(depth))):
                try:
                    load_scene(write_xml(folder / "ours", body))
                    taken += 1
                except InputError:
                    pass
                ran += mark.exists()
                mark.unlink(missing_ok=True)
        body = nested("bsdf", "twosided", UP + plain.lstrip("/"), int(depth))
        with contextlib.suppress(RuntimeError):
            mitsuba.load_file(str(write_xml(folder / "bare", body)))
        bare = int(mark.exists())
        taken += sum(
            escapes(folder, file) for file in ("/etc/hostname", UP + "etc/hostname", "link.ply", "a/../../x.ply")
        )
    return {"libraries run": Reading(ran), "taken": Reading(taken), "run by a plain loader": Reading(bare)}


def nested(element: str, outer: str, inner: str, depth: int) -> str:
    """`depth` elements in one another, the innermost of type `inner`."""
    return f'<{element} type="{outer}">' * (depth - 1) + f'<{element} type="{inner}"/>' + f"</{element}>" * (depth - 1)


def escapes(folder: Path, file: str) -> bool:
    """Whether a scene may name a file outside its folder, which is there and would be read."""
    from ...reference.errors import InputError
    from ...reference.scene import load_scene

    path = write_toml(folder / "inside")
    outside = folder / "x.ply"
    outside.write_text(ply_text(*sheet(3)), encoding="ascii")
    link = path.parent / "link.ply"
    link.unlink(missing_ok=True)
    link.symlink_to(outside)
    (path.parent / "a").mkdir(exist_ok=True)
    path.write_text(path.read_text(encoding="utf-8").replace("wall.ply", file), encoding="utf-8")
    try:
        load_scene(path)
    except InputError:
        return False
    return True


def unpacking(megabytes: float, seed: int) -> Mapping[str, Reading]:
    """G2: a texture that unpacks to so many megabytes, read in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as name:
        folder = Path(name)
        png_bomb(folder / "bomb.png", int(megabytes * 1e6))
        packed = (folder / "bomb.png").stat().st_size / 1e6
        scene = write_toml(folder, picture="bomb.png")
        done = subprocess.run(
            [sys.executable, "-c", LOADER, str(scene)], capture_output=True, text=True, check=False, timeout=120
        )
    if done.returncode != 0:
        raise RuntimeError(f"the loader ended with {done.returncode}: {done.stderr[-300:]}")
    told = json.loads(done.stdout.splitlines()[-1])
    named = "bomb.png" in told["said"] and "pixels" in told["said"]
    return {
        "taken": Reading(float(not told["said"])),
        "memory": Reading(told["mib"]),
        "refused without a name": Reading(float(bool(told["said"]) and not named)),
        "unpacked over packed": Reading(megabytes / packed),
    }


def lies(count: float, seed: int) -> Mapping[str, Reading]:
    """G3: meshes whose header or indices lie by so many, or that have so many corners that are no numbers."""
    from ...reference.errors import InputError
    from ...reference.scene import load_scene
    from ...reference.variant import ensure_variant

    ensure_variant()
    import mitsuba

    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    taken = unnamed = bare = 0
    files = lying(int(count))
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as name:
        for what, text in files.items():
            scene = write_toml(Path(name), text)
            try:
                load_scene(scene)
                taken += 1
            except InputError as error:
                unnamed += not all(word in str(error) for word in ("meshes.wall", what))
            try:
                mitsuba.load_dict({"type": "ply", "filename": str(scene.parent / "wall.ply")})
                bare += 1
            except RuntimeError:
                pass
    n = len(files)
    return {
        "taken": Reading(taken, n=n),
        "refused without a name": Reading(unnamed, n=n),
        "taken by a plain loader": Reading(bare, n=n),
    }


def lying(n: int) -> dict[str, str]:
    """PLY files, by the word that the refusal must hold."""
    corners, faces = sheet()
    v, f = len(corners), len(faces)
    late = [*faces[:-1], (0, 1, v - 1 + n)]
    spread = {round(i * (v - 1) / max(n - 1, 1)) for i in range(min(n, v))}
    dead = [("nan", *c[1:]) if i in spread else c for i, c in enumerate(corners)]
    far = [("inf", *c[1:]) if i in spread else c for i, c in enumerate(corners)]
    return {
        "'face'": ply_text(corners, faces, (v, f + n)),
        "left": ply_text(corners, faces, (v, f - n)),
        "face 0: cannot read": ply_text(corners, faces, (v - n, f)),
        "face 0": ply_text(corners, [(0, 1, -n), *faces[1:]]),
        f"face {f - 1}": ply_text(corners, late),
        "not finite": ply_text(dead, faces),
        "vertex 0": ply_text(far, faces),
    }


class Elements(HTMLParser):
    """Counts what a page could do: its scripts, handlers, links that run, and signs that steer a terminal."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.scripts = self.active = 0
        self.policy = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """One start tag."""
        given = dict(attrs)
        self.scripts += tag == "script" and given.get("type") != "application/json"
        self.active += tag in ("iframe", "object", "embed", "form", "base")
        self.active += sum(key.startswith("on") or "javascript:" in (value or "") for key, value in attrs)
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given.get("content") or ""


HOSTILE = (
    "</script><script>alert(1)</script>", "=cmd|'/C calc'!A0", "\x1b[31m\x1b]0;x\x07", "\u202e", '" onload="x',
    "<img src=x onerror=x>", "javascript:x", "]]>", "{{7*7}}",
)  # fmt: skip


def hostile_names(length: float, seed: int) -> Mapping[str, Reading]:
    """G9: a record whose scene, notes and errors hold markup, formulas and terminal escapes, as a page, as JSON and as a table."""
    from ..report.page import write_report
    from ..summary import results_table

    name = ("".join(HOSTILE) * (1 + int(length) // 80))[: int(length)]
    results: dict[str, Any] = {"schema": 1, "provenance": {"command": name, "config": {}, "seed": seed},
               "scenes": [{"name": name, "status": "failed", "error": name, "notes": [name]}], "charts": []}  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="lightgauge-") as folder:
        write_report(Path(folder), results, [])
        html = (Path(folder) / "index.html").read_text(encoding="utf-8")
        text = (Path(folder) / "results.json").read_text(encoding="utf-8")
    page = Elements(html)
    steering = [
        c for c in html + results_table(results) if (ord(c) < 32 and c not in "\n\t\r") or c in "\u202e\x9b\x7f"
    ]
    lax = page.policy.count("unsafe") + (not page.policy.startswith("default-src 'none'"))
    unlike = json.loads(text)["scenes"][0]["name"] != name
    return {
        "scripts beyond its own": Reading(page.scripts - 1 + page.active + lax + script_unlike(html, page.policy)),
        "steering signs": Reading(len(steering) + sum(ord(c) > 126 for c in text)),
        "names that JSON changed": Reading(float(unlike)),
        "NaN written": Reading(float(nan_written(results))),
    }


def script_unlike(html: str, policy: str) -> int:
    """Scripts and styles whose hash the policy does not hold."""
    import hashlib

    found = re.findall(r"<(script|style)>(.*?)</\1>", html, re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() for _, body in found]
    return sum(digest not in policy for digest in digests)


def nan_written(results: Mapping[str, Any]) -> bool:
    """Whether a record with NaN in it can be written."""
    from ..record import dumps

    try:
        dumps({**results, "x": [{"y": float("nan")}]})
    except ValueError:
        return False
    return True
