"""Every path a scene names must lie inside the scene's folder; every file has a size limit before it is read."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

from ..errors import InputError

MAX_FILE_BYTES = 512 << 20
# Text grows about tenfold while it is taken apart.
MAX_TEXT_BYTES = 256 << 20
MAX_DOCUMENT_BYTES = 64 << 20


def check_file(path: Path, where: str, limit: int = MAX_FILE_BYTES) -> Path:
    """The path itself if it is a regular file of bearable size. Raises InputError, naming `where`, otherwise."""
    if not path.exists():
        raise InputError(f"{where}: no such file: {path}; put it there or correct the name")
    if not path.is_file():
        raise InputError(f"{where}: not a regular file: {path}")
    size = path.stat().st_size
    if size > limit:
        raise InputError(f"{where}: {path} has {size} bytes, the limit is {limit}; split or simplify it")
    return path


def read_bytes(path: Path, where: str, limit: int = MAX_FILE_BYTES) -> bytes:
    """Content of a checked file. Raises InputError if it is missing, too large or unreadable."""
    check_file(path, where, limit)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: cannot read {path}: {error.strerror}") from error


def resolve_inside(folder: Path, name: str, where: str) -> Path:
    """The regular file `name` under `folder`.

    Raises InputError for absolute paths, `..`, links that lead outside, and files that are missing or too large.
    Back slashes separate folders too, since exporters on Windows write them.
    """
    if not name or any(ord(c) < 32 for c in name):
        raise InputError(f"{where}: expected a file name, got {name!r}")
    tidy = PurePosixPath(name.replace("\\", "/"))
    if tidy.is_absolute() or PureWindowsPath(name).drive or ".." in tidy.parts:
        raise InputError(f"{where}: path {name!r} leaves the scene's folder {folder}; copy the file into it")
    try:
        root, full = folder.resolve(), (folder / tidy).resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(f"{where}: cannot follow the path {name!r}: {error}") from error
    if not full.is_relative_to(root):
        raise InputError(f"{where}: path {name!r} leads outside the scene's folder {folder}; copy the file into it")
    return check_file(full, where)
