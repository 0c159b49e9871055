"""Seed a fault into this process, before the code it is in is imported.

A Python file is compiled from the changed text when it is imported, by a loader in front of the ordinary one; constants that other
files import are thereby faulty everywhere, as they would be on disk. A kernel file is changed where its text is read. What the result
cache takes for the code's hash (`cache.code_hash`) covers the fault, so nothing faulty is ever taken for sound, nor the other way
round.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from types import CodeType, ModuleType

from .fault import ROOT, Fault

PACKAGE = __package__.split(".")[0] if __package__ else "lightgauge"


def inject(fault: Fault, size: float | None = None) -> None:
    """The fault is in force from now on. Raises ValueError if its place is not there, or its module is imported already."""
    path = ROOT / fault.file
    text = fault.changed(path.read_text(encoding="utf-8"), size)
    if path.suffix == ".py":
        name = ".".join((PACKAGE, *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
        if name in sys.modules:
            raise ValueError(f"fault {fault.id}: {name} is imported already")
        sys.meta_path.insert(0, _Finder(name, path, text))
    else:
        _change_kernel(path.name, text)
    _change_hash(fault, size)


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles the changed text under the file's own name, and keeps no byte code of it."""

    def __init__(self, name: str, path: Path, text: str) -> None:
        super().__init__(name, str(path))
        self._text = text

    def get_code(self, fullname: str) -> CodeType:
        """Of the changed text."""
        return compile(self._text, self.path, "exec", dont_inherit=True)


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, name: str, path: Path, text: str) -> None:
        self._name, self._path, self._text = name, path, text

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Ours, for the one module."""
        if fullname != self._name:
            return None
        folder = [str(self._path.parent)] if self._path.name == "__init__.py" else None
        loader = _Loader(fullname, self._path, self._text)
        return importlib.util.spec_from_file_location(
            fullname, self._path, loader=loader, submodule_search_locations=folder
        )


def _change_kernel(file: str, text: str) -> None:
    from ...fastpath import programs

    whole = programs.text_of
    programs.text_of = lambda name: text if name == file else whole(name)


def _change_hash(fault: Fault, size: float | None) -> None:
    from .. import cache

    whole = cache.code_hash

    def code_hash(*folders: str) -> str:
        found = whole(*folders)
        return cache.key(found, fault.digest(size)) if any(_holds(f, fault.file) for f in folders) else found

    cache.code_hash = code_hash  # type: ignore[assignment]


def _holds(folder: str, file: str) -> bool:
    """Whether `cache.code_hash` of `folder` covers `file`: "a/*" are the files right in a, "a/b.py" is that file."""
    if folder.endswith("*"):
        return fnmatch(file, folder) and file.count("/") == folder.count("/")
    return file == folder or file.startswith(f"{folder}/")
