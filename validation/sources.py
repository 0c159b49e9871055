"""From what a user types for a scene to its file."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator
from pathlib import Path

from ..reference.errors import InputError

VARIABLE = "LIGHTGAUGE_SCENES"
SCENE_FILE = "scene.toml"
SUFFIXES = (".toml", ".xml", ".glb", ".gltf", ".obj", ".ply")
REPOSITORY = Path(__file__).resolve().parent.parent


def scene_folders() -> list[Path]:
    """Folders that hold named scenes, first wins: ./scenes, those in $LIGHTGAUGE_SCENES, the repository's own."""
    listed = [Path(part) for part in os.environ.get(VARIABLE, "").split(os.pathsep) if part]
    wanted = [Path("scenes"), *listed, REPOSITORY / "scenes"]
    return [folder for folder in dict.fromkeys(path.absolute() for path in wanted) if folder.is_dir()]


def _named(folder: Path) -> Iterator[tuple[str, Path]]:
    for path in sorted(folder.iterdir()):
        if (path / SCENE_FILE).is_file():
            yield path.name, path / SCENE_FILE


def known_scenes() -> dict[str, Path]:
    """Name -> scene.toml, over all `scene_folders`, by name."""
    known: dict[str, Path] = {}
    for folder in scene_folders():
        for name, path in _named(folder):
            known.setdefault(name, path)
    return dict(sorted(known.items()))


def bundled_scenes() -> list[Path]:
    """The scenes `report` runs: all of ./scenes, else all of the repository's. Raises InputError if there are none."""
    for folder in (Path("scenes").absolute(), REPOSITORY / "scenes"):
        found = [path for _, path in _named(folder)] if folder.is_dir() else []
        if found:
            return found
    raise InputError("no bundled scenes: run this in the repository, or where a folder scenes/<name>/scene.toml is")


def resolve_scene(name: str) -> Path:
    """The file of a scene given by name or path. A folder stands for its scene.toml. Raises InputError."""
    if "\0" in name or not name:
        raise InputError(f"not a scene name or path: {name!r}")
    known = known_scenes()
    if name in known:
        return known[name]
    path = Path(name).expanduser()
    try:
        return _resolve_path(path)
    except FileNotFoundError:
        raise InputError(f"no scene {name!r}: {_suggestion(name, known)}") from None
    except OSError as error:
        raise InputError(f"no scene {name!r}: {error.strerror}") from error


def _resolve_path(path: Path) -> Path:
    path.stat()
    if path.is_dir():
        if (path / SCENE_FILE).is_file():
            return path / SCENE_FILE
        raise InputError(f"{path} is a folder without {SCENE_FILE}")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of scene file; known: {', '.join(SUFFIXES)}")
    return path


def _suggestion(name: str, known: dict[str, Path]) -> str:
    if not known:
        return f"no such file, and no named scenes found (./scenes, ${VARIABLE}, {REPOSITORY / 'scenes'})"
    close = difflib.get_close_matches(name.lower(), known, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"no such file, and no scene of that name; known: {', '.join(known)}{hint}"
