"""Writes the bundled scenes: `python scenes/generate.py`; with `--check` only says whether the files are what it would write.

Each scene has a module `make_<name>.py` that holds its parameters, its scene.toml, its README and its geometry. The
bytes depend on nothing else: no time, no machine, no random state.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import make_cornell
import make_corridor
import make_house
import make_sphere
import make_two_rooms
import make_valley

SCENES: dict[str, Callable[[], dict[str, bytes]]] = {
    "cornell": make_cornell.build,
    "two-rooms": make_two_rooms.build,
    "sphere": make_sphere.build,
    "corridor": make_corridor.build,
    "house": make_house.build,
    "valley": make_valley.build,
}


def differences(root: Path, name: str, files: dict[str, bytes]) -> list[str]:
    """One sentence for each file of the scene that is missing, different or not of the scene."""
    folder = root / name
    there = {p.name for p in folder.iterdir()} if folder.is_dir() else set()
    found = [f"{name}/{f}: not something generate.py writes" for f in sorted(there - set(files))]
    for file, data in files.items():
        path = folder / file
        if not path.is_file():
            found.append(f"{name}/{file}: missing")
        elif path.read_bytes() != data:
            found.append(f"{name}/{file}: differs from what generate.py writes")
    return found


def write(root: Path, name: str, files: dict[str, bytes]) -> None:
    """Write a scene folder; files that already hold the right bytes are left alone, PLY files of old meshes go."""
    folder = root / name
    folder.mkdir(parents=True, exist_ok=True)
    for old in set(folder.glob("*.ply")) - {folder / f for f in files}:
        old.unlink()
    for file, data in files.items():
        path = folder / file
        if not path.is_file() or path.read_bytes() != data:
            path.write_bytes(data)


def main(arguments: list[str] | None = None) -> int:
    """Command line. Exit code 1 if `--check` found a difference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", nargs="*", help=f"only these ({', '.join(SCENES)})")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file differs")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent, help="folder of the scene folders")
    options = parser.parse_args(arguments)
    if unknown := sorted(set(options.scene) - set(SCENES)):
        parser.error(f"no scene {', '.join(unknown)}; there are {', '.join(SCENES)}")
    found: list[str] = []
    for name in options.scene or SCENES:
        files = SCENES[name]()
        if options.check:
            found += differences(options.out, name, files)
        else:
            write(options.out, name, files)
        print(f"{name}: {len(files)} files, {sum(map(len, files.values())):,} bytes")
    print(*found, sep="\n", end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
