"""The gate: the rule, what is missing, bad files, the outputs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from lightgauge.reference.errors import InputError
from lightgauge.validation import cli, gate_output, gates

REPOSITORY = Path(__file__).resolve().parent.parent
Metrics = dict[str, dict[str, Any]]


def write_run(folder: Path, metrics: Metrics, **scene: Any) -> Path:
    record = {"name": "cornell", "status": "ok", "metrics": metrics, "cost": {}, **scene}
    (folder / "results.json").write_text(json.dumps({"schema": 1, "provenance": {}, "scenes": [record]}))
    return folder


def write_gates(folder: Path, text: str) -> Path:
    path = folder / "gates.toml"
    path.write_text(text)
    return path


def judged(folder: Path, metrics: Metrics, text: str, **scene: Any) -> gates.GateReport:
    limits = gates.load_gates(write_gates(folder, text))
    return gates.judge(gates.load_run(write_run(folder, metrics, **scene)), limits)


def metric(value: float, se: float | None = 0.0, **extra: Any) -> Metrics:
    spread = {} if se is None else {"se": se}
    return {"relrmse": {"value": value, "n": 100, **spread, **extra}}


MAX = "[cornell.relrmse]\nmax = 0.12\n"
HEAD = '{"schema": 1, "provenance": {}, "scenes": ['
MIN = "[cornell.relrmse]\nmin = -0.1\n"


@pytest.mark.parametrize(
    ("value", "se", "text", "reason"),
    [
        (0.10, 0.009, MAX, ""),
        (0.12, 0.0, MAX, ""),
        (0.12, None, MAX, ""),
        (0.13, 0.0, MAX, "over max 0.12"),
        (0.13, 0.1, MAX, "over max 0.12"),
        (0.11, 0.006, MAX, "not shown"),
        (-0.05, 0.02, MIN, ""),
        (-0.05, 0.03, MIN, "not shown"),
        (-0.2, 0.0, MIN, "under min -0.1"),
    ],
)
def test_rule(tmp_path: Path, value: float, se: float | None, text: str, reason: str) -> None:
    report = judged(tmp_path, metric(value, se), text)
    assert report.ok == (reason == "")
    assert reason in report.judgements[0].reason


def test_missing_and_failed(tmp_path: Path) -> None:
    text = MAX + "[cornell.leak]\nmax = 1\n[sphere.bias]\nmax = 1\n"
    reasons = [item.reason for item in judged(tmp_path, metric(0.0), text).failures]
    assert reasons == ["metric is missing", "scene is missing"]
    failed = judged(tmp_path, metric(0.0), MAX, status="failed", error="no light")
    assert failed.failures[0].reason == "scene failed: no light"


def test_below_noise_is_no_pass(tmp_path: Path) -> None:
    noisy = metric(0.001, below_noise=True)
    assert "noise floor" in judged(tmp_path, noisy, MAX).failures[0].reason
    assert judged(tmp_path, noisy, MAX + "allow_below_noise = true\n").ok


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("[cornell.relrmse]\nmaximum = 1\n", "cornell.relrmse.maximum"),
        ("[cornell.relrmse]\n", "cornell.relrmse"),
        ("[cornell.relrmse]\nmin = 2\nmax = 1\n", "min 2.0 exceeds max 1.0"),
        ("[cornell.relrmse]\nmax = nan\n", "cornell.relrmse.max"),
        ("[cornell]\nrelrmse = 1\n", "cornell.relrmse"),
        ("", "no limits"),
        ("[cornell", "not TOML"),
    ],
)
def test_bad_gates(tmp_path: Path, text: str, names: str) -> None:
    with pytest.raises(InputError, match=r"gates\.toml") as caught:
        gates.load_gates(write_gates(tmp_path, text))
    assert names in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"schema": 2, "provenance": {}, "scenes": []}',
        '{"schema": 1, "provenance": {}}',
        HEAD + '{"name": "a", "status": "ok", "metrics": {"m": {"value": NaN, "n": 1}}}]}',
        HEAD + '{"name": "a", "status": "ok", "metrics": {"m": {"value": 1}}}]}',
        HEAD + '{"name": "a", "status": "ok"}, {"name": "a", "status": "ok"}]}',
        "[" * 100_000,
    ],
)
def test_bad_results_exit_2_and_name_the_file(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.json").write_text(text)
    limits = write_gates(tmp_path, MAX)
    assert cli.main(["gate", str(tmp_path), "--gates", str(limits)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and str(tmp_path) in err and "Traceback" not in err and len(err) < 500


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, limits = write_run(tmp_path, metric(0.13, 0.001)), write_gates(tmp_path, MAX)
    xml, text = tmp_path / "gate.xml", tmp_path / "gate.md"
    command = ["gate", str(run), "--gates", str(limits)]
    assert cli.main([*command, "--junit", str(xml), "--markdown", str(text)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "FAIL cornell.relrmse: 0.13 ± 0.001 (n 100), limit ≤ 0.12: over max 0.12",
        "gate: 0 of 1 limits hold, 1 fail",
    ]
    root = ElementTree.parse(xml).getroot()
    assert root.get("failures") == "1" and root.find("testsuite/testcase/failure") is not None
    assert "| fail | cornell | relrmse |" in text.read_text()
    assert cli.main([*command, "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["ok"] is False and printed["judgements"][0]["value"] == 0.13


def test_only_named_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write_run(tmp_path, metric(0.1))
    command = ["gate", str(run), "--gates", str(write_gates(tmp_path, MAX + "[sphere.bias]\nmax = 1\n"))]
    assert cli.main([*command, "--every-scene"]) == 1
    assert cli.main([*command, "--scene", "cornell"]) == 0
    assert cli.main([*command, "--scene", "tower"]) == 2
    assert "no limits for scene 'tower'; the gates name cornell, sphere" in capsys.readouterr().err


def test_hostile_names_are_escaped(tmp_path: Path) -> None:
    name = "<script>|`\x1b[31m"
    report = judged(tmp_path, metric(1.0), f"[{json.dumps(name)}.relrmse]\nmax = 1\n", name=name)
    for rendered in (gate_output.markdown(report), gate_output.junit(report), "\n".join(gate_output.lines(report))):
        assert "\x1b" not in rendered
    assert "<script>" not in gate_output.markdown(report) + gate_output.junit(report)
    ElementTree.fromstring(gate_output.junit(report))


def test_our_own_gates_file_loads() -> None:
    assert gates.load_gates(REPOSITORY / "gates.toml").root["cornell"]


def test_a_partial_run_is_judged_by_its_own_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scenes that were not run are named, not judged, unless every scene is asked for; a run of none is bad input."""
    from lightgauge.validation import cli

    scene = {"name": "a", "status": "ok", "metrics": {"relrmse": {"value": 0.1, "se": 0.001, "n": 10}}}
    (tmp_path / "results.json").write_text(json.dumps({"schema": 1, "provenance": {}, "scenes": [scene]}))
    gates_file = tmp_path / "gates.toml"
    gates_file.write_text("[a.relrmse]\nmax = 0.2\n[b.relrmse]\nmax = 0.2\n")
    command = ["gate", str(tmp_path), "--gates", str(gates_file)]
    assert cli.main(command) == 0
    assert "not in the run: b" in capsys.readouterr().err
    assert cli.main([*command, "--every-scene"]) == 1
    gates_file.write_text("[b.relrmse]\nmax = 0.2\n")
    assert cli.main(command) == 2


def test_not_shown_says_how_many_samples_decide(tmp_path: Path) -> None:
    """0.11 ± 2 · 0.006 against 0.12: the room is 5/6 of the reach, so 1.44 times the samples, rounded up; an interval counts as
    it is."""
    assert "about 145 samples instead of 100" in judged(tmp_path, metric(0.11, 0.006), MAX).judgements[0].reason
    skewed = metric(0.11, 0.006, interval=[0.05, 0.115])
    assert judged(tmp_path, skewed, MAX).ok
    assert "95 % interval" in judged(tmp_path, metric(0.11, 0.001, interval=[0.1, 0.13]), MAX).judgements[0].reason
    assert "lies on the limit" in judged(tmp_path, metric(0.12, 0.01), MAX).judgements[0].reason
    noisy = metric(0.001, below_noise=True, noise=0.24)
    assert "about 1,600 samples instead of 100" in judged(tmp_path, noisy, MAX).judgements[0].reason
