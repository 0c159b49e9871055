"""What the README shows must exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_links_and_places_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (ROOT / target).exists(), target
    assert not re.search(r"@[A-Z]+@", text), "a placeholder was left"
    for scene in re.findall(r"^\| ([a-z-]+) \| \d", text, re.MULTILINE):
        assert (ROOT / "scenes" / scene / "scene.toml").exists(), scene


def test_the_map_names_every_room() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rooms = [p for p in ROOT.iterdir() if p.is_dir() and any(p.glob("*.py"))]
    for room in [*rooms, *(p.parent for p in (ROOT / "reference").glob("*/__init__.py"))]:
        assert f"{room.name}/" in text, room
