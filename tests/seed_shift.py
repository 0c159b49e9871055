"""`--seed-shift K`: every seed that a test, or the code it tests, takes is moved by K. What `.ci/flakes` is made of.

A test of a random quantity must pass with almost any seed; one that was tried with its own seed only may rest on luck. The shift moves

- numpy.random.default_rng with a number or a list of numbers (SciPy's qmc engines and Mitsuba's samplers are seeded through it),
- random.Random with a number,
- the Owen scrambles of reference/low_discrepancy (`receiver_seeds`),

in the test, in fixtures, and in files while they are collected. It does not move: generators without a seed, child processes (the
command line started as a process, mesh repair, workers), scrambles made inside kernels that other processes cached, and what a
test wrote down as an array of numbers. Tests whose run, fixtures or file called one of these are the stochastic ones; with
`--seed-report FILE` every test is written there after the run, one `nodeid<TAB>outcome<TAB>1 or 0 (stochastic)` a line.
"""

from __future__ import annotations

import importlib
import random
import sys
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

STRIDE = 1_000_003  # far from the small numbers that tests add to their seeds


class Shift:
    """What is moved, by how much, and who drew."""

    def __init__(self, by: int) -> None:
        self.by = by * STRIDE
        self.drawn = False
        self.outcomes: dict[str, str] = {}
        self.fixtures: set[str] = set()
        self.files: set[str] = set()
        self.stochastic: set[str] = set()

    def moved(self, seed: Any) -> Any:
        """The seed, moved, if it is one; the draw is noted."""
        if isinstance(seed, int | np.integer):
            self.drawn = True
            return int(seed) + self.by
        if isinstance(seed, Sequence | np.ndarray) and len(seed) and not isinstance(seed, str | bytes):
            self.drawn = True
            return [int(seed[0]) + self.by, *(int(s) for s in seed[1:])]
        return seed

    def take(self) -> bool:
        """Whether anything was drawn since the last call."""
        drawn, self.drawn = self.drawn, False
        return drawn


def install(shift: Shift) -> None:
    """Put the wrappers in place for the rest of the process."""
    importlib.import_module(
        "scipy.stats"
    )  # draws while it is imported: no file that happens to be the first must get that blame
    plain_rng, plain_random = np.random.default_rng, random.Random

    def default_rng(seed: Any = None) -> np.random.Generator:
        return plain_rng(shift.moved(seed))

    class Random(plain_random):
        def __init__(self, x: Any = None) -> None:
            super().__init__(shift.moved(x) if isinstance(x, int) else x)

    np.random.default_rng = default_rng
    random.Random = Random  # type: ignore[misc]

    import lightgauge.reference.low_discrepancy as low_discrepancy

    plain_seeds: Callable[..., Any] = low_discrepancy.receiver_seeds

    def receiver_seeds(receivers: Any, replicate: Any, seed: Any) -> Any:
        shift.drawn = True
        by = shift.by & 0xFFFFFFFF
        return plain_seeds(
            receivers, replicate, (seed + by) & 0xFFFFFFFF if isinstance(seed, int) else seed + type(seed)(by)
        )

    for module in [m for name, m in sys.modules.items() if name.startswith("lightgauge")]:
        if getattr(module, "receiver_seeds", None) is plain_seeds:
            module.receiver_seeds = receiver_seeds  # type: ignore[attr-defined]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--seed-shift", type=int, default=None, metavar="K", help="move every seed by K; see tests/seed_shift.py"
    )
    parser.addoption(
        "--seed-report", type=Path, default=None, metavar="FILE", help="where stochastic tests and outcomes go"
    )


def pytest_configure(config: pytest.Config) -> None:
    by = config.getoption("--seed-shift")
    if by is not None:
        shift = Shift(by)
        install(shift)
        config.pluginmanager.register(Watch(shift, config.getoption("--seed-report")), "seed-shift")


class Watch:
    """Finds out which tests drew: in their own run, in a fixture they use, or while their file was collected."""

    def __init__(self, shift: Shift, report: Path | None) -> None:
        self.shift, self.report = shift, report

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: pytest.Collector) -> Generator[None, Any, Any]:
        self.shift.take()
        made = yield
        if self.shift.take():
            self.shift.files.add(collector.nodeid)
        return made

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Generator[None, Any, Any]:
        before = self.shift.take()
        made = yield
        inside = self.shift.take()
        if inside:
            self.shift.fixtures.add(f"{fixturedef.baseid}::{fixturedef.argname}")
        self.shift.drawn = before or inside
        return made

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        self.shift.take()
        made = yield
        drew = self.shift.take() or any(item.nodeid.startswith(f"{file}::") for file in self.shift.files)
        definitions = getattr(getattr(item, "_fixtureinfo", None), "name2fixturedefs", {})
        names = {f"{d.baseid}::{d.argname}" for found in definitions.values() for d in found}
        if drew or names & self.shift.fixtures:
            self.shift.stochastic.add(item.nodeid)
        return made

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        before = self.shift.outcomes.get(report.nodeid)
        if before is None or (before != "failed" and report.outcome != "passed"):
            self.shift.outcomes[report.nodeid] = report.outcome

    def pytest_sessionfinish(self) -> None:
        if self.report is not None:
            drew = self.shift.stochastic
            lines = [f"{name}\t{what}\t{int(name in drew)}\n" for name, what in sorted(self.shift.outcomes.items())]
            self.report.write_text("".join(lines), encoding="utf-8")
