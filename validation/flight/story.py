"""A scene's flight, flown now or kept from before: what `run --fly` adds to the scene's record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...fastpath.device import OpenDevice
from ...fastpath.streamed import StreamedTexture
from ...reference.datatypes import Scene
from ...reference.progress import Progress
from .. import cache
from .driver import fly
from .paths import viewer_path
from .plan import FlightPlan
from .record import flight_metrics, flight_table
from .world import World, world


def with_flight(
    record: Mapping[str, Any], key: str, plan: FlightPlan, scene: Scene, device: OpenDevice, seed: int, progress: Progress
) -> dict[str, Any]:  # fmt: skip
    """The scene's record with its flight: the table `fly`, and the metrics that gates can judge. key: of the record, all that it
    depends on.

    A finished flight is kept by key and plan. Raises InputError as `flown` does.
    """
    name = cache.key(key, plan.path, plan.frames, plan.budget)
    kept = cache.load("fly", name)
    if kept is None:
        table = flown(scene, device, seed, plan, progress)
        cache.store("fly", name, {"table": cache.pack_json(table)})
    else:
        table = cache.unpack_json(kept["table"])
    return {**record, "fly": table, "metrics": {**record["metrics"], **flight_metrics(table)}}


def flown(scene: Scene, device: OpenDevice, seed: int, plan: FlightPlan, progress: Progress) -> dict[str, Any]:
    """Bake, stream and fly; returns the record's `fly` table.

    Raises InputError for a scene without probes, or a budget under what the coarsest level of detail needs.
    """
    return flown_through(world(scene, device, seed, progress), device, plan, progress)


def flown_through(w: World, device: OpenDevice, plan: FlightPlan, progress: Progress) -> dict[str, Any]:
    """The record's `fly` table of a world that is baked and lit. Raises InputError for a budget that is too small."""
    path = viewer_path(plan.path, w.places, plan.frames)
    texture = StreamedTexture(
        device, w.table, plan.budget, w.lod_distance, storage=w.storage, layout=w.layout,
        reconstruction=w.scene.settings.sampling.reconstruction, check_owners=True,
    )  # fmt: skip
    texture.relight(w.light)
    flight = fly(w, device, texture, path, progress)
    return flight_table(w, plan, path, flight, texture.bytes)
