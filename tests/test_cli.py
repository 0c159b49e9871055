"""The command line: exit codes, what goes to which stream, scenes by name."""

from __future__ import annotations

import json
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lightgauge.reference.errors import EnvironmentLacks, InputError
from lightgauge.validation import cli, sources
from lightgauge.validation.cli_parser import EXAMPLES, build_parser

Capture = pytest.CaptureFixture[str]
RESULTS: dict[str, Any] = {
    "schema": 1,
    "provenance": {},
    "scenes": [
        {
            "name": "cor\x1bnell",
            "status": "ok",
            "metrics": {"relrmse": {"value": 0.12, "se": 0.003, "n": 9}, "seam_sup": {"value": 1e-6, "n": 9}},
            "cost": {"real_probes": 300, "bake_s": 1.5},
        }
    ],
}


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "scenes" / "cornell" / "scene.toml"
    file.parent.mkdir(parents=True)
    file.write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(sources.VARIABLE, raising=False)
    return file


def install(monkeypatch: pytest.MonkeyPatch, work: Callable[..., dict[str, Any]]) -> None:
    """Put `work` in place of the real jobs."""
    jobs = (("run", "run_scenes"), ("chart", "chart_scenes"), ("report_all", "report_scenes"))
    for name, function in jobs:
        module = types.ModuleType(name)
        setattr(module, function, work)
        monkeypatch.setitem(sys.modules, f"lightgauge.validation.{name}", module)


@pytest.mark.parametrize("verb", ["run", "chart", "report"])
def test_measuring_verbs(verb: str, scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    calls: list[tuple[Any, ...]] = []

    def work(*values: Any) -> dict[str, Any]:
        print("chatter of a library")
        calls.append(values)
        return RESULTS

    install(monkeypatch, work)
    names = [] if verb == "report" else ["cornell"]
    options = ["--set", "placement.rays=32", "--seed", "7", "--quiet", "--json"]
    assert cli.main([verb, *names, *options]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == RESULTS
    assert "chatter" in err
    out_folder = {"run": "reports/run", "chart": "reports/chart", "report": "reports/latest"}[verb]
    command = " ".join(["lightgauge", verb, *names, *options])
    assert calls == [([scene], {"placement": {"rays": 32}}, 7, Path(out_folder), True, command)]


def test_table(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    install(monkeypatch, lambda *_: RESULTS)
    assert cli.main(["run", "cornell"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["scene", "status", "relrmse", "probes", "bake_s"]
    assert lines[1].split() == ["cor?nell", "ok", "0.12", "±", "0.003", "300", "1.5"]


def test_failed_scene_is_1(scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    failed = {"name": "cornell", "status": "failed", "error": "no probe placed", "metrics": {}}
    install(monkeypatch, lambda *_: {**RESULTS, "scenes": [failed]})
    assert cli.main(["run", "cornell"]) == 1
    assert "cornell: no probe placed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (InputError("a.toml: bad"), 2, "lightgauge: error: a.toml: bad\n"),
        (EnvironmentLacks("no LLVM"), 3, "lightgauge: error: no LLVM\n"),
        (MemoryError(), 3, "out of memory"),
        (OSError(28, "No space left on device", "x"), 3, "no space left: x"),
        (ModuleNotFoundError("no", name="scipy"), 3, "scipy is missing. To mend it: make setup"),
        (RuntimeError("oops"), 4, "our own fault: RuntimeError: oops"),
        (KeyboardInterrupt(), 130, "finished work is kept. To resume: lightgauge run cornell --json"),
    ],
)
def test_exit_codes(
    error: BaseException, code: int, says: str, scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def work(*_: Any) -> dict[str, Any]:
        raise error

    install(monkeypatch, work)
    assert cli.main(["run", "cornell", "--json"]) == code
    out, err = capsys.readouterr()
    assert out == "" and says in err
    assert ("Traceback" in err) == (code == 4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run", "cornel"], "did you mean 'cornell'?"),
        (["run", "gone.toml"], "known: cornell"),
        (["run", "."], "folder without scene.toml"),
        (["run", "notes.txt"], "unknown kind of scene file"),
        (["run", "a\0b"], "not a scene name"),
        (["run", "x" * 5000], "no scene"),
        (["run", "cornell", "--set", "a"], "--set wants KEY=VALUE"),
        (["run", "cornell", "--config", "gone.toml"], "cannot read gone.toml"),
        (["run", "cornell", "--out", "notes.txt/deep"], "notes.txt is not a folder"),
        (["gate", "gone", "--gates", "gone.toml"], "cannot read gone.toml"),
    ],
)
def test_bad_input_is_2(arguments: list[str], says: str, scene: Path, capsys: Capture) -> None:
    Path("notes.txt").write_text("")
    assert cli.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err and err.startswith("lightgauge: error: ") and "Traceback" not in err
    assert sorted(path.name for path in Path().iterdir()) == ["notes.txt", "scenes"]


@pytest.mark.parametrize("arguments", [[], ["fly"], ["run"], ["run", "a", "--seed", "-1"], ["run", "a", "--see", "1"]])
def test_bad_use_is_2(arguments: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == "" and "lightgauge: error: " in err


@pytest.mark.parametrize("verb", EXAMPLES)
def test_help_has_examples_that_parse(verb: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main([verb, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for line in EXAMPLES[verb].splitlines():
        assert line in text
        build_parser("0").parse_args(line.split()[1:])


def test_scene_by_path_and_folder(scene: Path) -> None:
    assert sources.resolve_scene("cornell") == scene
    assert sources.resolve_scene(str(scene)) == scene
    assert sources.resolve_scene("scenes/cornell").resolve() == scene


def test_listed_folders(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "more" / "attic" / "scene.toml"
    other.parent.mkdir(parents=True)
    other.write_text("")
    monkeypatch.setenv(sources.VARIABLE, str(tmp_path / "more"))
    assert sources.resolve_scene("attic") == other
    assert sources.bundled_scenes() == [scene]


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from lightgauge.validation import cli\n"
        "try: cli.main(['run', '--help'])\n"
        "except SystemExit: pass\n"
        "sys.exit(bool({'mitsuba', 'drjit', 'numpy', 'pyopencl', 'pydantic'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_a_folder_that_takes_no_files_is_bad_input(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Found out only when something is written; what the system refuses elsewhere stays our own fault."""
    for refused, code in ((tmp_path / "out" / "index.html", 2), (tmp_path / "elsewhere", 4)):

        def work(*_: object, name: str = str(refused)) -> dict[str, Any]:
            raise PermissionError(13, "Permission denied", name)

        install(monkeypatch, work)
        assert cli.main(["run", "cornell", "--out", str(tmp_path / "out")]) == code
        said = capsys.readouterr().err
        assert ("--out" in said and "Permission denied" in said) == (code == 2)
