"""Seeded faults: each is where it says, reaches the code that runs, leaves the disk alone, and is counted rightly."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from lightgauge.reference.errors import InputError
from lightgauge.validation.faults.campaign import Campaign, Task, _row, _tasks
from lightgauge.validation.faults.catalogue import FAULTS, find_fault
from lightgauge.validation.faults.fault import ROOT, Fault
from lightgauge.validation.faults.power import (
    bounds,
    energy_power,
    false_alarms,
    margins,
    smallest_caught,
    with_error,
)
from lightgauge.validation.faults.text import faults_text
from lightgauge.validation.gates import Gates, Limit, load_gates
from lightgauge.validation.processes import Ended

GATES = Path(__file__).resolve().parents[2] / "gates.toml"


def test_there_are_enough_and_none_twice() -> None:
    assert len(FAULTS) >= 60
    assert max(Counter(f.id for f in FAULTS).values()) == 1
    assert max(Counter((f.file, f.old, f.new) for f in FAULTS).values()) == 1


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.id)
def test_each_is_where_it_says(fault: Fault) -> None:
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    changed = fault.changed(text, fault.sizes[0] if fault.sizes else None)
    assert changed != text and ("SIZE" in fault.new) == bool(fault.sizes)
    if fault.file.endswith(".py"):
        ast.parse(changed)
    assert set(fault.scenes) <= set(load_gates(GATES).root)
    assert list(fault.sizes) == sorted(fault.sizes, reverse=True)


def test_a_place_that_is_gone_is_refused() -> None:
    fault = Fault("x", "", "reference/sh.py", "no such text", "")
    with pytest.raises(ValueError, match="holds 0 times"):
        fault.changed("text", None)


def in_process(code: str) -> Any:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    return json.loads(done.stdout)


def test_a_fault_reaches_who_imports_a_constant_and_the_hash_of_the_cache() -> None:
    before = (ROOT / "reference/sh.py").read_bytes()
    found = in_process(
        "import json\n"
        "from lightgauge.validation import cache\n"
        "folders = ('reference', 'reference/*', 'fastpath', 'reference/truth')\n"
        "sound = [cache.code_hash(f) for f in folders]\n"
        "from lightgauge.validation.faults.catalogue import find_fault\n"
        "from lightgauge.validation.faults.inject import inject\n"
        "inject(find_fault('cosine-lobe-of-radiance'))\n"
        "from lightgauge.reference.reconstruction import linear_irradiance\n"
        "from lightgauge.reference.sh import COSINE_A1\n"
        "import lightgauge.validation.cache as c\n"
        "after = [c.code_hash(f) for f in folders]\n"
        "light = [[0, 0, 0], [0, 0, 0], [1, 1, 1], [0, 0, 0]]\n"
        "print(json.dumps([COSINE_A1, linear_irradiance(light, [0, 0, 1]).tolist(), [a == b for a, b in zip(sound, after)]]))"
    )
    assert found[0] == pytest.approx(3.14159265)
    assert found[1][0] == pytest.approx(3.14159265 * 0.4886025)
    assert found[2] == [False, False, True, True]
    assert (ROOT / "reference/sh.py").read_bytes() == before


def test_a_fault_in_a_kernel_reaches_what_includes_it() -> None:
    found = in_process(
        "import json\n"
        "from lightgauge.validation.faults.catalogue import find_fault\n"
        "from lightgauge.validation.faults.inject import inject\n"
        "inject(find_fault('kernel-constant'))\n"
        "from lightgauge.fastpath.programs import source\n"
        "print(json.dumps(['#define IRRADIANCE_1 1.5349900f' in source('sampler.cl'), 'IRRADIANCE_1 1.02' in source('sampler.cl')]))"
    )
    assert found == [True, False]


def test_a_fault_comes_before_the_import_of_its_module() -> None:
    from lightgauge.reference import sh  # noqa: F401
    from lightgauge.validation.faults.inject import inject

    with pytest.raises(ValueError, match="imported already"):
        inject(find_fault("cosine-lobe-of-radiance"))


def test_an_unknown_fault_names_those_near() -> None:
    with pytest.raises(InputError, match="axes-swapped"):
        find_fault("axes-swaped")


def test_a_process_that_dies_counts_as_noticed_one_without_the_fault_does_not() -> None:
    fault = find_fault("exitance-without-pi")
    begun: tuple[dict[str, Any], ...] = ({"injected": fault.id}, {"scene": fault.scenes[0], "flags": []})
    for code, words in ((None, "time limit"), (-11, "Segmentation")):
        row = _row(Task((fault.id,), fault), Ended(begun, code, "", 1.0))
        assert row["caught"] and not row["by_gate"] and row["valid"]
        assert words in row["flags"][0]["reason"] and row["flags"][0]["scene"] == fault.scenes[1]
    for told in ((), begun):  # it could not be applied, or what it says is no Python
        row = _row(Task((fault.id,), fault), Ended(told, 1, "NameError", 1.0))
        assert not row["caught"] and not row["valid"] and row["tail"] == "NameError"
    assert not _row(Task((fault.id,), fault), Ended((*begun, {"done": True}), 0, "", 1.0))["caught"]


def run(bias: float, se: float, flags: list[Any] | None = None) -> dict[str, Any]:
    entry = {"value": bias, "se": se, "n": 1000}
    names = ("patch_bias", "exact_bias", "bias", "truth_exact_bias")
    return {"seed": 0, "scene": "sphere", "flags": flags or [], "metrics": dict.fromkeys(names, entry)}


def limits(**most: float) -> dict[str, dict[str, Limit]]:
    return {"sphere": {name: Limit(min=-value, max=value) for name, value in most.items()}}


def test_energy_errors_scale_biases() -> None:
    entry = {"value": 0.002, "se": 0.001, "n": 10}
    assert with_error(entry, 0.01, False)["value"] == pytest.approx(1.002 * 1.01 - 1.0)
    assert with_error(entry, 0.01, True)["value"] == pytest.approx(1.002 / 1.01 - 1.0)
    sharp = limits(patch_bias=0.006, exact_bias=0.006, truth_exact_bias=0.005)
    assert all(row["noticed"] == 1 for row in energy_power([run(0.0, 0.001)], sharp))
    assert all(row["noticed"] == 0 for row in energy_power([run(0.0, 0.001)], limits(bias=0.03, exact_bias=0.03)))


def test_shares_have_exact_intervals() -> None:
    assert bounds(200, 200) == pytest.approx((0.98172, 1.0), abs=1e-5)  # 0.025^(1/200)
    assert bounds(0, 200) == pytest.approx((0.0, 0.01828), abs=1e-5)
    low, high = bounds(7, 20)
    assert (low, high) == pytest.approx((0.15391, 0.59219), abs=1e-4)  # tables of Clopper and Pearson


def test_alarms_and_margins() -> None:
    flag = {"scene": "sphere", "metric": "bias", "reason": "over", "limit": "≤ 0.01", "value": 0.02, "se": 0.001}
    found = false_alarms([run(0.0, 0.001), run(0.02, 0.001, [flag])])
    assert (found["runs"], found["flagged"]) == (2, 1)
    nearest = margins([run(0.001, 0.001)], limits(bias=0.006, exact_bias=0.02))[0]
    assert nearest["metric"] == "bias" and nearest["sigmas"] == pytest.approx(3.0)
    assert nearest["chance"] == pytest.approx(0.00135, rel=1e-2)


def test_sizes_count_from_above() -> None:
    rows = [
        {"id": "a", "title": "t", "size": s, "caught": c}
        for s, c in ((0.1, True), (0.03, True), (0.01, False), (0.003, True))
    ]
    assert smallest_caught(rows) == [{"id": "a", "title": "t", "caught": 0.03, "missed": 0.01}]


@pytest.mark.parametrize(
    ("noticed_from", "run_at"),
    [
        (0.0, [0.01, 0.003, 0.001]),  # all are noticed
        (0.003, [0.01, 0.003, 0.001]),
        (0.01, [0.01, 0.003]),  # what is smaller than one that was missed is not asked about
        (0.03, [0.03, 0.01]),
        (1.0, [0.03, 0.01]),
    ],
)
def test_sizes_are_tried_from_the_one_that_must_be_noticed(
    monkeypatch: pytest.MonkeyPatch, noticed_from: float, run_at: list[float]
) -> None:
    """The smallest size down to which all are noticed is the one that trying all would find."""
    fault = next(f for f in FAULTS if f.sizes == (0.03, 0.01, 0.003, 0.001))
    tasks = _tasks(fault)

    def answered(task: Task) -> dict[str, Any]:
        assert task.size is not None
        return {"id": fault.id, "title": fault.title, "size": task.size, "caught": task.size >= noticed_from}

    campaign = Campaign(GATES, 1)
    monkeypatch.setattr(campaign, "_recalled", answered)
    some = [row for _, row in campaign._chain(tasks)]
    assert [row["size"] for row in some] == run_at
    every = smallest_caught([answered(task) for task in tasks])[0]
    found = smallest_caught(some)[0]
    assert (found["caught"], found["missed"]) == (every["caught"], every["missed"]) or noticed_from == 1.0
    plain = _tasks(find_fault("transposed-rows"))
    monkeypatch.setattr(campaign, "_recalled", lambda task: {"id": task.arguments[0]})
    assert [row["id"] for _, row in campaign._chain(plain)] == ["transposed-rows"]


def test_the_report_tells_what_was_missed(tmp_path: Path) -> None:
    from lightgauge.validation.faults.campaign import Answers
    from lightgauge.validation.faults.page import write_page
    from lightgauge.validation.faults.story import fault_record

    gates: Gates = load_gates(GATES)
    rows = []
    for fault in FAULTS:
        told: tuple[dict[str, Any], ...] = ({"injected": 1}, {"scene": fault.scenes[0], "flags": []}, {"done": True})
        rows += [_row(Task((fault.id,), fault, size), Ended(told, 0, "", 1.0)) for size in fault.sizes or (None,)]
    about = {"versions": {}, "command": "lightgauge <stress>"}
    record = fault_record(about, Answers(rows, [run(0.0, 0.0005)]), {n: dict(v) for n, v in gates.root.items()})
    assert not record["good"] and record["summary"]["caught"] == 0 and not record["summary"]["broken"]
    assert len(record["summary"]["missed"]) == len(FAULTS)  # those of a size counted once, at 1 %
    assert all(0.01 in f.sizes for f in FAULTS if f.sizes)
    write_page(tmp_path, record)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "&lt;stress&gt;" in page and all(f.id in page for f in FAULTS)
    assert "MISSED" in faults_text(record, tmp_path)
