"""The rules of design.md, section 2, read off the source with `ast`."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
ROOMS = ("reference", "fastpath", "validation")
FILES = sorted(path for room in ROOMS for path in (REPOSITORY / room).rglob("*.py"))
ALL_FILES = FILES + sorted(path for folder in ("tests", "scenes") for path in (REPOSITORY / folder).rglob("*.py"))


def parts(path: Path) -> tuple[str, ...]:
    """('reference', 'truth', 'path_traced') for reference/truth/path_traced.py; a package stands for its __init__."""
    named = path.relative_to(REPOSITORY).with_suffix("").parts
    return named[:-1] if named[-1] == "__init__" else named


def imports(path: Path) -> Iterator[tuple[str, ...]]:
    """What a file imports of ours, with the names after `from x import`, as parts without `lightgauge`."""
    folder = path.parent.relative_to(REPOSITORY).parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [(*alias.name.split("."),) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = folder[: len(folder) - node.level + 1] if node.level else ()
            base += tuple(node.module.split(".")) if node.module else ()
            modules = [(*base, alias.name) for alias in node.names]
        else:
            continue
        for module in modules:
            ours = module[1:] if module[0] == "lightgauge" else module
            if ours and ours[0] in ROOMS:
                yield ours


def name(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def is_folder(room: str) -> bool:
    return (REPOSITORY / "reference" / room).is_dir()


@pytest.mark.parametrize("path", [p for p in FILES if parts(p)[0] == "reference"], ids=name)
def test_reference(path: Path) -> None:
    own = parts(path)[1] if len(path.relative_to(REPOSITORY).parts) > 2 else ""
    top = own == "pipeline"
    for module in imports(path):
        assert module[0] == "reference", f"reference imports {'.'.join(module)}"
        target = module[1] if len(module) > 1 else ""
        assert top or not is_folder(target) or target == own, f"imports the folder {target}"
        assert top or target != "pipeline", "only validation may import pipeline"


@pytest.mark.parametrize("path", [p for p in FILES if parts(p)[0] == "fastpath"], ids=name)
def test_fastpath(path: Path) -> None:
    for module in imports(path):
        assert module[0] == "fastpath" or module[:2] in (
            ("reference", "datatypes"),
            ("reference", "texture_types"),
            ("reference", "errors"),
        ), module


@pytest.mark.parametrize("path", [p for p in FILES if parts(p)[0] != "validation"], ids=name)
def test_nothing_imports_validation(path: Path) -> None:
    assert all(module[0] != "validation" for module in imports(path))


@pytest.mark.parametrize("path", FILES, ids=name)
def test_imports_across_rooms_are_relative(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not any(alias.name.split(".")[0] in (*ROOMS, "lightgauge") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            assert (node.module or "").split(".")[0] not in (*ROOMS, "lightgauge")


@pytest.mark.parametrize("path", ALL_FILES, ids=name)
def test_habits(path: Path) -> None:
    assert path.name not in ("utils.py", "util.py", "helpers.py")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        assert not (isinstance(node, ast.ExceptHandler) and node.type is None), f"bare except, line {node.lineno}"
        if isinstance(node, ast.Attribute):
            on = node.value.id if isinstance(node.value, ast.Name) else ""
            assert not (on == "sys" and node.attr == "path"), f"sys.path, line {node.lineno}"
            allowed = node.attr != "set_variant" or name(path) == "reference/variant.py"
            assert allowed, f"set_variant outside variant.py, line {node.lineno}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            first = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
            assert not {"pickle", "cPickle", "dill", "shelve"} & set(first), f"pickle, line {node.lineno}"


def test_every_package_is_listed_for_the_install() -> None:
    import tomllib

    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    listed = set(settings["tool"]["setuptools"]["packages"])
    there = {".".join(("lightgauge", *parts(path))) for path in FILES if path.name == "__init__.py"}
    assert there == listed


def test_plain_names_are_not_imported() -> None:
    code = (
        "import sys, lightgauge.reference.errors, lightgauge.validation.cli\n"
        "sys.exit(bool({'reference', 'fastpath', 'validation'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert not set(ROOMS) & set(sys.modules)
