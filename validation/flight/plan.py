"""What `run --fly` asks for, checked before anything is computed; whether the budget suffices is known once probes stand."""

from __future__ import annotations

from dataclasses import dataclass

from ...reference.errors import InputError
from ...reference.texture_types import MAX_OFFSET
from .paths import PATHS

FRAMES, BUDGET = 120, 2000
MOST_TILES = MAX_OFFSET**3  # that an indirection texel addresses
LEAST_FRAMES, MOST_FRAMES = 3, 10_000
BLEND = 0.25  # share of each ring of distance over which the measurement "with blend" mixes two levels of detail


@dataclass(frozen=True)
class FlightPlan:
    """path: name of a path (see `paths`). frames: how many steps the viewer takes. budget: tiles that fit into the cache."""

    path: str
    frames: int = FRAMES
    budget: int = BUDGET


def flight_plan(path: str | None, budget: int | None, frames: int | None) -> FlightPlan | None:
    """The plan of the options --fly, --tile-budget and --frames, None where none was given.

    Raises InputError for a path that does not exist, numbers out of range, or options of a flight without a flight.
    """
    if path is None:
        for option, given in (("--tile-budget", budget), ("--frames", frames)):
            if given is not None:
                raise InputError(f"{option} {given}: that is a setting of a flight; add --fly with {_known()}")
        return None
    if path not in PATHS:
        raise InputError(f"--fly {path}: there is no such path; take {_known()}")
    if budget is not None and not 1 <= budget <= MOST_TILES:
        raise InputError(f"--tile-budget {budget}: expected 1 to {MOST_TILES:,} tiles, such as {BUDGET}")
    if frames is not None and not LEAST_FRAMES <= frames <= MOST_FRAMES:
        raise InputError(f"--frames {frames}: expected {LEAST_FRAMES} to {MOST_FRAMES:,}, such as {FRAMES}")
    return FlightPlan(path, FRAMES if frames is None else frames, BUDGET if budget is None else budget)


def _known() -> str:
    *first, last = PATHS
    return f"{', '.join(first)} or {last}"
