"""A flight as results.json holds it: summary figures with the samples behind them, a row of numbers per frame, errors by level."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..metrics.error import Measured, measure_rel_rmse
from ..record import metric
from .change import Still
from .driver import Flight
from .paths import Path
from .plan import BLEND, FlightPlan
from .world import World

LEAST_POINTS = 20  # for an error by level
DIGITS = 5
# What `lightgauge gate` can judge: names in the scene's metrics, and in the summary.
GATED = (
    "wrong_reads",
    "unexplained",
    "twin_deviation",
    "texel_deviation",
    "pop",
    "pop_blend",
    "flicker",
    "relrmse_streaming",
    "relrmse_lod",
)


def flight_table(world: World, plan: FlightPlan, path: Path, flight: Flight, cache_bytes: int) -> dict[str, Any]:
    """The record's `fly` table. cache_bytes: size of the streamed texture."""
    stills = flight.stills
    pops = {
        f"pop{suffix}": [0.0, *stills[name].pops]
        for name, suffix in (("streamed", ""), ("streamed_blend", "_blend"), ("whole", "_whole"), ("whole_blend", "_whole_blend"))
    }  # fmt: skip
    frames = {name: [_brief(v) for v in values] for name, values in (flight.frames | pops).items()}
    order = np.argsort(stills["streamed"].worst, kind="stable")
    return {
        "path": plan.path,
        "frames": plan.frames,
        "budget": plan.budget,
        "tiles": world.table.tiles,
        "levels": world.table.level,
        "lod_distance_m": world.lod_distance,
        "blend": BLEND,
        "storage": world.storage,
        "points": flight.points,
        "cache_bytes": cache_bytes,
        "summary": {name: m for name, m in _summary(flight) if m is not None},
        "per_frame": frames,
        "viewer": [[round(x, 3) for x in row] for row in path.positions.tolist()],
        "places": [
            [*(round(float(x), 2) for x in world.watched.positions[i]), _brief(float(stills["streamed"].worst[i]))]
            for i in order
        ],
        "levels_used": list(_by_level(world, flight)),
        "notes": _notes(world, flight),
    }


def flight_metrics(table: Mapping[str, Any]) -> dict[str, Any]:
    """The part of the summary that gates can judge, by its name in the scene's metrics."""
    return {f"fly_{name}": table["summary"][name] for name in GATED if name in table["summary"]}


def _brief(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.{DIGITS}g}")


def _summary(flight: Flight) -> Iterator[tuple[str, dict[str, Any] | None]]:
    """Each figure with its samples: frames, points × frames, or reads."""
    f = flight.frames
    frames = len(f["wanted"])
    yield "wrong_reads", metric(sum(f["wrong_reads"]), None, flight.samples)
    yield "unexplained", metric(sum(f["unexplained"]), None, flight.samples)
    yield "twin_deviation", metric(flight.twin, None, flight.points)
    yield "texel_deviation", metric(flight.texels, None, flight.held)
    for name, suffix in (
        ("streamed", ""),
        ("streamed_blend", "_blend"),
        ("whole", "_whole"),
        ("whole_blend", "_whole_blend"),
    ):
        yield from _changes(flight.stills[name], suffix, flight.points)
    if flight.lag is not None and flight.points:
        yield "lag", metric(int(flight.lag.longest.max()), None, flight.points)
        yield "lag_share", metric(float((flight.lag.longest > 0).mean()), None, flight.points)
    shown = sum(f["seen"])
    yield "seen_pop", metric(max(f["seen_pop"]), None, int(shown))
    yield "seen_pop_blend", metric(max(f["seen_pop_blend"]), None, int(shown))
    for name in ("loaded", "evicted"):
        yield name, metric(sum(f[name]), None, frames)
    for name in ("wanted", "resident", "missing", "fell", "seen_fell"):
        yield f"most_{name}", metric(max(f[name]), None, frames)
    yield "frames_short", metric(sum(m > 0 for m in f["missing"]), None, frames)
    wanted = sum(f["wanted"])
    yield "hit_share", metric(sum(f["hits"]) / wanted if wanted else math.nan, None, int(wanted))
    asked = int(shown) + flight.points * frames
    yield "fell_share", metric((sum(f["fell"]) + sum(f["seen_fell"])) / asked, None, asked)
    # The first frame fills an empty cache; a frame of the flight is one of the others.
    for name in ("bytes", "host_ms", "device_ms", "sample_ns"):
        unit = {"bytes": "B", "sample_ns": "ns"}.get(name, "ms")
        yield f"{name}_median", metric(float(np.median(f[name][1:])), None, frames - 1, unit=unit)
        yield f"{name}_most", metric(float(np.max(f[name][1:])), None, frames - 1, unit=unit)
    yield "bytes_first", metric(f["bytes"][0], None, 1, unit="B")
    if flight.terms and flight.squares["light"] > 0.0:
        mean = flight.squares["light"] / flight.terms
        for name in ("streaming", "lod", "both"):
            yield (
                f"relrmse_{name}",
                metric(math.sqrt(flight.squares[name] / flight.terms) / mean, None, flight.terms // 3),
            )


def _changes(still: Still, suffix: str, points: int) -> Iterator[tuple[str, dict[str, Any] | None]]:
    n = points * len(still.pops)
    yield f"pop{suffix}", metric(max(still.pops), None, n)
    yield f"pop_p99{suffix}", metric(float(np.mean(still.p99s)), None, n)
    flicker = math.sqrt(float(np.mean(np.square(still.flickers))))
    yield f"flicker{suffix}", metric(flicker, None, points * len(still.flickers))


def _by_level(world: World, flight: Flight) -> Iterator[dict[str, Any]]:
    """Per level that answered: error of the streamed texture against truth, and that of the whole one without levels of detail at the
    same points; the finest first."""
    batches = world.watched.batches
    for level in sorted(flight.last, reverse=True):
        ours = flight.last[level].astype(np.float64)
        mine = np.isfinite(ours).all(axis=1)
        n = int(mine.sum())
        row: dict[str, Any] = {"level": level, "points": n}
        if level:
            row["voxel_m"] = world.table.finest * 2.0 ** (world.table.level - level)
        apart = ours[mine] - flight.full[mine]
        row["off_finest"] = metric(float(np.sqrt(np.mean(apart**2))) / flight.scale, None, n)
        if batches is not None and n >= LEAST_POINTS and float(batches[:, mine].mean()) > 0.0:
            row["relrmse"] = _entry(measure_rel_rmse(ours[mine], batches[:, mine]))
            row["relrmse_finest"] = _entry(measure_rel_rmse(flight.full[mine].astype(np.float64), batches[:, mine]))
        yield row


def _entry(m: Measured) -> dict[str, Any] | None:
    return metric(m.value, m.se, m.n, **({"below_noise": True} if m.below_noise else {}))


def _notes(world: World, flight: Flight) -> list[str]:
    notes = list(world.notes)
    blind = sum(n == 0 for n in flight.frames["seen"])
    if blind:
        notes.append(f"in {blind} frames the viewer saw no probe-lit surface")
    if float(np.mean(flight.full)) <= 0.0:
        notes.append("the light is dark at all watched points: changes are relative to nothing and read 0")
    return notes
