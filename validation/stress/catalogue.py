"""Every case of the failure catalogue by its id, gathered from the case modules beside this file.

The ids are those of the failure catalogue (F2 is not one of them), and R1 … R4 for rates of convergence. Importing the case modules
is cheap: what they measure with is imported by their functions.
"""

from __future__ import annotations

import difflib
import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from ...reference.errors import InputError
from .case import Case

GROUPS = {
    "A": "Form factors",
    "B": "Radiosity",
    "C": "Probes and spherical harmonics",
    "D": "Octree, virtual probes, validity",
    "E": "Virtual texture",
    "F": "Ground truth",
    "G": "The system",
    "R": "Rates of convergence",
}
_NUMBERS = {"A": range(1, 12), "B": range(1, 9), "C": range(1, 9), "D": range(1, 8), "E": range(1, 9), "F": (1, 3, 4, 5, 6),
            "G": range(1, 11), "R": range(1, 5)}  # fmt: skip
IDS = tuple(f"{letter}{number}" for letter, numbers in _NUMBERS.items() for number in numbers)
MODULES = {
    "A": "cases_form_factors",
    "B": "cases_radiosity",
    "C": "cases_probes",
    "D": "cases_octree",
    "E": "cases_texture",
    "F": "cases_truth",
    "G": "cases_system",
    "R": "cases_rates",
}
MOST_VALUES = 8


@dataclass(frozen=True)
class Entry:
    """A case and where the worker finds it: `module:ID`."""

    case: Case
    address: str


@cache
def group(letter: str) -> dict[str, Entry]:
    """The cases of one letter, in the order of IDS. ValueError where one is missing, unknown, twice there, or could not fail."""
    found: dict[str, Entry] = {}
    module = f"{__package__}.{MODULES[letter]}"
    for case in importlib.import_module(module).CASES:
        if case.id in found or case.id not in IDS or case.id[0] != letter:
            raise ValueError(f"{module}: stress case {case.id} is defined twice, or is none of group {letter}")
        check_case(case)
        found[case.id] = Entry(case, f"{module}:{case.id}")
    wanted = [name for name in IDS if name[0] == letter]
    missing = [name for name in wanted if name not in found]
    if missing:
        raise ValueError(f"{module}: no stress case {', '.join(missing)}")
    return {name: found[name] for name in wanted}


def catalogue() -> dict[str, Entry]:
    """All cases in the order of IDS."""
    return {name: entry for letter in MODULES for name, entry in group(letter).items()}


def check_case(case: Case) -> None:
    """ValueError unless the case can be run and can fail: rising values, curves of distinct names that mean
    something at one of them, at least one with a band."""
    where = f"stress case {case.id}"
    if case.out_of_scope:
        return
    if not 1 <= len(case.values) <= MOST_VALUES or any(not math.isfinite(v) for v in case.values):
        raise ValueError(f"{where}: expected 1 to {MOST_VALUES} finite values, got {case.values}")
    if any(b <= a for a, b in zip(case.values, case.values[1:], strict=False)):
        raise ValueError(f"{where}: expected rising values, got {case.values}")
    if case.log and case.values[0] <= 0.0:
        raise ValueError(f"{where}: a logarithmic axis wants values over 0, got {case.values[0]}")
    names = [curve.name for curve in case.curves]
    if len(set(names)) != len(names):
        raise ValueError(f"{where}: two curves have one name: {names}")
    if not any(curve.good or curve.stated for curve in case.curves):
        raise ValueError(f"{where}: no curve has a band, so the case cannot fail")
    for curve in case.curves:
        if not any(map(curve.where, case.values)):
            raise ValueError(f"{where}: {curve.name!r} means nothing at any of {case.values}")
    if case.breaks is not None and case.breaks not in names:
        raise ValueError(f"{where}: breaks on {case.breaks!r}, which is none of {names}")


def chosen(wanted: Sequence[str]) -> list[Entry]:
    """The named cases (in any letters; that of a group stands for all of it), or all. InputError names near ones."""
    if not wanted:
        return list(catalogue().values())
    picked: set[str] = set()
    for given in wanted:
        name = given.upper()
        those = [i for i in IDS if i == name or i[0] == name]
        if not those:
            near = difflib.get_close_matches(name, IDS, n=3, cutoff=0.5)
            hint = f"near: {', '.join(near)}" if near else f"known: {_ranges()}"
            raise InputError(f"stress: no case is called {given[:40]!r}; {hint}")
        picked |= set(those)
    return [group(i[0])[i] for i in IDS if i in picked]


def _ranges() -> str:
    return ", ".join(f"{k}{min(v)} to {k}{max(v)}" for k, v in _NUMBERS.items()) + " (without F2)"


def find_case(address: str) -> Case:
    """The case at `module:ID`. ValueError if that module has none of that id."""
    module, _, name = address.partition(":")
    for case in importlib.import_module(module).CASES:
        if case.id == name:
            found: Case = case
            return found
    raise ValueError(f"{module} has no stress case {name}")
